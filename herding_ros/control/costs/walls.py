# SPDX-License-Identifier: Apache-2.0
"""Dogs should keep away from walls."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array, Trajectory
import numpy as np

from .cost import Derivatives


@dataclass(frozen=True)
class Walls:
    """How near dogs are to walls.

    C = int w sum_m sum_s max(1 - r_ms / a, 0)^2 dt with w = weight [m^2], a = distance [m] and
    r_ms the distance of dog m from bar s of bars (S, 5), see `model/walls.py`.
    """

    weight: float
    distance: float
    bars: Array

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return C and its derivative by the positions of the dogs."""
        # A program's help needs no Numba.
        from herding_ros.model.walls import nearness

        derivative = np.zeros_like(trajectory.ds)
        scale = self.weight * trajectory.dt
        value = nearness(trajectory.ds, self.bars, self.distance, scale, derivative)
        return value, Derivatives(d=derivative)
