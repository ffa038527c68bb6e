# SPDX-License-Identifier: Apache-2.0
"""Compile the kernels, or load them from Numba's cache: `python -m herding_ros.model.warmup`."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
import time

import numpy as np

from . import kernels
from .crowd import Crowd, CROWDS
from .dynamics import physics, reverse_sweep, rollout, to_lanes
from .errand_kernels import detours, middle
from .field import Field
from .linear_algebra import advance, hessian_times, smoothed, times, transposed_times
from .motion import Holonomic, MotionModel, MOTIONS
from .particle_mesh import ParticleMesh
from .potentials import Mollified, Morse
from .sampling import FineModel, free, Resolution
from .separation_kernels import give_way, nearest, neighbours, rates, spacing
from .state import HerdState
from .tracking_cost import tracking_cost
from .walls import gaps, nearness

_STATE = HerdState(np.eye(2), np.zeros((2, 2)), np.ones((1, 2)))
_CONTROL = np.zeros((1, 1, 2))


def warm_up_rollout(crowd: Crowd | None = None, motion: MotionModel = Holonomic()) -> float:
    """Call the kernels of a simulation on a tiny herd; return the seconds it took."""
    started = time.perf_counter()
    rollout(crowd or Crowd(), _started(motion), _CONTROL, 0.01, motion=motion)
    return time.perf_counter() - started


def _started(motion: MotionModel) -> HerdState:
    d = motion.state(_STATE.d, np.zeros(1), np.zeros((1, 2)))
    return replace(_STATE, d=d)


def warm_up(crowd: Crowd | None = None, motion: MotionModel = Holonomic()) -> float:
    """Call the kernels of a controller on a tiny herd; return the seconds it took."""
    started = time.perf_counter()
    _warm_up_paths(crowd or Crowd())
    _warm_up_plans()
    motion.project(_CONTROL, 1.0)
    ds = motion.rollout(_started(motion).d, _CONTROL, 0.01, 1)
    motion.transpose(ds, _CONTROL, np.zeros_like(ds), 0.01, 1)
    return time.perf_counter() - started


def _warm_up_paths(crowd: Crowd) -> None:
    """Call what depends on the forces of a crowd."""
    state, u = _STATE, _CONTROL
    trajectory = rollout(crowd, state, u, 0.01)
    fine = FineModel(crowd, state, 0.01, 1)
    paths = fine.draw(np.random.default_rng(0), 1)
    for sampler in (Resolution().sampler(fine, u), free(fine, u)):
        sampler(paths)
    constants, d = physics(crowd, 2, 0.01), trajectory.ds
    nodes = np.ones(kernels.PATHS // 2, dtype=np.int_)
    xs, vs, dogs = trajectory.xs, trajectory.vs, np.empty((2, 2, kernels.PATHS))
    kernels.centre_adjoints(xs, vs, d, nodes, constants, dogs)
    reverse_sweep(crowd, trajectory, np.zeros_like(xs))


def _warm_up_plans() -> None:
    """Call the rest of what a controller needs."""
    x = to_lanes(_STATE.x)
    xs, d = np.stack([x, x]), np.ones((2, 2, 1))
    source = np.zeros_like(xs)
    times(source[0], source[0, 0], source[0, :, 0].copy())
    transposed_times(source[0], np.zeros(2), source[0, 0].copy())
    h, w, q = np.ones((1, 2)), np.zeros((2, 2)), np.zeros((2, 2))
    smoothed(h, h.copy())
    hessian_times(h, 1.0, w, q, h.copy())
    advance(h.copy(), h.copy(), h.copy(), 1.0, w, q, True)
    tracking_cost(xs, np.zeros((2, 2)), 2, 1.0, 1.0, 1.0, source)
    pair, alone = np.array([0]), np.array([-1])
    apart, one, two = np.ones((1, 2, 2)), np.ones(1), np.ones((1, 2))
    bars, near = np.ones((1, 5)), neighbours(two, 1.0, np.ones((0, 5)), one, one > 0.0, 1.0)
    rates(two, *near[:3])
    give_way(two, *near[:3], one, near[4])
    gaps(two, bars)
    nearness(d, bars, 1.0, 1.0, np.zeros_like(d))
    nearest(two, pair, alone, apart, one, one, two, np.inf, 1, 1.0)
    spacing(d, 1.0, 1.0, np.zeros_like(d))
    middle(np.ones((1, 2)), np.empty(2))
    detours(np.ones((1, 2)), np.ones((1, 2)), 1.0, np.empty(1), np.ones((1, 2)), np.ones((1, 2)))


def warm_up_others() -> None:
    """Call the kernels that depend on no crowd: of plans, and of large flocks."""
    _warm_up_plans()
    x = to_lanes(_STATE.x)
    mesh = ParticleMesh(Crowd().sheep, 2, np.array([-1.0, -1.0]), np.array([3.0, 3.0]), 0.4, 0.1)
    mesh.gradients(x)
    mesh.hessian_products(x, x)


def main() -> None:
    """Compile all kernels, on two processors if there are as many: first what others call."""
    started = time.perf_counter()
    # With a table for the sheep, as in the mean-field limit of a large flock, or for the dogs; and
    # among walls.
    fence = Field(fences=(((9.0, 9.0), (9.0, 8.0)),))
    crowds = (Crowd(sheep=Mollified(Morse())), CROWDS['independent'], fence.around(Crowd()))
    with ProcessPoolExecutor(2) as pool:
        for done in [pool.submit(_warm_up_paths, Crowd()), pool.submit(warm_up_others)]:
            done.result()
        first = pool.map(warm_up, crowds)
        list(pool.map(warm_up, [Crowd()] * len(MOTIONS), MOTIONS.values()))
        list(first)
    print(f'kernels ready after {time.perf_counter() - started:.1f} s')


if __name__ == '__main__':
    main()
