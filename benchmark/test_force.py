# SPDX-License-Identifier: Apache-2.0
"""Big flocks: the particle mesh against the direct sum, and how a step grows."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import os
import time
from typing import Any

from herding_ros.model import fast_forces
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout, to_lanes
from herding_ros.model.fast_forces import DirectSum, prepare, Sums
from herding_ros.model.particle_mesh import Run
from herding_ros.model.scenario import GOAL, initial_herd
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

FLOCKS = (1000, 3000, 10_000, 30_000, 100_000, 1_000_000)
CROSSING = (500, 1000, 1500, 2000, 3000)
DOGS = 6
DT = 0.01
STEPS = 10
"""A rollout of so many steps is timed, with the plan that it makes: a control period."""


def flock(sheep: int) -> HerdState:
    """Return the scenario's herd."""
    return initial_herd(sheep, DOGS, np.array(GOAL), np.random.default_rng(0))


def planned(sheep: int, accuracy: float, run: Run) -> tuple[Sums, Array, float]:
    """Return what sums the forces, where the sheep are, and the error of all or some forces."""
    x = to_lanes(flock(sheep).x)
    sums = prepare(Crowd().sheep, x, sheep, accuracy, run)
    exact = DirectSum(Crowd().sheep, sheep).gradients(x)
    apart = np.linalg.norm(sums.gradients(x) - exact) / np.linalg.norm(exact)
    return sums, x, float(apart)


def shape(sums: Sums) -> dict[str, Any]:
    """Return reach [m], and mesh points of the FFT."""
    if isinstance(sums, DirectSum):
        return {'reach': 0.0, 'points': [0, 0]}
    return {'reach': sums.reach, 'points': list(sums.padded)}


@pytest.mark.parametrize('flock_size', FLOCKS[1:5])
def test_force(benchmark: Any, record: Callable[..., None], flock_size: int) -> None:
    """Time one evaluation on all cores, to the default accuracy."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        sums, x, error = planned(flock_size, fast_forces.ACCURACY, pool.map)
        benchmark.pedantic(lambda: sums.gradients(x), rounds=25, warmup_rounds=2)
    seconds = list(benchmark.stats.stats.data)
    record(
        'force',
        f'{1e3 * np.median(seconds):.3g} ms, error {error:.1e}',
        sheep=flock_size,
        seconds=seconds,
        error=error,
        **shape(sums),
    )
    assert error <= fast_forces.ACCURACY


@pytest.mark.parametrize('accuracy', [1e-4, 1e-6])
@pytest.mark.parametrize('flock_size', [3000, 10_000, 30_000])
def test_against_direct(compare: Callable[..., None], flock_size: int, accuracy: float) -> None:
    """Time the direct sum against the particle mesh, each on one thread."""
    sums, x, error = planned(flock_size, accuracy, map)
    direct = DirectSum(Crowd().sheep, flock_size)
    compare(
        'force against direct',
        lambda: sums.gradients(x),
        lambda: direct.gradients(x),
        sheep=flock_size,
        accuracy=accuracy,
        error=error,
        **shape(sums),
    )
    assert error <= accuracy


@pytest.mark.parametrize('flock_size', CROSSING)
def test_crossover(
    compare: Callable[..., None], flock_size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time a rollout with direct sums against one that plans, whatever the number of sheep."""
    state, still = flock(flock_size), np.zeros((1, DOGS, 2))

    def run(crossover: int) -> None:
        monkeypatch.setattr(fast_forces, 'CROSSOVER', crossover)
        rollout(Crowd(), state, still, DT, STEPS)

    compare('crossover', lambda: run(0), lambda: run(10**9), sheep=flock_size)


@pytest.mark.parametrize('flock_size', FLOCKS)
def test_step(benchmark: Any, record: Callable[..., None], flock_size: int) -> None:
    """Time a control period as the sim takes it."""
    state, still = flock(flock_size), np.zeros((1, DOGS, 2))
    seconds = []
    for _ in range(3 if flock_size > 100_000 else 9):
        started = time.perf_counter()
        rollout(Crowd(), state, still, DT, STEPS)
        seconds.append((time.perf_counter() - started) / STEPS)
    benchmark.pedantic(lambda: None, rounds=1)
    record('step', f'{1e3 * np.median(seconds):.3g} ms a step', sheep=flock_size, seconds=seconds)
