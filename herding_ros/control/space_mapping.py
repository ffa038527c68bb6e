# SPDX-License-Identifier: Apache-2.0
"""Two methods that correct the plan of a coarse model by few evaluations of the fine one.

`aggressive_mapping` is the paper's Algorithm 1, repaired: it compares controls. `output_mapping`
compares the models' outputs, and needs fewer evaluations where the controls are at their limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

from herding_ros.model.state import Array
import numpy as np

from .solution import Budget, InnerProduct, never, NoTimeFor, Projection, Status

FINE, EXTRACTION = 'fine', 'extraction'
"""Kinds of steps, for NoTimeFor: evaluation of the fine model; search with the coarse one."""

MIN_DECREASE = 5e-3
"""The paper's aggressive mapping stops when its residual decreases by less in an iteration."""

_DAMPING_FACTOR = 10.0
_SINGULAR = 1e-10


@dataclass(frozen=True)
class MappingProblem:
    """What a space mapping is to correct.

    fine: from a control to the fine model's output; misfit: how far an output is from the
    target; u_coarse: the coarse optimum u_c, from which a mapping starts.
    """

    fine: Callable[[Array], Array]
    misfit: Callable[[Array], float]
    u_coarse: Array


@dataclass(frozen=True)
class MappingResult:
    """The best control for the fine model, and how it was found.

    u: the control with the least misfit; output: the fine model's output under it;
    residuals: |T(u_f) - u_c| / |u_c| of each iterate, where controls are compared; misfits:
    misfit of each iterate's output, so that misfits[0] is that of the coarse optimum.
    """

    u: Array
    output: Array
    status: Status
    residuals: tuple[float, ...] = ()
    misfits: tuple[float, ...] = ()

    @property
    def iterations(self) -> int:
        """Number of corrections that were tried."""
        return max(len(self.misfits) - 1, 0)


class Broyden:
    """Limited-memory Broyden matrix B = I + sum c s^T / |s|^2; B itself is never built."""

    def __init__(self, inner: InnerProduct) -> None:
        """Start from the identity; inner is the inner product the dyads refer to."""
        self._inner = inner
        self._corrections: list[Array] = []
        self._steps: list[Array] = []

    def times(self, h: Array) -> Array:
        """Return B h."""
        out = h.copy()
        for c, s in zip(self._corrections, self._steps, strict=True):
            out += c * self._inner(s, h)
        return out

    def update(self, step: Array, change: Array) -> None:
        """Make B step = change, keeping B on the orthogonal complement of step."""
        length = self._inner(step, step)
        if length > 0.0:
            self._corrections.append((change - self.times(step)) / length)
            self._steps.append(step)

    def solve(self, r: Array) -> Array:
        """Return B^-1 r by the Sherman-Morrison-Woodbury formula.

        Where B is singular, the solution with the smallest correction.
        """
        if not self._steps:
            return r.copy()
        inner = self._inner
        gram = np.array([[inner(s, c) for c in self._corrections] for s in self._steps])
        dual = np.array([inner(s, r) for s in self._steps])
        left, scale, right = np.linalg.svd(np.eye(len(gram)) + gram)
        inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > _SINGULAR)
        weights = right.T @ (inverse * (left.T @ dual))
        return r - sum(w * c for w, c in zip(weights, self._corrections, strict=True))


def aggressive_mapping(
    problem: MappingProblem,
    extract: Callable[[Array, Array], Array],
    project: Projection,
    inner: InnerProduct,
    budget: Budget,
    min_decrease: float = MIN_DECREASE,
    quasi_newton: bool = True,
    no_time_for: NoTimeFor = never,
) -> MappingResult:
    """Find u_f with T(u_f) = u_c, where T(u) = extract(fine(u)).

    extract(output, start) returns the coarse control that reproduces an output best, searched
    from start. The iterate with the least misfit is returned, so the result is never worse than
    u_c. Stops as the paper does: residual |T(u_f) - u_c| / |u_c| at most the budget's tolerance,
    or decreased by less than `min_decrease`, or no iterations left.

    Each step solves B h = -(T(u_f) - u_c) and projects u_f + h. The secant of the update
    uses the step actually taken, which with the projection differs from h. Without
    quasi_newton there is no update: B = I throughout.
    """
    fine, misfit, u_coarse = problem.fine, problem.misfit, problem.u_coarse
    scale = math.sqrt(inner(u_coarse, u_coarse)) or 1.0
    broyden = Broyden(inner)
    u = extracted = u_coarse
    step = residual = np.zeros_like(u)
    output = fine(u)
    misfits = [misfit(output)]
    best = (misfits[0], u, output)
    residuals: list[float] = []
    status = Status.ITERATION_LIMIT
    while True:
        if no_time_for(EXTRACTION):
            status = Status.OUT_OF_TIME
            break
        extracted = extract(output, extracted)
        previous, residual = residual, extracted - u_coarse
        if quasi_newton:
            broyden.update(step, residual - previous)
        residuals.append(math.sqrt(inner(residual, residual)) / scale)
        if residuals[-1] <= budget.tolerance:
            status = Status.CONVERGED
            break
        if len(residuals) > 1 and residuals[-2] - residuals[-1] < min_decrease:
            status = Status.STAGNATED
            break
        if len(residuals) > budget.max_iterations:
            break
        if no_time_for(FINE):
            status = Status.OUT_OF_TIME
            break
        u_next = project(u - broyden.solve(residual))
        step, u = u_next - u, u_next
        output = fine(u)
        misfits.append(misfit(output))
        if misfits[-1] < best[0]:
            best = (misfits[-1], u, output)
    return MappingResult(best[1], best[2], status, tuple(residuals), tuple(misfits))


def output_mapping(
    problem: MappingProblem,
    coarse: Callable[[Array], Array],
    match: Callable[[Array, Array, float], Array],
    damping: float,
    budget: Budget,
    no_time_for: NoTimeFor = never,
) -> MappingResult:
    """Find u_f whose fine output is that of u_coarse in the coarse model, by defect correction.

    The coarse model plus the defect fine(u) - coarse(u) at the best u so far is a better
    coarse model: match(target, u, damping) returns the admissible control near u, kept there
    by the weight damping, whose coarse output is the target less that defect (output space
    mapping; Echeverria and Hemker 2005 on defect correction). Where the aggressive mapping
    mirrors a control that is at its limit, and loses what leaves the admissible set, each step
    here respects the limits. The damping falls tenfold after a success and rises tenfold after
    a failure (Levenberg and Marquardt). Ends when the misfit is at most the budget's tolerance.
    """
    fine, misfit, u_coarse = problem.fine, problem.misfit, problem.u_coarse
    target = coarse(u_coarse)
    best = u_coarse
    best_output = fine(best)
    misfits = [misfit(best_output)]
    best_misfit = misfits[0]
    status = Status.ITERATION_LIMIT
    while best_misfit > budget.tolerance and len(misfits) <= budget.max_iterations:
        if no_time_for(EXTRACTION):
            status = Status.OUT_OF_TIME
            break
        defect = best_output - coarse(best)
        u = match(target - defect, best, damping)
        if no_time_for(FINE):
            status = Status.OUT_OF_TIME
            break
        u_output = fine(u)
        misfits.append(misfit(u_output))
        if misfits[-1] < best_misfit:
            best, best_output, best_misfit = u, u_output, misfits[-1]
            damping /= _DAMPING_FACTOR
        else:
            damping *= _DAMPING_FACTOR
    if best_misfit <= budget.tolerance:
        status = Status.CONVERGED
    return MappingResult(best, best_output, status, (), tuple(misfits))
