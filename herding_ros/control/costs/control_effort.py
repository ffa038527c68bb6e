# SPDX-License-Identifier: Apache-2.0
"""Dogs should not run more than they need to."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array, Trajectory
import numpy as np

from .cost import Derivatives

_SHORT = 0.01
"""Part of the step to the minimum of control effort alone that is short."""


@dataclass(frozen=True)
class ControlEffort:
    """Distance of the control from a reference (paper, cost functional, last term).

    C = int gamma/2 |u - u_ref|^2 dt with gamma = weight [s^2] and u_ref = reference [m/s], in
    the shape of u or a number.
    """

    weight: float
    reference: Array | float = 0.0

    @property
    def step(self) -> float:
        """Factor [1/s^2] that makes a short step of minus the gradient of a cost with this part.

        The curvature of such a cost is about gamma at least.
        """
        return _SHORT / self.weight

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return C and its gradient gamma (u - u_ref)."""
        interval = trajectory.dt * ((len(trajectory.xs) - 1) // len(u))
        change = u - self.reference
        value = 0.5 * interval * self.weight * float(np.square(change).sum())
        return value, Derivatives(u=self.weight * change)
