# SPDX-License-Identifier: Apache-2.0
"""What leaving a plan adds to the costs of dogs and controls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from herding_ros.model.state import Array, Trajectory
import numpy as np

from .coarse_model import CoarseModel
from .costs.cost import Cost
from .objective import Objective

_SMOOTHING = 0.1


@dataclass(frozen=True)
class AddedCost:
    """D(u) = phi(C(u) - C(w)) with C the costs of dogs and controls, and w the plan.

    The dogs move with u; the sheep stay on the plan's trajectory. phi(s) is s where that is
    positive and zero otherwise, rounded off within 0 < s < e = |C(w)| / 10: s^2 / (2 e) there and
    s - e / 2 beyond. D vanishes at the plan with its gradient and is never negative, for any C.
    (A Bregman distance is, where C is not convex, such as for dogs that should keep apart.)
    """

    coarse: CoarseModel
    costs: Objective
    planned: Trajectory
    value: float
    """C(w)."""

    @classmethod
    def to_plan(cls, coarse: CoarseModel, costs: Sequence[Cost], plan: Array) -> AddedCost | None:
        """Return what is added to a plan; None if no cost depends on dogs or controls."""
        planned, total, seeing = coarse.rollout(plan), 0.0, []
        for cost in costs:
            value, by = cost.value_and_derivatives(planned, plan)
            if by.d is not None or by.u is not None:
                total += value
                seeing.append(cost)
        return cls(coarse, Objective(seeing), planned, total) if seeing else None

    def __call__(self, u: Array) -> tuple[float, Array]:
        """Return D and its gradient in L2(0, T) at u, which takes no rollout of sheep."""
        moved = replace(self.planned, ds=self.coarse.dogs(u))
        value, by = self.costs.value_and_derivatives(moved, u)
        added, width = value - self.value, _SMOOTHING * abs(self.value)
        if added <= 0.0:
            return 0.0, np.zeros_like(u)
        gradient = self.coarse.gradient(moved, u, replace(by, x=None))
        if added < width:
            return added**2 / (2.0 * width), added / width * gradient
        return added - 0.5 * width, gradient
