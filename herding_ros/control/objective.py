"""The cost J of a plan and its partial derivatives (paper, cost functional)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from herding_ros.model.state import Array, Trajectory

from .costs.containment import Containment
from .costs.cost import Cost
from .costs.leash import Leash
from .costs.terminal import Terminal
from .costs.tracking import Tracking
from .parameters import Weights


@dataclass(frozen=True)
class Objective:
    """Cost of a trajectory under a control u: a sum of terms.

    J = sum of costs + int gamma/2 |u - u_ref|^2 dt + leash

    with gamma = control_weight and u_ref = control_reference (intervals, M, 2) [m/s]. The costs
    are functions of the sheep's positions; that of the dogs' positions is the leash, if any.
    """

    costs: Sequence[Cost]
    control_weight: float
    control_reference: Array
    leash: Leash | None = None

    @classmethod
    def weighted(
        cls,
        weights: Weights,
        reference: Array,
        control_reference: Array,
        further: Sequence[Cost] = (),
    ) -> Objective:
        """Return the objective with these weights, a reference (K+1, 2) [m] and further costs."""
        tracking = Tracking(weights.centre, weights.spread, reference)
        costs: list[Cost] = [tracking]
        if weights.terminal:
            costs.append(Terminal(weights.terminal, tracking))
        if weights.containment:
            costs.append(Containment(weights.containment, weights.radius, reference))
        leash = Leash(weights.dogs, reference) if weights.dogs else None
        return cls([*costs, *further], weights.control, control_reference, leash)

    def value_and_derivatives(
        self, trajectory: Trajectory, u: Array, interval: float
    ) -> tuple[float, Array, Array]:
        """Return J and its derivatives at fixed controls and at fixed sheep.

        The first is the partial derivative with respect to x, shape of trajectory.xs; the
        second the gradient in L2(0, T) of the cost of controls and dogs, shape of u, since a
        dog is where its control has brought it. interval [s] is the time for which each u
        (intervals, M, 2) [m/s] is held.
        """
        value, source = self.costs[0].value_and_derivative(trajectory)
        for cost in self.costs[1:]:
            more, derivative = cost.value_and_derivative(trajectory)
            value += more
            source += derivative
        change = u - self.control_reference
        value += 0.5 * interval * self.control_weight * float(np.square(change).sum())
        direct = self.control_weight * change
        if self.leash is not None:
            more, gradient = self.leash.value_and_gradient(trajectory, len(u))
            value += more
            direct += gradient
        return value, source, direct
