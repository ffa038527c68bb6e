# SPDX-License-Identifier: Apache-2.0
"""Spectral projected gradient (Birgin, Martinez, Raydan 2000, algorithm SPG2)."""

from __future__ import annotations

from collections import deque

from herding_ros.model.state import Array

from .line_search import line_search
from .solution import Budget, criticality, Problem, Solution, Status

_MEMORY = 8
_STEP_LIMITS = (1e-10, 1e10)
"""Of the length of a step, relative to `Problem.step`."""


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
    length = problem.step
    shortest, longest = (limit * problem.step for limit in _STEP_LIMITS)
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
        step = line_search(
            value_and_gradient, u, value, direction, slope, max(recent), budget.out_of_time
        )
        calls += step.calls
        if step.status is not None:
            status = step.status
            break
        moved, changed = step.u - u, step.gradient - gradient
        curvature = inner(moved, changed)
        length = inner(moved, moved) / curvature if curvature > 0.0 else longest
        length = min(max(length, shortest), longest)
        u, value, gradient = step.u, step.value, step.gradient
        recent.append(value)
    value, u, distance = best
    return Solution(u, value, distance, status, iterations, calls)
