# SPDX-License-Identifier: Apache-2.0
"""Spectral projected gradient (Birgin, Martinez, Raydan 2000, algorithm SPG2)."""

from __future__ import annotations

from collections import deque

from herding_ros.model.state import Array

from .solution import Budget, criticality, Problem, Solution, Status

_SUFFICIENT_DECREASE = 1e-4
_MEMORY = 8
_STEP_LIMITS = (1e-10, 1e10)
_BACKTRACKS = 30


def spg(problem: Problem, start: Array, budget: Budget) -> Solution:
    """Minimise over a convex set, given the projection onto it.

    Steps along the projected gradient with the Barzilai-Borwein length, accepted when the
    value is below the largest of the last eight (the line search of Grippo, Lampariello and
    Lucidi), so that most steps cost one evaluation. Converged when the projected gradient,
    measured by the inner product, is at most the tolerance. Returns the best point seen.
    """
    value_and_gradient, project, inner = problem.value_and_gradient, problem.project, problem.inner
    u = project(start)
    value, gradient = value_and_gradient(u)
    calls = 1
    recent = deque([value], maxlen=_MEMORY)
    length = 1.0
    best = (value, u, criticality(problem, u, gradient))
    status = Status.ITERATION_LIMIT
    iterations = 0
    for iterations in range(budget.max_iterations + 1):
        distance = criticality(problem, u, gradient)
        if value <= best[0]:
            best = (value, u, distance)
        if distance <= budget.tolerance:
            status = Status.CONVERGED
            break
        if iterations == budget.max_iterations:
            break
        if budget.out_of_time():
            status = Status.OUT_OF_TIME
            break
        direction = project(u - length * gradient) - u
        slope = inner(gradient, direction)
        ceiling = max(recent)
        fraction = 1.0
        for _ in range(_BACKTRACKS):
            trial = u + fraction * direction
            trial_value, trial_gradient = value_and_gradient(trial)
            calls += 1
            if trial_value <= ceiling + _SUFFICIENT_DECREASE * fraction * slope:
                break
            if budget.out_of_time():
                status = Status.OUT_OF_TIME
                break
            fraction = _interpolate(fraction, slope, value, trial_value)
        else:
            status = Status.NO_DESCENT
        if status is not Status.ITERATION_LIMIT:
            break
        moved, changed = trial - u, trial_gradient - gradient
        curvature = inner(moved, changed)
        length = inner(moved, moved) / curvature if curvature > 0.0 else _STEP_LIMITS[1]
        length = min(max(length, _STEP_LIMITS[0]), _STEP_LIMITS[1])
        u, value, gradient = trial, trial_value, trial_gradient
        recent.append(value)
    value, u, distance = best
    return Solution(u, value, distance, status, iterations, calls)


def _interpolate(fraction: float, slope: float, value: float, trial_value: float) -> float:
    """Minimum of the parabola through both values and the slope, kept within [0.1, 0.5]."""
    excess = trial_value - value - fraction * slope
    step = -0.5 * fraction**2 * slope / excess if excess > 0.0 else 0.5 * fraction
    return min(max(step, 0.1 * fraction), 0.5 * fraction)
