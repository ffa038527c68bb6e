# SPDX-License-Identifier: Apache-2.0
"""Where the flock is at the end of the window counts more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from herding_ros.model.state import Array, Trajectory
import numpy as np

from .cost import Cost, Derivatives


@dataclass(frozen=True)
class Terminal:
    """What running costs of sheep come to over a last step of length weight [s].

    `costs` are for the last two instants of the window: references have two rows.
    """

    weight: float
    costs: Sequence[Cost]

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return the sum of the costs and its derivative by the positions of the sheep."""
        xs, vs, ds = trajectory.xs[-2:], trajectory.vs[-2:], trajectory.ds[-2:]
        last_step = Trajectory(self.weight, trajectory.n, xs, vs, ds)
        derivative = np.zeros_like(trajectory.xs)
        total = 0.0
        for cost in self.costs:
            value, by = cost.value_and_derivatives(last_step, u)
            assert by.x is not None
            total += value
            derivative[-2:] += by.x
        return total, Derivatives(x=derivative)
