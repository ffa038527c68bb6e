"""Nonlinear least squares over a convex set."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Protocol

import numpy as np

from herding_ros.model.state import Array

from .solution import (
    criticality,
    InnerProduct,
    never,
    OutOfTime,
    Projection,
    Solution,
    Status,
    ValueAndGradient,
)
from .spg import spg

_INNER_TOLERANCE = 1e-5
_INNER_ITERATIONS = 100


class Linearisation(Protocol):
    """The derivative of residuals with respect to u, near the points of interest."""

    def times(self, du: Array) -> Array:
        """Return the change (n,) of the residuals under a change du of u."""

    def transposed(self, e: Array) -> Array:
        """Return the adjoint of `times`, with respect to the inner product, at e (n,)."""


def gauss_newton(
    residual: Callable[[Array], Array],
    linearise: Callable[[Array], Linearisation],
    anchor: Array,
    weight: float,
    project: Projection,
    start: Array,
    inner: InnerProduct,
    tolerance: float,
    max_iterations: int,
    out_of_time: OutOfTime = never,
) -> Solution:
    """Minimise |residual(u)|^2 / 2 + weight / 2 |u - anchor|^2 over a convex set.

    Each iteration replaces the residual by r(u_k) + S (u - u_k), with S = linearise(u_k), and
    minimises that over the set by `spg`, which costs no residual. Converged when a step is at
    most `tolerance` long; ends when the value does not decrease any more. `Solution.calls`
    counts residuals. Where the residual can be made small, S may be one for all u, made once.
    """
    u = project(start)
    r = residual(u)
    value = _value(r, u, anchor, weight, inner)
    status = Status.ITERATION_LIMIT
    iterations = 0
    while iterations < max_iterations:
        if out_of_time():
            status = Status.OUT_OF_TIME
            break
        iterations += 1
        model = _linear_model(r, linearise(u), u, anchor, weight, inner)
        trial = spg(model, project, u, inner, _INNER_TOLERANCE, _INNER_ITERATIONS).u
        trial_residual = residual(trial)
        trial_value = _value(trial_residual, trial, anchor, weight, inner)
        if trial_value >= value:
            status = Status.STAGNATED
            break
        step = trial - u
        u, r, value = trial, trial_residual, trial_value
        if math.sqrt(inner(step, step)) <= tolerance:
            status = Status.CONVERGED
            break
    gradient = linearise(u).transposed(r) + weight * (u - anchor)
    distance = criticality(project, u, gradient, inner)
    return Solution(u, value, distance, status, iterations, iterations + 1)


def _linear_model(
    r: Array, s: Linearisation, u: Array, anchor: Array, weight: float, inner: InnerProduct
) -> ValueAndGradient:
    """Return |r + S (w - u)|^2 / 2 + weight / 2 |w - anchor|^2 as a function of w."""

    def model(w: Array) -> tuple[float, Array]:
        e = r + s.times(w - u)
        gradient = s.transposed(e) + weight * (w - anchor)
        return _value(e, w, anchor, weight, inner), gradient

    return model


def _value(r: Array, u: Array, anchor: Array, weight: float, inner: InnerProduct) -> float:
    return 0.5 * float(np.square(r).sum()) + 0.5 * weight * inner(u - anchor, u - anchor)
