"""Monte Carlo expectation of the fine model with common random numbers."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
import os

import numpy as np

from . import kernels
from .crowd import Crowd
from .dynamics import check_control, march, physics, positions, to_lanes
from .kernels import PATHS
from .motion import Holonomic, MotionModel
from .noise import is_uniform, NoisePaths, random_force
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
    motion: MotionModel = Holonomic(),
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
    x, v = to_lanes(state.x), to_lanes(state.v)
    d = positions(motion.rollout(state.d, u, dt, substeps))
    constants = physics(crowd, n, dt)

    def sum_of_block(block: int) -> Array:
        total = np.zeros((steps + 1, 2, n))
        used = min(noise.paths - block * PATHS, PATHS)
        drawn = noise.blocks[block]
        if is_uniform(crowd.noise_field):
            kernels.add_paths(total, x, v, d, drawn, used, constants)
        else:
            xs = paths_in_field(crowd, t, x[:, :n], v[:, :n], d, drawn, constants)
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
    noise: Array,
    physics: kernels.Physics,
) -> Iterator[Array]:
    """Yield the positions in some paths at each step, where the noise depends on time and place.

    They start at t [s] from x, v (2, N), with the dogs on the path d (K+1, 2, M); noise
    (K, 2, N * paths) has the paths of a sheep side by side, and so have the positions
    (2, N * paths) [m].
    """
    xs, vs = (np.repeat(each, noise.shape[2] // x.shape[1], axis=1) for each in (x, v))
    a = np.empty_like(xs)

    def acceleration(k: int, here: Array) -> Array:
        kernels.acceleration_in_paths(here, d[k], physics, a)
        return a

    def noise_at(k: int, here: Array) -> Array:
        return random_force(crowd, t + k * physics.dt, here, noise[k])

    for here, _ in march(xs, vs, len(noise), physics, acceleration, noise_at):
        yield here
