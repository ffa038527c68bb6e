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
