# SPDX-License-Identifier: Apache-2.0
"""Recorded drives of real sheep: crowds fitted to them, what these predict, and their herding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import hashlib
from pathlib import Path
from typing import Any

from herding_ros.control.closed_loop import play, steer
from herding_ros.control.parameters import Control, Mapping, Sensor
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.scale import Scale
from herding_ros.fit.least_squares import (
    constant_velocity,
    fit_predictions,
    Predictions,
    Predictor,
    with_noise,
)
from herding_ros.fit.recording import Recording
from herding_ros.model.alignment import Alignment
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.flock import centre, spread
from herding_ros.model.potentials import Harmonic, Morse
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array
import numpy as np

from .measures import course, measures
from .strombom import Strombom

ALIGNED, UNALIGNED, STRAIGHT = 'aligned', 'not aligned', 'constant velocity'

_START = Crowd(
    Morse(3.0, 1.0, 20.0, 20.0), Morse(3.0, 2.0, 0.0, 2.0), friction=0.25,
    alignment=Alignment(2.0, 2.0), noise=0.7,
)  # fmt: skip
"""Where fits begin: lengths and times of sheep, in round numbers."""

FORMS: dict[str, Crowd] = {
    ALIGNED: _START,
    UNALIGNED: replace(_START, alignment=Alignment()),
    'aligned, dog felt up to a distance': replace(_START, dog=Harmonic(0.12, 7.0)),
    'aligned, dog attracts from afar': replace(_START, dog=Morse(3.0, 2.0, 1.0, 10.0)),
}
"""Kinds of crowds that are fitted, each as it begins."""

_HELD = ('crowd.sheep.attraction_length',)
"""Errors of predictions do not tell it. Recorded flocks lose no sheep, so it is long."""

SENSOR = Sensor(position_noise=1e-3, velocity_noise=1.0)
"""Recorded positions are taken as they are: smoothing them made predictions worse."""

OTHER = Crowd(
    Morse(4.370, 1.124, 26.59, 20.0), Morse(4.272, 3.450, 0.0, 2.0), friction=0.3837,
    noise=0.7450, common_noise=0.8227,
)  # fmt: skip
"""The crowd that is not aligned, as fitted to the training drives."""

PLANTS = {'as fitted': CROWDS['sheep'], 'not aligned': OTHER}

MAX_SPEED = 4.0
"""Of the dogs that herd [m/s]."""

HOME = 2.0
"""A flock has arrived when its centre is so near to the goal [m].

That is about its size. Within 3 s its centre is off any prediction by as much, so that nobody
could steer it into less.
"""

_BEHIND = 1.0
"""Distance r_a of the rule [m]."""


def identify(path: Path) -> tuple[str, int]:
    """Return a name of the drives of a file, a hash of their numbers, and how many they are.

    Raises OSError and ValueError for what is no such file.
    """
    x, frames, dt = _load(path)
    content = b''.join(np.ascontiguousarray(each).tobytes() for each in (x, frames, dt))
    return hashlib.sha256(content).hexdigest()[:16], len(frames)


def _load(path: Path) -> tuple[Any, Any, Any]:
    with np.load(path) as file:
        if missing := {'x', 'frames', 'dt'} - set(file.files):
            raise ValueError(f'{path} must have the arrays x, frames and dt, lacks '
                             f'{", ".join(sorted(missing))}')  # fmt: skip
        x, frames, dt = (np.asarray(file[name]) for name in ('x', 'frames', 'dt'))
    if x.ndim != 3 or x.shape[1] < 3 or x.shape[2] != 2 or frames.sum() != len(x):
        raise ValueError(
            f'{path}: x must have shape ({int(frames.sum())}, sheep + 2, 2), which is the sum of '
            f'frames, got {x.shape}'
        )
    return x, frames, dt


def drives(path: Path) -> list[Recording]:
    """Return the drives: x (instants, N + 2, 2) [m], all drives one after the other.

    The last two rows are dog and shepherd, of whom the dog counts; frames: instants of each drive;
    dt: time between two [s].
    """
    x, frames, dt = _load(path)
    out = []
    parts = np.split(x.astype(np.float64), np.cumsum(frames)[:-1])
    for k, part in enumerate(parts):
        sheep = part[:, :-2]
        times = float(dt) * np.arange(len(part), dtype=np.float64)
        out.append(
            Recording(times, sheep, np.full_like(sheep, np.nan), part[:, -2:-1], f'drive {k}')
        )
    return out


def predicted(
    data: str, form: str, train: Sequence[int], test: Sequence[int], noise: bool, path: str
) -> dict[str, Any]:
    """Fit a form to some drives and predict others.

    data: name of the drives in the file `path`; train, test: numbers of drives; noise: find it,
    too, and simulate under it. Returns the crowd by the names of its parameters, of each tested
    drive at each lead the sums of squared errors of sheep and of the centre [m^2] and their
    numbers, and with noise the size of the tested flocks, recorded and simulated [m].
    """
    every = drives(Path(path))
    known = Predictor([every[i] for i in train])
    if form == STRAIGHT:
        crowd = constant_velocity(_START.noise)
    else:
        crowd = fit_predictions(known, FORMS[form], SENSOR, _HELD)
        crowd = with_noise(crowd, known, SENSOR) if noise else crowd
    result: dict[str, Any] = {
        'crowd': {k: v for k, v in crowd.flat().items() if isinstance(v, float)},
        'drives': [_errors(Predictor([every[i]]).predict(crowd, SENSOR)) for i in test],
    }
    if noise:
        result['sizes'] = Predictor([every[i] for i in test]).sizes(crowd)
    return result


def _errors(found: Predictions) -> dict[str, list[float]]:
    squares = np.square(found.off).sum(axis=2)  # of a distance
    of_centre = np.square(found.off.mean(axis=3)).sum(axis=2)
    return {
        'squares': np.nansum(squares, axis=(0, 2)).tolist(),
        'of_centre': np.nansum(of_centre, axis=0).tolist(),
        'sheep': np.isfinite(squares).sum(axis=(0, 2)).tolist(),
        'flocks': np.isfinite(of_centre).sum(axis=0).tolist(),
    }


def recorded(data: str, path: str) -> dict[str, Any]:
    """Return how the dog did: pace of the flock [m/s], lengths of the paths [m], distances [m]."""
    rows = []
    for each in drives(Path(path)):
        middle, dog = centre(each.x), each.d[:, 0]
        rows.append(
            {
                'duration': each.duration,
                'flock_path': _length(middle[::10]),
                'dog_path': _length(dog[::10]),
                'away': float(np.linalg.norm(middle[-1] - middle[0])),
                'dog_distance': float(np.linalg.norm(dog - middle, axis=1).mean()),
                'spread': float(spread(each.x).mean()),
            }
        )
    return {'drives': rows}


def _length(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def herding(
    plant: str,
    policy: str,
    dogs: int,
    seed: int,
    goal: list[float],
    time_limit: float,
    sheep: int = 14,
    paths: int = Mapping.paths,
) -> dict[str, Any]:
    """Herd real sheep and return the run in numbers.

    plant: one of PLANTS; policy: 'planner', which is told that they are as fitted and else has
    its defaults, or 'rule', Strömbom's.
    """
    told, destination = CROWDS['sheep'], np.array(goal)
    scale = Scale.of(told, MAX_SPEED)
    world = scale.apply(World()).with_values(
        {
            'sheep': sheep,
            'dogs': dogs,
            'seed': seed,
            'max_speed': MAX_SPEED,
            'arrival.radius': HOME,
        }
    )
    field = Simulation(PLANTS[plant], world, destination)
    if policy == 'rule':
        rule = Strombom(destination, np.random.default_rng([seed, 30_000]), MAX_SPEED, _BEHIND)
        track = play(field, rule, time_limit)
    elif policy == 'planner':
        control = scale.apply(Control()).with_values(
            {'max_speed': MAX_SPEED, 'mapping.paths': paths}
        )
        track = steer(field, RecedingHorizon(told, control, destination, seed), time_limit)
    else:
        raise ValueError(f"policy must be 'rule' or 'planner', got {policy!r}")
    every = max(round(1.0 / world.control_period), 1)
    return {
        **measures(track, destination, world.control_period),
        'paths': course(track, destination, every),
    }
