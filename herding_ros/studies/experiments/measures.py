# SPDX-License-Identifier: Apache-2.0
"""A run in numbers that JSON can hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Any

from herding_ros.control.closed_loop import ClosedLoopRun
from herding_ros.control.solve_report import SolveReport
from herding_ros.model.flock import centre, distance, spread, without_strays
from herding_ros.model.state import Array
import numpy as np


def measures(run: ClosedLoopRun, goal: Array, period: float, strays: int = 0) -> dict[str, Any]:
    """Return the result of a run. Lengths in m, times in s, energy in m^2/s.

    strays: so many sheep, those farthest away, do not count in centre and spread; dogs_run: length
    of the paths of all dogs; energy: int sum |u_m|^2 dt; from_home: see `held`.
    """
    run = replace(run, x=without_strays(run.x, strays))
    spreads, away = spread(run.x), distance(run.x, goal)
    speed = np.linalg.norm(run.u, axis=-1)
    home = run.home
    return {
        'arrived': home is not None,
        'time': None if home is None else round(float(run.t[home]), 9),
        'duration': round(float(run.t[-1]), 9),
        'initial_spread': float(spreads[0]),
        'max_spread': float(spreads.max()),
        'final_spread': float(spreads[-1]),
        'closest': float(away.min()),
        'final_distance': float(away[-1]),
        'dogs_run': float(period * speed.sum()),
        'energy': float(period * np.square(speed).sum()),
        'from_home': None if home is None else held(run, spreads, away, home, period),
    }


def held(
    run: ClosedLoopRun, spreads: Array, away: Array, home: int, period: float
) -> dict[str, Any] | None:
    """Return what held from the instant number `home` on; None if the run ended there.

    turning: mean angular velocity of each dog about the centre, anticlockwise [rad/s];
    turning_speed: mean of its magnitude over dogs and time.
    """
    if home + 1 >= len(run.t):
        return None
    arm = run.d[home:] - centre(run.x[home:])[:, None]
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


def plans(reports: Sequence[SolveReport]) -> dict[str, Any]:
    """Return the iterations of all mappings, and what they left of the error in root mean square.

    Windows without a correction do not count in the ratio of errors.
    """
    corrected = [each for each in reports if each.mapping_iterations]
    before = sum(each.mapping_error_before**2 for each in corrected)
    after = sum(each.mapping_error_after**2 for each in corrected)
    return {
        'iterations': sum(each.mapping_iterations for each in reports),
        'error_ratio': math.sqrt(after / before) if before else None,
    }


def course(run: ClosedLoopRun, goal: Array, every: int, strays: int = 0) -> dict[str, Any]:
    """Return every so many-th instant of a run, and the last, rounded, for figures.

    strays: as in `measures`; 'first' and 'last' have all sheep.
    """
    index = sorted({*range(0, len(run.t), every), len(run.t) - 1})
    x = without_strays(run.x[index], strays)
    return {
        't': [round(float(t), 3) for t in run.t[index]],
        'centre': rounded(centre(x)),
        'dogs': rounded(run.d[index]),
        'distance': rounded(distance(x, goal)),
        'spread': rounded(spread(x)),
        'first': rounded(run.x[0]),
        'last': rounded(run.x[-1]),
    }


def snapshots_at(
    run: ClosedLoopRun, instants: Sequence[float], period: float
) -> list[dict[str, Any]]:
    """Return the positions at these instants [s], as far as the run got."""
    numbers = {t: round(t / period) for t in instants}
    return [
        {'t': t, 'x': rounded(run.x[k]), 'd': rounded(run.d[k])}
        for t, k in numbers.items()
        if k < len(run.t)
    ]


def rounded(values: Array) -> list[Any]:
    """Return an array as lists, to a tenth of a millimetre."""
    return list(np.round(values, 4).tolist())
