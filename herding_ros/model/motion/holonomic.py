# SPDX-License-Identifier: Apache-2.0
"""Dogs whose velocity is the command at once (paper, state system)."""

from __future__ import annotations

from dataclasses import dataclass
import math

from herding_ros.model.parameters import Parameters
from herding_ros.model.state import Array
import numpy as np

_ROUND_OFF = 3.0 * np.finfo(np.float64).eps


@dataclass(frozen=True)
class Holonomic(Parameters):
    """d' = u with |u| <= max_speed: the state is the position, S = 2. See `MotionModel`."""

    def project(self, u: Array, max_speed: float) -> Array:
        """Shorten commands u (..., 2) that are faster than max_speed [m/s]."""
        # A program's help needs no Numba; a relative import takes longer than the work.
        from herding_ros.model.motion.holonomic_kernels import shorten

        out = np.array(u, dtype=np.float64, order='C')
        shorten(out.reshape(-1, 2), max_speed, _ROUND_OFF)
        return out

    def rollout(self, d: Array, u: Array, dt: float, substeps: int) -> Array:
        """Return the positions (K+1, 2, M) under u (intervals, M, 2): d_k+1 = d_k + dt u_k."""
        ds = np.empty((len(u) * substeps + 1, 2, len(d)))
        ds[0] = d.T
        from .holonomic_kernels import rollout

        rollout(ds, u, dt, substeps)
        return ds

    def transpose(self, ds: Array, u: Array, source: Array, dt: float, substeps: int) -> Array:
        """Return derivatives with respect to u: each command moves its dog at all later steps."""
        from .holonomic_kernels import transpose

        intervals, dogs, _ = u.shape
        rows = np.zeros((intervals, 2, source[0, 0].size))
        transpose(source.reshape(len(source), 2, -1), dt, substeps, rows)
        rows = rows.reshape(intervals, 2, dogs, *source.shape[3:])
        return np.ascontiguousarray(np.moveaxis(rows, 1, 2))

    def state(self, position: Array, heading: Array, velocity: Array) -> Array:
        """Return the position."""
        return position

    def odometry(self, d: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return position d, heading 0 (a holonomic dog need not turn), and velocity u."""
        return d, np.zeros(len(d)), u

    def largest_change(self, seconds: float) -> float:
        """Return infinity: a dog follows any change at once."""
        return math.inf

    def directions(self, d: Array) -> Array | None:
        """Return None: a dog moves with the velocity that is its command."""
        return None

    def bend(self, max_speed: float, seconds: float, distance: float) -> float:
        """Return 0: ways are straight."""
        return 0.0
