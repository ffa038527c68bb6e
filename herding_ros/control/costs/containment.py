"""Nobody shall be outside a disc."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from herding_ros.model.state import Array, Trajectory


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

    def value_and_derivative(self, trajectory: Trajectory) -> tuple[float, Array]:
        """Return C and its derivative by xs, w dt / N e_i^2 s_i / |s_i| with s_i = x_i - Z."""
        excess, direction, _ = self._outside(trajectory)
        scale = self.weight * trajectory.dt / trajectory.n
        derivative = np.zeros_like(trajectory.xs)
        derivative[:, :, : trajectory.n] = scale * np.square(excess) * direction
        return scale / 3.0 * float((excess**3).sum()), derivative

    def second_derivative(self, trajectory: Trajectory, dx: Array) -> Array:
        """Return the Hessian times dx: 2 e along s_i, and e^2 / |s_i| across."""
        excess, direction, distance = self._outside(trajectory)
        change = dx[:, :, : trajectory.n]
        along = (direction * change).sum(axis=1, keepdims=True) * direction
        per_distance = np.divide(excess, distance, out=np.zeros_like(excess), where=excess > 0.0)
        out = np.zeros_like(dx)
        out[:, :, : trajectory.n] = (
            self.weight * trajectory.dt / trajectory.n
            * excess * (2.0 * along + per_distance * (change - along))
        )  # fmt: skip
        return out

    def _outside(self, trajectory: Trajectory) -> tuple[Array, Array, Array]:
        """Return e_i (K+1, 1, N), zero at the start; s_i / |s_i| (K+1, 2, N), and |s_i|."""
        offset = trajectory.xs[:, :, : trajectory.n] - self.centre[..., None]
        distance = np.linalg.norm(offset, axis=1, keepdims=True)
        excess = np.maximum(distance - self.radius, 0.0)
        excess[0] = 0.0
        direction = np.divide(offset, distance, out=np.zeros_like(offset), where=distance > 0.0)
        return excess, direction, distance
