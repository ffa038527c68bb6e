# SPDX-License-Identifier: Apache-2.0
"""Backtracking along a direction of descent within a convex set."""

from __future__ import annotations

from typing import NamedTuple

from herding_ros.model.state import Array

from .solution import OutOfTime, Status, ValueAndGradient

_SUFFICIENT_DECREASE = 1e-4
_BACKTRACKS = 30


class Step(NamedTuple):
    """The point that was tried last, and how often the function was evaluated."""

    u: Array
    value: float
    gradient: Array
    calls: int
    status: Status | None
    """None: accepted; otherwise why there is no better point."""


def line_search(
    value_and_gradient: ValueAndGradient,
    u: Array,
    value: float,
    direction: Array,
    slope: float,
    ceiling: float,
    out_of_time: OutOfTime,
) -> Step:
    """Try u + direction, and shorter steps until the value lies below the ceiling.

    slope < 0 is the derivative at u along the direction. Accepted when the value is at most
    ceiling + 1e-4 fraction slope (Armijo's rule where the ceiling is the value at u). The next
    fraction is the minimum of the parabola through both values and the slope, within
    [0.1, 0.5] of the last one.
    """
    fraction = 1.0
    for calls in range(1, _BACKTRACKS + 1):
        trial = u + fraction * direction
        trial_value, gradient = value_and_gradient(trial)
        if trial_value <= ceiling + _SUFFICIENT_DECREASE * fraction * slope:
            return Step(trial, trial_value, gradient, calls, None)
        if out_of_time():
            return Step(trial, trial_value, gradient, calls, Status.OUT_OF_TIME)
        excess = trial_value - value - fraction * slope
        best = -0.5 * fraction**2 * slope / excess if excess > 0.0 else 0.5 * fraction
        fraction = min(max(best, 0.1 * fraction), 0.5 * fraction)
    return Step(trial, trial_value, gradient, calls, Status.NO_DESCENT)
