# SPDX-License-Identifier: Apache-2.0
"""No sheep should be outside a disc."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array, Trajectory
import numpy as np

from .cost import Derivatives


@dataclass(frozen=True)
class Containment:
    """What sheep outside a disc cost; those inside cost nothing.

    C = int w/(3N) sum_i e_i^3 dt,   e_i = max(|x_i - Z| - R, 0)

    with w = weight [1/m], R = radius [m] and Z = centre [m], (2,), or (K+1, 2) for a disc that
    moves. The third power is the lowest with a continuous second derivative.
    """

    weight: float
    radius: float
    centre: Array

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return C and its derivative by x, w dt / N e_i^2 s_i / |s_i| with s_i = x_i - Z."""
        offset = trajectory.xs[:, :, : trajectory.n] - self.centre[..., None]
        distance = np.linalg.norm(offset, axis=1, keepdims=True)
        excess = np.maximum(distance - self.radius, 0.0)
        excess[0] = 0.0
        direction = np.divide(offset, distance, out=np.zeros_like(offset), where=distance > 0.0)
        scale = self.weight * trajectory.dt / trajectory.n
        derivative = np.zeros_like(trajectory.xs)
        derivative[:, :, : trajectory.n] = scale * np.square(excess) * direction
        return scale / 3.0 * float((excess**3).sum()), Derivatives(x=derivative)
