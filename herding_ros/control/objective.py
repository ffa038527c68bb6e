# SPDX-License-Identifier: Apache-2.0
"""The cost J of a plan and its partial derivatives (paper, cost functional)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from herding_ros.model.state import Array, Trajectory

from .costs.containment import Containment
from .costs.cost import Cost, Derivatives
from .costs.distance import Distance
from .costs.leash import Leash
from .costs.terminal import Terminal
from .costs.tracking import Tracking
from .parameters import Weights


@dataclass(frozen=True)
class Objective:
    """A sum of costs, itself a cost."""

    costs: Sequence[Cost]

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return the sum of the values and that of the partial derivatives."""
        total, by = 0.0, Derivatives()
        for cost in self.costs:
            value, derivatives = cost.value_and_derivatives(trajectory, u)
            total, by = total + value, by + derivatives
        return total, by


def weighted_costs(weights: Weights, reference: Array, rounding: float) -> list[Cost]:
    """Return the costs of sheep and dogs that the weights ask for, control effort apart.

    reference: (K+1, 2) [m]; rounding: of distances [m], see `Distance`. A cost without weight is
    left out.
    """
    costs = _running_costs(weights, reference, rounding)
    if weights.terminal:
        last = _running_costs(weights, reference[-2:], rounding)
        costs.append(Terminal(weights.terminal, last))
    if weights.containment:
        costs.append(Containment(weights.containment, weights.radius, reference))
    if weights.dogs:
        costs.append(Leash(weights.dogs, reference))
    return costs


def _running_costs(weights: Weights, reference: Array, rounding: float) -> list[Cost]:
    costs: list[Cost] = [Tracking(weights.centre, weights.spread, reference)]
    if weights.distance:
        costs.append(Distance(weights.distance, rounding, reference))
    return costs
