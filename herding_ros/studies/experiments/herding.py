"""A whole run: a flock is herded, by whatever policy, and the run is put into numbers."""

from __future__ import annotations

from dataclasses import replace
import math
import time
from typing import Any

import numpy as np

from herding_ros.control.closed_loop import as_policy, ClosedLoopRun, play, Policy
from herding_ros.control.parameters import Control
from herding_ros.control.pilot import LockstepPilot
from herding_ros.control.receding_horizon import RecedingHorizon, SolveReport
from herding_ros.model.crowd import CROWDS
from herding_ros.model.flock import centre, distance, spread
from herding_ros.model.potentials import Morse
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState

from .settings import changed
from .strombom import Strombom


class _Stopwatch:
    """A policy with the processor time [s] that it takes.

    Time of this process on all its cores: what others do on the machine does not count.
    """

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self.seconds = 0.0

    def __call__(self, observed: HerdState, t: float) -> Array:
        started = time.process_time()
        u = self._policy(observed, t)
        self.seconds += time.process_time() - started
        return u


def run(
    policy: str,
    sheep: int,
    dogs: int,
    sigma: float,
    goal: list[float],
    seed: int,
    time_limit: float,
    stop: bool,
    every: float,
    settings: dict[str, Any],
    snapshots: list[float] | None = None,
    crowd: str = 'cohesive',
    common_noise: float = 0.0,
) -> dict[str, Any]:
    """Herd a flock by a policy and return the run in numbers.

    policy: 'planner' (settings: what differs from Control()), 'strombom' (settings: those of
    Strombom) or 'none', a dog that no sheep notices. every: spacing of the stored paths [s];
    snapshots: instants at which everybody's place is kept [s]; crowd: name of a preset;
    common_noise: as in Crowd.
    """
    herd = replace(CROWDS[crowd], noise=sigma, common_noise=common_noise)
    destination = np.array(goal)
    world = World(sheep=sheep, dogs=dogs, seed=seed)
    decide: Policy
    reports: list[SolveReport] = []
    if policy == 'planner':
        planner = RecedingHorizon(herd, changed(Control(), settings), destination, seed)
        decide = as_policy(LockstepPilot(planner, dogs), reports)
    elif policy == 'strombom':
        decide = Strombom(destination, np.random.default_rng([seed, 30_000]), **settings)
    elif policy == 'none':
        herd = replace(herd, dog=Morse(0.0, 1.0, 0.0, 1.0))
        decide = _stand
    else:
        raise ValueError(f'policy is {policy!r}, allowed is planner, strombom or none')
    timed = _Stopwatch(decide)
    track = play(Simulation(herd, world, destination), timed, time_limit, stop)
    result = measures(track, destination, world.control_period)
    result['policy_cpu'] = timed.seconds
    if reports:
        result['plans'] = plans(reports)
    result['paths'] = paths(track, destination, max(round(every / world.control_period), 1))
    result['snapshots'] = [
        {'t': t, 'x': rounded(track.x[k]), 'd': rounded(track.d[k])}
        for t in snapshots or []
        for k in [round(t / world.control_period)]
        if k < len(track.t)
    ]
    return result


def _stand(observed: HerdState, t: float) -> Array:
    return np.zeros_like(observed.d)


def measures(track: ClosedLoopRun, goal: Array, period: float) -> dict[str, Any]:
    """Return what one wants to know of a run. Lengths in m, times in s, energy in m^2/s.

    dogs_run: way of all dogs; energy: int sum |u_m|^2 dt; from_home: what held from the
    arrival to the end, where the run went on.
    """
    spreads, away = spread(track.x), distance(track.x, goal)
    speed = np.linalg.norm(track.u, axis=-1)
    home = track.home
    return {
        'arrived': home is not None,
        'time': None if home is None else round(float(track.t[home]), 9),
        'duration': round(float(track.t[-1]), 9),
        'initial_spread': float(spreads[0]),
        'max_spread': float(spreads.max()),
        'closest': float(away.min()),
        'final_distance': float(away[-1]),
        'dogs_run': float(period * speed.sum()),
        'energy': float(period * np.square(speed).sum()),
        'from_home': None if home is None else held(track, spreads, away, home, period),
    }


def held(
    track: ClosedLoopRun, spreads: Array, away: Array, home: int, period: float
) -> dict[str, Any] | None:
    """Return what held from the instant number `home` on; None if nothing came after it.

    turning: mean angular velocity of each dog about the centre, anticlockwise [rad/s];
    turning_speed: mean of its magnitude over dogs and time.
    """
    if home + 1 >= len(track.t):
        return None
    arm = track.d[home:] - centre(track.x[home:])[:, None]
    angle = np.unwrap(np.arctan2(arm[..., 1], arm[..., 0]), axis=0)
    rate = np.diff(angle, axis=0) / period
    return {
        'max_distance': float(away[home:].max()),
        'mean_distance': float(away[home:].mean()),
        'max_spread': float(spreads[home:].max()),
        'mean_spread': float(spreads[home:].mean()),
        'turning': [float(value) for value in rate.mean(axis=0)],
        'turning_speed': float(np.abs(rate).mean()),
        'dog_distance': float(np.linalg.norm(arm, axis=-1).mean()),
    }


def plans(reports: list[SolveReport]) -> dict[str, Any]:
    """Return how the plans of a run were found, in total or on average."""
    corrected = [each for each in reports if each.mapping_iterations]
    before = sum(each.mapping_error_before**2 for each in corrected)
    after = sum(each.mapping_error_after**2 for each in corrected)
    return {
        'count': len(reports),
        'corrected': len(corrected),
        'iterations': sum(each.mapping_iterations for each in reports),
        'error_ratio': math.sqrt(after / before) if before else None,
        'wall': sum(each.seconds['total'] for each in reports),
    }


def paths(track: ClosedLoopRun, goal: Array, every: int) -> dict[str, Any]:
    """Return the run at every so many-th instant, and at the last, rounded, for pictures."""
    index = sorted({*range(0, len(track.t), every), len(track.t) - 1})
    x = track.x[index]
    return {
        't': [round(float(t), 3) for t in track.t[index]],
        'centre': rounded(centre(x)),
        'dogs': rounded(track.d[index]),
        'distance': rounded(distance(x, goal)),
        'spread': rounded(spread(x)),
        'first': rounded(track.x[0]),
        'last': rounded(track.x[-1]),
    }


def rounded(values: Array) -> list[Any]:
    """Return an array as lists, to a tenth of a millimetre."""
    return list(np.round(values, 4).tolist())
