# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of dogs that have to turn."""

from __future__ import annotations

from herding_ros.model.jit import kernel
from herding_ros.model.state import Array
import numpy as np


@kernel
def rollout(ds: Array, u: Array, dt: float, substeps: int, ahead: float) -> None:
    """Fill ds[K+1, 3, M] from its first entry; u[intervals, M, 2]."""
    for i in range(u.shape[0]):
        for m in range(u.shape[1]):
            cos, sin = np.cos(ds[i * substeps, 2, m]), np.sin(ds[i * substeps, 2, m])
            v = cos * u[i, m, 0] + sin * u[i, m, 1]
            w = (cos * u[i, m, 1] - sin * u[i, m, 0]) / ahead
            for k in range(i * substeps, (i + 1) * substeps):
                middle = ds[k, 2, m] + 0.5 * dt * w
                ds[k + 1, 0, m] = ds[k, 0, m] + dt * v * np.cos(middle)
                ds[k + 1, 1, m] = ds[k, 1, m] + dt * v * np.sin(middle)
                ds[k + 1, 2, m] = ds[k, 2, m] + dt * w


@kernel
def transpose(
    source: Array, ds: Array, u: Array, dt: float, substeps: int, ahead: float, out: Array
) -> None:
    """Add to out[intervals, M, 2, n] the transpose of the derivative of `rollout` at ds and u.

    source[K+1, 3, M, n] is per unit of time, as in `MotionModel.transpose`.
    """
    after = np.zeros(source.shape[1:])  # by the states at k + 1
    for i in range(u.shape[0] - 1, -1, -1):
        for m in range(u.shape[1]):
            cos, sin = np.cos(ds[i * substeps, 2, m]), np.sin(ds[i * substeps, 2, m])
            v = cos * u[i, m, 0] + sin * u[i, m, 1]
            w = (cos * u[i, m, 1] - sin * u[i, m, 0]) / ahead
            for f in range(source.shape[3]):
                by_v = by_w = 0.0
                for k in range((i + 1) * substeps - 1, i * substeps - 1, -1):
                    for c in range(3):
                        after[c, m, f] += dt * source[k + 1, c, m, f]
                    middle = ds[k, 2, m] + 0.5 * dt * w
                    along, across = np.cos(middle), np.sin(middle)
                    x, y, turn = after[0, m, f], after[1, m, f], after[2, m, f]
                    by_middle = dt * v * (along * y - across * x)
                    by_v += dt * (along * x + across * y)
                    by_w += dt * (turn + 0.5 * by_middle)
                    after[2, m, f] = turn + by_middle
                out[i, m, 0, f] += cos * by_v - sin * by_w / ahead
                out[i, m, 1, f] += sin * by_v + cos * by_w / ahead
                after[2, m, f] += ahead * w * by_v - v * by_w / ahead
