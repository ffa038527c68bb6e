# SPDX-License-Identifier: Apache-2.0
"""Dogs whose velocity follows the command with a limited acceleration."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.parameters import quantity, TINY
from herding_ros.model.state import Array
import numpy as np

from .holonomic import Holonomic


@dataclass(frozen=True)
class Accelerating(Holonomic):
    """The velocity v approaches the command u with at most the acceleration b: S = 4.

        v_k+1 = v_k + P(u - v_k),    d_k+1 = d_k + dt v_k+1

    with P the projection onto the disc of radius dt b. The state is (d, v); commands are those of
    `Holonomic`, which this is for a large b.
    """

    acceleration: float = quantity(
        0.02, 'a dog gains or loses speed no faster than this', 'm/s^2', low=TINY
    )

    def rollout(self, d: Array, u: Array, dt: float, substeps: int) -> Array:
        """Return the states (K+1, 4, M) under u (intervals, M, 2)."""
        from .accelerating_kernels import rollout

        ds = np.empty((len(u) * substeps + 1, 4, len(d)))
        ds[0] = d.T
        rollout(ds, u, dt, substeps, dt * self.acceleration)
        return ds

    def transpose(self, ds: Array, u: Array, source: Array, dt: float, substeps: int) -> Array:
        """Return derivatives with respect to u; see `MotionModel`."""
        from .accelerating_kernels import transpose

        intervals, dogs, _ = u.shape
        several = np.ascontiguousarray(source).reshape(len(source), 4, dogs, -1)
        out = np.zeros((intervals, dogs, 2, several.shape[3]))
        transpose(several, ds, u, dt, substeps, dt * self.acceleration, out)
        return out.reshape(*u.shape, *source.shape[3:])

    def state(self, position: Array, heading: Array, velocity: Array) -> Array:
        """Return position and velocity."""
        return np.concatenate([position, velocity], axis=1)

    def odometry(self, d: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return position, heading 0 (the dog need not turn), and velocity."""
        return d[:, :2], np.zeros(len(d)), d[:, 2:]

    def largest_change(self, seconds: float) -> float:
        """Return what the acceleration allows [m/s]."""
        return self.acceleration * seconds

    def bend(self, max_speed: float, seconds: float, distance: float) -> float:
        """Return what comes of the line between two dogs turning while velocities still change."""
        turn = min(2.0 * max_speed * seconds / max(distance, TINY), 1.0)
        change = min(2.0 * self.largest_change(seconds), 4.0 * max_speed)
        return 0.5 * turn * change * seconds
