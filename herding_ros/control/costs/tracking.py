# SPDX-License-Identifier: Apache-2.0
"""The flock should be where the reference is, and together."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array, Trajectory
from herding_ros.model.tracking_cost import tracking_cost
import numpy as np

from .cost import Derivatives


@dataclass(frozen=True)
class Tracking:
    """Distance of the flock's centre from the reference, and of the sheep from their centre.

    C = int a/2 |xc - Z|^2 + b/(2N) sum_i |x_i - xc|^2 dt

    with xc the centre of mass, a = centre_weight, b = spread_weight and Z = reference (K+1, 2)
    [m]. Since 1/N sum |x_i - Z|^2 = |xc - Z|^2 + 1/N sum |x_i - xc|^2, the paper's cost is
    a = b = 1.
    """

    centre_weight: float
    spread_weight: float
    reference: Array

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return C and its derivative by the positions of the sheep."""
        value, derivative = self.value_and_derivative(trajectory)
        return value, Derivatives(x=derivative)

    def value_and_derivative(self, trajectory: Trajectory) -> tuple[float, Array]:
        """Return C and its derivative (K+1, 2, lanes) by the positions of the sheep."""
        derivative = np.empty_like(trajectory.xs)
        value = tracking_cost(
            trajectory.xs,
            self.reference,
            trajectory.n,
            self.centre_weight,
            self.spread_weight,
            trajectory.dt,
            derivative,
        )
        return value, derivative
