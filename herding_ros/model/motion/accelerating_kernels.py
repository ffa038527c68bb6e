# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of dogs whose acceleration is limited."""

from __future__ import annotations

from herding_ros.model.jit import kernel
from herding_ros.model.state import Array
import numpy as np


@kernel
def rollout(ds: Array, u: Array, dt: float, substeps: int, most: float) -> None:
    """Fill ds[K+1, 4, M] from its first entry; u[intervals, M, 2].

    In a step a velocity changes by at most `most`.
    """
    for k in range(ds.shape[0] - 1):
        for m in range(ds.shape[2]):
            x = u[k // substeps, m, 0] - ds[k, 2, m]
            y = u[k // substeps, m, 1] - ds[k, 3, m]
            length = np.sqrt(x * x + y * y)
            if length <= most:
                ds[k + 1, 2, m], ds[k + 1, 3, m] = u[k // substeps, m, 0], u[k // substeps, m, 1]
            else:
                ds[k + 1, 2, m] = ds[k, 2, m] + most / length * x
                ds[k + 1, 3, m] = ds[k, 3, m] + most / length * y
            for c in range(2):
                ds[k + 1, c, m] = ds[k, c, m] + dt * ds[k + 1, 2 + c, m]


@kernel
def transpose(
    source: Array, ds: Array, u: Array, dt: float, substeps: int, most: float, out: Array
) -> None:
    """Add to out[intervals, M, 2, n] the transpose of the derivative of `rollout` at ds and u.

    source[K+1, 4, M, n] is per unit of time, as in `MotionModel.transpose`.
    """
    after = np.zeros(source.shape[1:])  # by the states at k + 1
    for k in range(ds.shape[0] - 2, -1, -1):
        for m in range(ds.shape[2]):
            x = u[k // substeps, m, 0] - ds[k, 2, m]
            y = u[k // substeps, m, 1] - ds[k, 3, m]
            length = np.sqrt(x * x + y * y)
            limited = length > most
            if limited:
                x, y = x / length, y / length
            for f in range(source.shape[3]):
                for c in range(4):
                    after[c, m, f] += dt * source[k + 1, c, m, f]
                by_x = after[2, m, f] + dt * after[0, m, f]
                by_y = after[3, m, f] + dt * after[1, m, f]
                to_x, to_y = by_x, by_y
                if limited:
                    along = x * by_x + y * by_y
                    to_x, to_y = (
                        most / length * (by_x - along * x),
                        most / length * (by_y - along * y),
                    )
                out[k // substeps, m, 0, f] += to_x
                out[k // substeps, m, 1, f] += to_y
                after[2, m, f], after[3, m, f] = by_x - to_x, by_y - to_y
