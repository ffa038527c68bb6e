# SPDX-License-Identifier: Apache-2.0
"""The flock should be where the reference is, and each metre counts the same."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array, Trajectory
import numpy as np

from .cost import Derivatives


@dataclass(frozen=True)
class Distance:
    """Distance of the flock's centre from the reference.

    C = int w (sqrt(|xc - Z|^2 + e^2) - e) dt

    with xc the centre of mass, w = weight [m], e = rounding [m] and Z = reference (K+1, 2) [m].
    A square would hardly ask for the last tenth of a metre, and for nothing but haste while the
    flock is far off.
    """

    weight: float
    rounding: float
    reference: Array

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return C and its derivative by x, w dt / N (xc - Z) / sqrt(|xc - Z|^2 + e^2)."""
        sheep = trajectory.xs[:, :, : trajectory.n]
        off = sheep.mean(axis=2) - self.reference
        off[0] = 0.0
        length = np.sqrt(np.square(off).sum(axis=1) + self.rounding**2)
        scale = self.weight * trajectory.dt
        derivative = np.zeros_like(trajectory.xs)
        by_centre = scale / trajectory.n * off / length[:, None]
        derivative[:, :, : trajectory.n] = by_centre[:, :, None]
        return scale * float((length - self.rounding).sum()), Derivatives(x=derivative)
