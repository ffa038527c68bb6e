"""Monte Carlo expectation of the fine model with common random numbers."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
import os

import numpy as np

from . import kernels
from .crowd import Crowd
from .dynamics import check_control, physics, to_lanes
from .kernels import PATHS
from .noise import factor, is_uniform, NoisePaths
from .state import Array, HerdState


def expected_positions(
    crowd: Crowd,
    state: HerdState,
    u: Array,
    dt: float,
    substeps: int,
    noise: NoisePaths,
    threads: int | None = None,
    t: float = 0.0,
) -> Array:
    """Mean positions (K+1, N, 2) [m] of the sheep over the given noise paths.

    u, substeps and t as in `rollout`. Handing in the same noise for different controls (common
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
        drawn = noise.blocks[block]
        if is_uniform(crowd.noise_field):
            kernels.add_paths(total, x, v, d, u, substeps, drawn, used, constants)
        else:
            start = (x[:, :n], v[:, :n], d)
            xs = paths_in_field(crowd, t, *start, u, substeps, drawn, constants)
            for k, here in enumerate(xs):
                total[k] = here.reshape(2, n, PATHS)[..., :used].sum(axis=-1)
        return total

    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        total = sum(pool.map(sum_of_block, range(len(noise.blocks))))
    return np.asarray(total).transpose(0, 2, 1) / noise.paths


def paths_in_field(
    crowd: Crowd,
    t: float,
    x: Array,
    v: Array,
    d: Array,
    u: Array,
    substeps: int,
    noise: Array,
    physics: kernels.Physics,
) -> Iterator[Array]:
    """Yield the positions in some paths at each step, where the noise depends on time and place.

    They start at t [s] from x, v (2, N) and d (2, M); noise (K, 2, N * paths) has the paths of a
    sheep side by side, and so have the positions (2, N * paths) [m].
    """
    xs, vs = (np.repeat(each, noise.shape[2] // x.shape[1], axis=1) for each in (x, v))
    ds = d
    a = np.empty_like(xs)
    for k in range(len(noise)):
        yield xs
        scaled = factor(crowd, t + k * physics.dt, xs) * noise[k]
        following = np.empty_like(xs), np.empty_like(vs), np.empty_like(ds)
        kernels.acceleration_in_paths(xs, ds, physics, a)
        kernels.step(xs, vs, ds, u[k // substeps], a, scaled, physics, *following)
        xs, vs, ds = following
    yield xs
