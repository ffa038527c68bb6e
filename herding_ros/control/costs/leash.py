# SPDX-License-Identifier: Apache-2.0
"""Dogs should not run off."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array, Trajectory
import numpy as np

from .cost import Derivatives


@dataclass(frozen=True)
class Leash:
    """Distance of the dogs from the reference of the flock.

    C = int c/2 sum_m |d_m - Z|^2 dt with c = weight and Z = reference (K+1, 2) [m].
    """

    weight: float
    reference: Array

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return C and its derivative by the positions of the dogs, c dt (d_m - Z)."""
        away = trajectory.ds[1:, :2] - self.reference[1:, :, None]
        value = 0.5 * trajectory.dt * self.weight * float(np.square(away).sum())
        derivative = np.zeros_like(trajectory.ds)
        derivative[1:, :2] = trajectory.dt * self.weight * away
        return value, Derivatives(d=derivative)
