# SPDX-License-Identifier: Apache-2.0
"""Projected quasi-Newton method (Schmidt, van den Berg, Friedlander, Murphy 2009)."""

from __future__ import annotations

import math

from herding_ros.model.state import Array
import numpy as np

from .hessian import Hessian
from .line_search import line_search
from .solution import Budget, criticality, Problem, Solution, Status

_FIRST_STEP = 0.3
_ROUND_OFF = 8.0 * float(np.finfo(np.float64).eps)


def pqn(problem: Problem, start: Array, budget: Budget) -> Solution:
    """Minimise over a convex set, given the projection onto it.

    Each iteration minimises a quadratic model of the function over the set (`Hessian`), and
    searches along the line from u to that minimum, with Armijo's rule. Converged when the slope
    along this line promises to lower the value by at most the tolerance, relative to the value.
    What the budget says of iterations holds for evaluations after the first, too.

    Requires an inner product that is a multiple of the dot product. No unit is hidden: with value,
    u and inner product in other units the iterations are the same.
    """
    value_and_gradient, project, inner = problem.value_and_gradient, problem.project, problem.inner
    u = project(start)
    value, gradient = value_and_gradient(u)
    calls = 1
    ones = np.ones_like(u)
    first_step = _FIRST_STEP * problem.scale * math.sqrt(inner(ones, ones))
    hessian = problem.hessian or Hessian()
    status = Status.ITERATION_LIMIT
    iterations = 0
    if not gradient.any():
        return Solution(u, value, 0.0, Status.CONVERGED, iterations, calls)
    while calls <= budget.max_iterations:
        if hessian.known:
            direction = hessian.model_minimum(project, u, gradient) - u
        else:
            direction = (
                project(u - first_step / math.sqrt(inner(gradient, gradient)) * gradient) - u
            )
        slope = inner(gradient, direction)
        if -slope <= max(budget.tolerance, _ROUND_OFF) * abs(value):
            status = Status.CONVERGED
            break
        if budget.out_of_time():
            status = Status.OUT_OF_TIME
            break
        step = line_search(
            value_and_gradient, u, value, direction, slope, value, budget.out_of_time
        )
        calls += step.calls
        if step.status is not None:
            status = step.status
            break
        hessian.update(step.u - u, step.gradient - gradient)
        u, value, gradient = step.u, step.value, step.gradient
        iterations += 1
    distance = criticality(problem, u, gradient)
    return Solution(u, value, distance, status, iterations, calls)
