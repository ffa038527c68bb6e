# SPDX-License-Identifier: Apache-2.0
"""How far a control is from a plan, measured by what dogs and controls cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from herding_ros.model.state import Array, Trajectory

from .adjoint import CoarseModel
from .costs.cost import Cost
from .objective import Objective


@dataclass(frozen=True)
class BregmanDistance:
    """D(u) = C(u) - C(w) - <C'(w), u - w>, of the costs C with the sheep held on a trajectory.

    w is the plan; the dogs move with u, the sheep stay on the plan's trajectory. At the plan D
    and its gradient vanish, so that what the costs ask for is kept there, and D is what they
    charge for leaving it (>= 0 if they are convex).
    """

    coarse: CoarseModel
    costs: Objective
    planned: Trajectory
    plan: Array
    value: float
    gradient: Array

    @classmethod
    def from_plan(
        cls, coarse: CoarseModel, costs: Sequence[Cost], plan: Array
    ) -> BregmanDistance | None:
        """Return the distance from a plan; None if no cost depends on dogs or controls."""
        planned = coarse.rollout(plan)
        parts = [cost.value_and_derivatives(planned, plan)[1] for cost in costs]
        seeing = [
            cost
            for cost, by in zip(costs, parts, strict=True)
            if by.d is not None or by.u is not None
        ]
        if not seeing:
            return None
        objective = Objective(seeing)
        raw = cls(coarse, objective, planned, plan, 0.0, np.zeros_like(plan))
        value, gradient = raw.costs_of(plan)
        return replace(raw, value=value, gradient=gradient)

    def costs_of(self, u: Array) -> tuple[float, Array]:
        """Return C and its gradient in L2(0, T) at u, which takes no rollout of sheep."""
        moved = replace(self.planned, ds=self.coarse.dogs(u))
        value, by = self.costs.value_and_derivatives(moved, u)
        return value, self.coarse.dogs_gradient(moved.ds, u, by)

    def __call__(self, u: Array) -> tuple[float, Array]:
        """Return D and its gradient in L2(0, T) at u."""
        value, gradient = self.costs_of(u)
        change = self.coarse.inner(self.gradient, u - self.plan)
        return value - self.value - change, gradient - self.gradient
