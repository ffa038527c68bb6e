# SPDX-License-Identifier: Apache-2.0
"""The deterministic problem of a window: our optimiser, and whole solves, against peers."""

from __future__ import annotations

from collections.abc import Callable
import copy
import time
from typing import Any

from benchmark.peers import casadi_ipopt, crocoddyl_ddp, mppi, scipy_lbfgsb
from benchmark.race import Race
from herding_ros.control.parameters import Control
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import HerdState
import numpy as np
import pytest

SEEDS = range(5)
STARTS = {'cold': 0.0, 'after 1 s': 1.0, 'after 10 s': 10.0}
"""Seconds of an earlier plan that have been played."""
PATIENCE = {'IPOPT': 20.0, 'DDP': 20.0, 'MPPI': 2.0}
"""Seconds that a peer is given to reach the target."""
WHOLE_SOLVES = {
    'IPOPT': casadi_ipopt.solver,
    'DDP': crocoddyl_ddp.solver,
    'MPPI': mppi.solver,
}

seeds = pytest.mark.parametrize('seed', SEEDS, ids='seed{}'.format)


def horizon(quick: bool) -> float:
    """Return the length of the window [s]."""
    return 2.0 if quick else Control().horizon.length


def scipy(race: Race) -> int:
    """Run L-BFGS-B; return the number of values and gradients that it took."""
    return race.run(
        lambda: scipy_lbfgsb.minimise(
            race.value_and_gradient, race.start, race.control.max_speed, race.coarse.interval
        )
    )


@seeds
@pytest.mark.parametrize('start', STARTS)
def test_scipy(compare: Callable[..., None], quick: bool, seed: int, start: str) -> None:
    """Time SciPy against PQN until both have reached what SPG ends with."""
    race = Race(seed, horizon(quick), min(STARTS[start], 0.5 * horizon(quick)))
    compare(
        'optimiser',
        race.ours,
        lambda: scipy(race),
        peer='L-BFGS-B',
        seed=seed,
        start=start,
        calls=race.ours(),
        peer_calls=scipy(race),
    )


@seeds
@pytest.mark.parametrize('peer', WHOLE_SOLVES)
def test_whole_solve(
    benchmark: Any, record: Callable[..., None], quick: bool, seed: int, peer: str
) -> None:
    """Time ours to its own end, on both time grids, and a peer until it has SPG's objective."""
    race = Race(seed, horizon(quick))
    solve = WHOLE_SOLVES[peer](race)
    plan = benchmark.pedantic(race.planned, rounds=2 if quick else 10, warmup_rounds=1)
    of_ours = list(benchmark.stats.stats.data)
    started = time.perf_counter()
    value = solve(PATIENCE[peer])
    of_peer = time.perf_counter() - started
    ratio, reached = of_peer / float(np.median(of_ours)), value <= race.target
    record(
        'whole solve',
        f'{"" if reached else "> "}{ratio:.3g} x',
        peer=peer,
        seed=seed,
        seconds=of_ours,
        peer_seconds=[of_peer],
        ratios=[ratio],
        reached=reached,
        excess=race.value(plan) / race.target - 1.0,
        peer_excess=value / race.target - 1.0,
    )


@seeds
def test_whole_solve_of_scipy(compare: Callable[..., None], quick: bool, seed: int) -> None:
    """The same in turns with L-BFGS-B, which is on the finer grid from the start."""
    race = Race(seed, horizon(quick))
    compare(
        'whole solve',
        race.planned,
        lambda: scipy(race),
        peer='L-BFGS-B',
        seed=seed,
        reached=True,
        excess=race.value(race.planned()) / race.target - 1.0,
        peer_excess=0.0,
    )


@seeds
def test_feedback(compare: Callable[..., None], quick: bool, seed: int) -> None:
    """Time the improvement of a plan after a second, in values with gradient."""
    race = Race(seed, horizon(quick))
    planner = RecedingHorizon(race.coarse.crowd, race.control, race.goal)
    plan = planner.solve(race.coarse.state, 0.0).plan
    later = state_after(1.0, seed, race, plan.at)
    coarse, objective = race.on_control_grid()
    compare(
        'feedback',
        lambda: coarse.value_and_gradient(objective, plan.u),
        lambda: copy.copy(planner).improve(later, 1.0),
        unit='values with gradient',
        seed=seed,
        calls=copy.copy(planner).improve(later, 1.0).report.optimiser_calls,
    )


def state_after(
    seconds: float, seed: int, race: Race, command: Callable[[float], np.ndarray]
) -> HerdState:
    """Return the noisy herd after so many seconds under these commands."""
    simulation = Simulation(race.coarse.crowd, World(seed=seed), race.goal)
    for _ in range(round(seconds / race.control.horizon.control_period)):
        simulation.advance(command(simulation.nanoseconds * 1e-9))
    return simulation.state
