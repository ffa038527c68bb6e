# SPDX-License-Identifier: Apache-2.0
"""Projected nonlinear conjugate gradient with the Armijo rule (paper, Algorithm 2)."""

from __future__ import annotations

import math

from herding_ros.model.state import Array

from .solution import Budget, criticality, Problem, Solution, Status

_SUFFICIENT_DECREASE = 1e-4
_BACKTRACKS = 40


def ncg(problem: Problem, start: Array, budget: Budget) -> Solution:
    """Minimise over a convex set, given the projection onto it.

    Conjugate directions by Polak and Ribiere (restarted when negative or uphill), step size
    s by halving until f(P(u + s d)) <= f(u) - c/s |P(u + s d) - u|^2 (Armijo rule along the
    projection arc). Stops, as the paper does, when a step is at most the tolerance long.
    """
    value_and_gradient, project, inner = problem.value_and_gradient, problem.project, problem.inner
    u = project(start)
    value, gradient = value_and_gradient(u)
    calls = 1
    direction = -gradient
    size = problem.step
    status = Status.ITERATION_LIMIT
    iterations = 0
    if inner(gradient, gradient) == 0.0:
        return Solution(u, value, 0.0, Status.CONVERGED, iterations, calls)
    while iterations < budget.max_iterations:
        if budget.out_of_time():
            status = Status.OUT_OF_TIME
            break
        for _ in range(_BACKTRACKS):
            trial = project(u + size * direction)
            trial_value, trial_gradient = value_and_gradient(trial)
            calls += 1
            moved = trial - u
            length = math.sqrt(inner(moved, moved))
            if trial_value <= value - _SUFFICIENT_DECREASE / size * length**2:
                break
            if budget.out_of_time():
                status = Status.OUT_OF_TIME
                break
            size *= 0.5
        else:
            if inner(direction + gradient, direction + gradient) > 0.0:
                direction, size = -gradient, problem.step  # restart by steepest descent
                continue
            status = Status.NO_DESCENT
        if status is not Status.ITERATION_LIMIT:
            break
        iterations += 1
        beta = inner(trial_gradient, trial_gradient - gradient) / inner(gradient, gradient)
        u, value, gradient = trial, trial_value, trial_gradient
        if length <= budget.tolerance:
            status = Status.CONVERGED
            break
        direction = -gradient + max(beta, 0.0) * direction
        if inner(direction, gradient) >= 0.0:
            direction = -gradient
        size *= 2.0
    distance = criticality(problem, u, gradient)
    return Solution(u, value, distance, status, iterations, calls)
