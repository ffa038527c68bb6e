"""The mean-field limit as a coarse model: how near it is, what a mapping makes of it, its cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import time
from typing import Any, TypeVar

import numpy as np

from herding_ros.control.parameters import Control, Mapping
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import centre, spread
from herding_ros.model.kernels import PATHS
from herding_ros.model.mean_field import mean_field
from herding_ros.model.noise import NoisePaths
from herding_ros.model.scenario import GOAL, initial_herd, PASTURE
from herding_ros.model.state import Array, HerdState

from .case import Case
from .settings import changed

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

    Root mean squares over the time of how far centre and spread are apart [m]: of the limit that
    starts from the flock, by so many markers each, and (density) of that which starts from the
    density that flocks are drawn from, by density_markers. moved: how far the centre gets;
    widened: how the spread changes.
    """
    crowd = Crowd(noise=0.0)
    state = initial_herd(sheep, dogs, np.array(GOAL), np.random.default_rng(seed))
    u = np.broadcast_to(np.array(_DRIVE), (round(duration / dt), dogs, 2))
    flock = rollout(crowd, state, u, dt).x

    def errors(start: HerdState, count: int) -> dict[str, float]:
        limit = rollout(*mean_field(crowd, start, count), u, dt).x
        # Spreads of blobs lack that within the leaves, which is known at the start.
        within = spread(start.x) ** 2 - spread(limit[0]) ** 2
        wide = np.sqrt(spread(limit) ** 2 + within)
        return {
            'centre': _rms(centre(limit) - centre(flock)),
            'spread': _rms((wide - spread(flock))[:, None]),
        }

    return {
        'flock': {str(count): errors(state, count) for count in markers},
        'density': errors(_pasture(state, density_markers), density_markers),
        'moved': float(np.linalg.norm(centre(flock[-1]) - centre(flock[0]))),
        'widened': float(spread(flock[-1]) - spread(flock[0])),
    }


def _pasture(state: HerdState, count: int) -> HerdState:
    """Return a herd with a grid of sheep, many to each marker, for those that stand at random."""
    side = 4 * round(np.sqrt(count))
    ticks = PASTURE * ((2.0 * np.arange(side) + 1.0) / side - 1.0)
    x = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    return HerdState(x, np.zeros_like(x), state.d)


def _rms(errors: Array) -> float:
    """Return the root mean square over the time of errors (K+1, any)."""
    return float(np.sqrt(np.square(errors).sum(axis=1).mean()))


def mapping(
    sheep: int, dogs: int, sigma: float, seed: int, judge_paths: int, control: dict[str, Any]
) -> dict[str, Any]:
    """Plan the first window of a large flock. Errors are |X - x_c| in L2(0, T) [m s^0.5].

    before, after: on the noise that the mapping has seen; judged: on so many other paths (in
    whole blocks), half of them mirrored, so that what is linear in the noise is none of the
    error. seconds: of the phases.
    """
    case = Case(sheep, dogs, sigma, seed, changed(Control(), control))
    found = case.plan(case.control)
    report = found.report
    noise = _mirrored(case.draw(np.random.default_rng([seed, 20_000]), judge_paths))
    before, after = (
        case.error(case.expected_centre(u, noise))
        for u in (case.deterministic.plan.u, found.plan.u)
    )
    return {
        'iterations': report.mapping_iterations,
        'before': report.mapping_error_before,
        'after': report.mapping_error_after,
        'judged_before': before,
        'judged_after': after,
        'calls': report.optimiser_calls,
        'seconds': report.seconds,
    }


def _mirrored(noise: NoisePaths) -> NoisePaths:
    """Return antithetic paths: those in the second half of each block are the first's mirror."""
    blocks = noise.blocks.reshape(*noise.blocks.shape[:3], -1, PATHS).copy()
    blocks[..., PATHS // 2 :] = -blocks[..., : PATHS // 2]
    return NoisePaths(len(blocks) * PATHS, blocks.reshape(noise.blocks.shape))


def replan(flocks: list[int], dogs: int, seed: int, iterations: int) -> dict[str, Any]:
    """Time what a plan costs besides the fine model, for flocks of so many sheep.

    Seconds, each the least of some repetitions, in turns, so that what else the machine does
    hits all alike: coarse, the deterministic solve from standing dogs in so many iterations, with
    the choice of markers; sensitivity, of the centre, which a mapping needs once.
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
