# SPDX-License-Identifier: Apache-2.0
"""Dogs should keep apart."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array, Trajectory
import numpy as np

from .cost import Derivatives


@dataclass(frozen=True)
class Spacing:
    """How near dogs are to each other.

    C = int w sum_{m<n} max(1 - |d_m - d_n|^2 / b^2, 0)^2 dt with w = weight [m^2] and
    b = distance [m], beyond which nothing is to pay.
    """

    weight: float
    distance: float

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return C and its derivative by the positions of the dogs."""
        # A program's help needs no Numba.
        from herding_ros.model.separation_kernels import spacing

        derivative = np.zeros_like(trajectory.ds)
        scale = self.weight * trajectory.dt
        value = spacing(trajectory.ds, self.distance**2, scale, derivative)
        return value, Derivatives(d=derivative)
