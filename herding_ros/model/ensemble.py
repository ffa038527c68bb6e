"""Monte Carlo expectation of the fine model with common random numbers."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import os

import numpy as np

from . import kernels
from .crowd import Crowd
from .dynamics import check_control, physics, to_lanes
from .kernels import PATHS
from .state import Array, HerdState


@dataclass(frozen=True)
class NoisePaths:
    """Noise sigma dB of many paths, as the kernels want it.

    blocks (blocks, K, 2, n * PATHS) [m/s]: PATHS paths are integrated at once, those of a
    sheep side by side. The last block may hold more than is used: `paths` counts.
    """

    paths: int
    blocks: Array

    def path(self, i: int) -> Array:
        """Return the noise of path i as `rollout` wants it, (K, 2, lanes) [m/s]."""
        block, lane = divmod(range(self.paths)[i], PATHS)
        values = self.blocks[block, :, :, lane::PATHS]
        out = np.zeros((*values.shape[:2], kernels.lanes(values.shape[2])))
        out[:, :, : values.shape[2]] = values
        return out


def noise_paths(
    rng: np.random.Generator, crowd: Crowd, n: int, dt: float, steps: int, paths: int
) -> NoisePaths:
    """Draw sigma dB for n sheep and K = steps of dt [s], with dB ~ N(0, dt) each."""
    blocks = rng.standard_normal((-(-paths // PATHS), steps, 2, n * PATHS))
    blocks *= crowd.noise * np.sqrt(dt)
    return NoisePaths(paths, blocks)


def expected_positions(
    crowd: Crowd,
    state: HerdState,
    u: Array,
    dt: float,
    substeps: int,
    noise: NoisePaths,
    threads: int | None = None,
) -> Array:
    """Mean positions (K+1, N, 2) [m] of the sheep over the given noise paths.

    u and substeps as in `rollout`. Handing in the same noise for different controls (common
    random numbers) makes the result a smooth, repeatable function of the control. Runs on all
    cores by default. Blocks of paths are summed in their order, so that the result has the
    same bits for any number of threads.
    """
    n, m = len(state.x), len(state.d)
    u = check_control(u, m)
    steps = len(u) * substeps
    shape = (-(-noise.paths // PATHS), steps, 2, n * PATHS)
    if noise.blocks.shape != shape or noise.paths < 1:
        raise ValueError(
            f'{noise.paths} paths of noise have shape {noise.blocks.shape}, allowed is {shape} '
            'with at least one path'
        )
    x, v, d = to_lanes(state.x), to_lanes(state.v), np.ascontiguousarray(state.d.T)
    constants = physics(crowd, n, dt)

    def sum_of_block(block: int) -> Array:
        total = np.zeros((steps + 1, 2, n))
        used = min(noise.paths - block * PATHS, PATHS)
        kernels.add_paths(total, x, v, d, u, substeps, noise.blocks[block], used, constants)
        return total

    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        total = sum(pool.map(sum_of_block, range(len(noise.blocks))))
    return np.asarray(total).transpose(0, 2, 1) / noise.paths
