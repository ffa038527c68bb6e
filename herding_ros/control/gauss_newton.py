# SPDX-License-Identifier: Apache-2.0
"""Regularised nonlinear least squares over a convex set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from herding_ros.model.state import Array
import numpy as np

from .hessian import Hessian
from .pqn import pqn
from .solution import Budget, criticality, Problem, Solution, Status, ValueAndGradient

_MAX_INNER_ITERATIONS, _INNER_TOLERANCE = 30, 0.1
"""Of each linear problem; the tolerance is relative to that of the whole."""


class Linearisation(Protocol):
    """The derivative of residuals with respect to u, near the points of interest."""

    def times(self, du: Array) -> Array:
        """Return the change (n,) of the residuals under a change du of u."""

    def transposed(self, e: Array) -> Array:
        """Return the adjoint of `times`, with respect to the inner product, at e (n,)."""


def gauss_newton(
    residual: Callable[[Array], Array],
    linearise: Callable[[Array], Linearisation],
    regulariser: Problem,
    start: Array,
    budget: Budget,
) -> Solution:
    """Minimise |residual(u)|^2 / 2 + R(u) over a convex set.

    The regulariser's problem is R alone, over that set. Each iteration replaces the residual by
    r(u_k) + S (u - u_k), with S = linearise(u_k), and minimises that plus R, as it is, by `pqn`,
    which costs no residual, but may evaluate R thirty times: both ask whether there is time.
    Converged when an iteration lowers the value by at most the tolerance, relative to the value;
    stagnated when it raises it. `Solution.calls` counts residuals. Where the residual can be made
    small, S may be one for all u, made once.
    """
    u = regulariser.project(start)
    r, s, at = residual(u), linearise(u), u
    value = _square(r) + regulariser.value_and_gradient(u)[0]
    inner_budget = Budget(
        _MAX_INNER_ITERATIONS, _INNER_TOLERANCE * budget.tolerance, budget.out_of_time
    )
    hessian = Hessian()
    status = Status.ITERATION_LIMIT
    iterations = 0
    while iterations < budget.max_iterations:
        if budget.out_of_time():
            status = Status.OUT_OF_TIME
            break
        iterations += 1
        if at is not u:
            s, at = linearise(u), u
        model = _linear_model(r, s, u, regulariser.value_and_gradient)
        linear = replace(regulariser, value_and_gradient=model, hessian=hessian)
        trial = pqn(linear, u, inner_budget).u
        trial_residual = residual(trial)
        trial_value = _square(trial_residual) + regulariser.value_and_gradient(trial)[0]
        if trial_value > value:
            status = Status.STAGNATED
            break
        decrease = value - trial_value
        u, r, value = trial, trial_residual, trial_value
        if decrease <= budget.tolerance * value:
            status = Status.CONVERGED
            break
    if at is not u and status is not Status.OUT_OF_TIME:
        s = linearise(u)  # else the last one has to do
    gradient = s.transposed(r) + regulariser.value_and_gradient(u)[1]
    distance = criticality(regulariser, u, gradient)
    return Solution(u, value, distance, status, iterations, iterations + 1)


def _linear_model(
    r: Array, s: Linearisation, u: Array, regulariser: ValueAndGradient
) -> ValueAndGradient:
    """Return |r + S (w - u)|^2 / 2 + R(w) as a function of w."""

    def model(w: Array) -> tuple[float, Array]:
        e = r + s.times(w - u)
        value, gradient = regulariser(w)
        return _square(e) + value, s.transposed(e) + gradient

    return model


def _square(r: Array) -> float:
    return 0.5 * float(np.square(r).sum())
