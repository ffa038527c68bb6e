# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of holonomic dogs."""

from __future__ import annotations

from herding_ros.model.jit import kernel
from herding_ros.model.state import Array
import numpy as np


@kernel
def rollout(d: Array, u: Array, dt: float, substeps: int) -> None:
    """Fill d[K+1, 2, M] from its first entry; u[intervals, M, 2]."""
    for k in range(d.shape[0] - 1):
        for c in range(2):
            for m in range(d.shape[2]):
                d[k + 1, c, m] = d[k, c, m] + dt * u[k // substeps, m, c]


@kernel
def transpose(source: Array, dt: float, substeps: int, out: Array) -> None:
    """Add to out[intervals, 2, lanes] the transpose of `rollout` on source[K+1, 2, lanes]."""
    nu = np.zeros(source.shape[1:])
    for k in range(source.shape[0] - 2, -1, -1):
        for c in range(2):
            for i in range(source.shape[2]):
                nu[c, i] += dt * source[k + 1, c, i]
                out[k // substeps, c, i] += dt * nu[c, i]


@kernel
def shorten(u: Array, limit: float, round_off: float) -> None:
    """Shorten those of u[n, 2] that are longer than the limit, to the limit.

    Rounded down, so that the result keeps the limit and a second time changes nothing.
    """
    for i in range(u.shape[0]):
        length = np.sqrt(u[i, 0] * u[i, 0] + u[i, 1] * u[i, 1])
        if length > limit:
            factor = limit * (1.0 - round_off) / length
            u[i, 0] *= factor
            u[i, 1] *= factor
