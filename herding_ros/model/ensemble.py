"""Monte Carlo expectation of the fine model with common random numbers."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import os

import numpy as np

from . import kernels
from .dynamics import check_control, physics, to_lanes
from .parameters import Crowd
from .state import Array, HerdState

# Paths are summed in blocks of this fixed size and the blocks in their order, so that the
# result does not depend on the number of threads.
_PATHS_PER_BLOCK = 4


def expected_positions(
    crowd: Crowd,
    state: HerdState,
    u: Array,
    dt: float,
    substeps: int,
    noise: Array,
    threads: int | None = None,
) -> Array:
    """Mean positions (K+1, N, 2) [m] of the sheep over the given noise paths.

    u and substeps as in `rollout`; noise (paths, K, 2, lanes) from `increments`. Handing in
    the same noise for different controls (common random numbers) makes the result a smooth,
    repeatable function of the control. Runs on all cores by default, and gives the same bits
    for any number of threads.
    """
    n, m = len(state.x), len(state.d)
    u = check_control(u, m)
    paths, steps = noise.shape[:2]
    shape = (steps, 2, kernels.lanes(n))
    if steps != len(u) * substeps or noise.shape[1:] != shape or not paths:
        raise ValueError(
            f'noise has shape {noise.shape}, allowed is at least one path of shape '
            f'{(len(u) * substeps, 2, kernels.lanes(n))}'
        )
    x, v, d = to_lanes(state.x), to_lanes(state.v), np.ascontiguousarray(state.d.T)
    constants = physics(crowd, n, dt)

    def sum_of_block(first: int) -> Array:
        total = np.zeros((steps + 1, *shape[1:]))
        block = noise[first : first + _PATHS_PER_BLOCK]
        kernels.add_paths(total, x, v, d, u, substeps, block, constants)
        return total

    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        total = sum(pool.map(sum_of_block, range(0, paths, _PATHS_PER_BLOCK)))
    return np.asarray(total)[:, :, :n].transpose(0, 2, 1) / paths
