# SPDX-License-Identifier: Apache-2.0
"""The mean-field limit as a coarse model: its errors and its cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import time
from typing import Any, TypeVar

from herding_ros.control.parameters import Control, Mapping
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import centre, spread
from herding_ros.model.mean_field import mean_field
from herding_ros.model.scenario import GOAL, initial_herd, Start
from herding_ros.model.state import Array, HerdState
import numpy as np

_DRIVE = (0.025, 0.025)
"""Velocity of all dogs in `convergence` [m/s]: straight to the goal."""
_REPEATS = 3

_T = TypeVar('_T')


def convergence(
    sheep: int,
    dogs: int,
    seed: int,
    duration: float,
    dt: float,
    markers: list[int],
    density_markers: int,
) -> dict[str, Any]:
    """Drive a flock without noise, and its mean-field limit.

    Differences of centre and spread [m], root mean squares over time: of the limit that starts
    from the flock, for each number of markers, and (density) of the limit that starts from the
    density that flocks are drawn from, with density_markers. widened: growth of the spread.
    """
    crowd = Crowd(noise=0.0)
    state = initial_herd(sheep, dogs, np.array(GOAL), np.random.default_rng(seed))
    u = np.broadcast_to(np.array(_DRIVE), (round(duration / dt), dogs, 2))
    flock = rollout(crowd, state, u, dt).x

    def errors(start: HerdState, count: int) -> dict[str, float]:
        limit = rollout(*mean_field(crowd, start, count), u, dt).x
        # Spreads of blobs lack the spread within the leaves, which is computed at the start.
        within = spread(start.x) ** 2 - spread(limit[0]) ** 2
        wide = np.sqrt(spread(limit) ** 2 + within)
        return {
            'centre': _rms(centre(limit) - centre(flock)),
            'spread': _rms((wide - spread(flock))[:, None]),
        }

    return {
        'flock': {str(count): errors(state, count) for count in markers},
        'density': errors(_pasture(state, density_markers), density_markers),
        'widened': float(spread(flock[-1]) - spread(flock[0])),
    }


def _pasture(state: HerdState, count: int) -> HerdState:
    """Return a herd whose sheep stand on a grid, many to each marker, instead of at random."""
    side = 4 * round(np.sqrt(count))
    ticks = Start().half_width * ((2.0 * np.arange(side) + 1.0) / side - 1.0)
    x = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    return HerdState(x, np.zeros_like(x), state.d)


def _rms(errors: Array) -> float:
    """Return the root mean square over the time of errors (K+1, any)."""
    return float(np.sqrt(np.square(errors).sum(axis=1).mean()))


def replan(flocks: list[int], dogs: int, seed: int, iterations: int) -> dict[str, Any]:
    """Time the parts of a plan apart from the fine model, for each number of sheep [s].

    coarse: the deterministic solve from standing dogs in so many iterations, with the choice of
    markers; sensitivity: of the centre, which a mapping needs once. Each is the least of some
    repetitions, in turns, so that other load on the machine affects all alike.
    """
    found: dict[str, dict[str, float]] = {}
    for _ in range(_REPEATS):
        for sheep in flocks:
            state = initial_herd(sheep, dogs, np.array(GOAL), np.random.default_rng(seed))
            for name, seconds in _seconds(state, iterations).items():
                least = found.setdefault(str(sheep), {})
                least[name] = min(seconds, least.get(name, seconds))
    return found


def _seconds(state: HerdState, iterations: int) -> dict[str, float]:
    control = Control(mapping=Mapping(max_iterations=0))
    control = replace(
        control, optimiser=replace(control.optimiser, max_iterations=iterations, tolerance=0.0)
    )
    planner = RecedingHorizon(Crowd(), control, np.array(GOAL))
    window, coarse = _timed(lambda: planner.solve(state, 0.0))
    model = planner.coarse_model(state)
    every = round(0.5 / model.dt)
    _, sensitivity = _timed(lambda: model.centre_sensitivity(window.plan.u, every))
    return {'coarse': coarse, 'sensitivity': sensitivity}


def _timed(call: Callable[[], _T]) -> tuple[_T, float]:
    started = time.perf_counter()
    result = call()
    return result, time.perf_counter() - started
