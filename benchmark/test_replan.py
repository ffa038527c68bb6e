# SPDX-License-Identifier: Apache-2.0
"""A whole replan: coarse solve, mapping, Monte Carlo with 100 paths, a horizon of 20 s."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
from functools import cache
from typing import Any

from herding_ros.control.parameters import Control, Mapping
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.solve_report import SolveReport
from herding_ros.model.crowd import Crowd
from herding_ros.model.scenario import GOAL
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import HerdState
import numpy as np
import pytest

SEEDS = range(5)
THOROUGH = Control(mapping=Mapping(tolerance=0.0))
"""All corrections are made."""


@cache
def after_first(seed: int, sigma: float, control: Control) -> tuple[float, HerdState]:
    """Return when the second window starts [s], and in which state."""
    crowd = Crowd(noise=sigma)
    world = World(seed=seed)
    simulation = Simulation(crowd, world, np.array(GOAL))
    plan = RecedingHorizon(crowd, control, np.array(GOAL), seed).solve(simulation.state, 0.0).plan
    for _ in range(round(control.horizon.accepted / world.control_period)):
        simulation.advance(plan.at(simulation.nanoseconds * 1e-9))
    return control.horizon.accepted, simulation.state


@pytest.mark.parametrize('sigma', [0.01, 0.02, 0.03])
@pytest.mark.parametrize('window', ['first', 'second'])
@pytest.mark.parametrize('control', [Control(), THOROUGH], ids=['default', 'all-corrections'])
def test_replan(
    benchmark: Any,
    record: Callable[..., None],
    quick: bool,
    sigma: float,
    window: str,
    control: Control,
) -> None:
    """Time the solve of a window from five flocks in turn."""
    if quick:
        control = dataclasses.replace(control, mapping=Mapping(paths=10))
    reports: list[SolveReport] = []
    herds = iter([*SEEDS] * (1 if quick else 2))

    def prepare() -> tuple[tuple[RecedingHorizon, HerdState, float], dict[str, Any]]:
        seed = next(herds)
        crowd, goal = Crowd(noise=sigma), np.array(GOAL)
        planner = RecedingHorizon(crowd, control, goal, seed)
        first = Simulation(crowd, World(seed=seed), goal).state
        if window == 'first':
            return (planner, first, 0.0), {}
        t, state = after_first(seed, sigma, control)
        planner.solve(first, 0.0)
        return (planner, state, t), {}

    def replan(planner: RecedingHorizon, state: HerdState, t: float) -> None:
        reports.append(planner.solve(state, t).report)

    benchmark.pedantic(replan, setup=prepare, rounds=2 if quick else 10)
    seconds = list(benchmark.stats.stats.data)
    record(
        'replan',
        f'{1e3 * float(np.median(seconds)):.0f} ms',
        sigma=sigma,
        window=window,
        thorough=control is THOROUGH,
        paths=control.mapping.paths,
        seconds=seconds,
        phases={
            phase: [report.seconds[phase] for report in reports] for phase in reports[0].seconds
        },
        calls=[report.optimiser_calls for report in reports],
        corrections=[report.mapping_iterations for report in reports],
        accepted=control.horizon.accepted,
    )
