# SPDX-License-Identifier: Apache-2.0
"""What walls and distances cost: planning among them, and the filter between plan and dogs."""

from __future__ import annotations

from collections.abc import Callable
import copy
from typing import Any

from herding_ros.control.command_filter import CommandFilter
from herding_ros.control.parameters import Bodies, Control
from herding_ros.control.plan import Plan
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.field import Field
from herding_ros.model.scenario import GOAL
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import HerdState
import numpy as np
import pytest

_CORNERS = np.pi * np.arange(21) / 10.0
FIELD = Field(
    fences=[(0.25 + 1.4 * np.stack([np.cos(_CORNERS), np.sin(_CORNERS)], axis=1)).tolist()],
)
"""A round paddock with a fence of 20 sides, in which the way to the goal is free."""


LOOKS = 25
"""So many looks at the flock, one in a second, bring it home."""


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('what', ['window', 'feedback', 'run'])
def test_planning_among_walls(compare: Callable[..., None], seed: int, what: str) -> None:
    """Time it with 20 segments and dogs apart, in units of that without either.

    From the same states: a window after a second, a feedback then, or all that a run has.
    """
    goal, second = np.array(GOAL), 1.0
    walled, apart = FIELD.around(Crowd()), Control()
    every = round(apart.horizon.accepted / second)

    def look(planner: RecedingHorizon, k: int, state: HerdState, is_window: bool) -> Plan:
        return (planner.solve if is_window else planner.improve)(state, k * second).plan

    simulation, states = Simulation(Crowd(), World(seed=seed), goal), []
    driver = RecedingHorizon(walled, apart, goal)
    for k in range(LOOKS if what == 'run' else 2):
        states.append(simulation.state)
        plan = look(driver, k, states[-1], k % every == 0)
        for _ in range(round(second / apart.horizon.control_period)):
            simulation.advance(plan.at(simulation.nanoseconds * 1e-9))

    def plans(crowd: Crowd, control: Control) -> Callable[[], object]:
        fresh = RecedingHorizon(crowd, control, goal)
        if what == 'run':

            def run() -> None:
                planner = copy.copy(fresh)
                planner.restart()
                for k, state in enumerate(states):
                    look(planner, k, state, k % every == 0)

            return run
        look(fresh, 0, states[0], is_window=True)
        return lambda: look(copy.copy(fresh), 1, states[1], what == 'window')

    compare(
        'planning among walls',
        plans(Crowd(), Control(bodies=Bodies(separation=0.0))),
        plans(walled, apart),
        unit='times as long',
        kind=what,
        seed=seed,
        segments=len(FIELD.bars),
    )


def test_command_filter(benchmark: Any, record: Callable[..., None]) -> None:
    """Time it for 10 dogs among 40 segments, whose commands are drawn."""
    rng = np.random.default_rng(0)
    ends = rng.uniform(-1.0, 1.0, (40, 1, 2)) + rng.uniform(-0.3, 0.3, (40, 2, 2))
    field, control = Field(fences=ends.tolist()), Control()
    commands = CommandFilter(10)

    def draw() -> tuple[tuple[Any, ...], dict[str, Any]]:
        places = rng.uniform(-1.0, 1.0, (100, 2))
        free = places[field.away(places)[0].min(axis=1) > control.bodies.wall_distance]
        asked = control.motion.project(rng.normal(0.0, 0.05, (10, 2)), control.max_speed)
        x = rng.uniform(-1.0, 1.0, (20, 2))
        herd = HerdState(x, np.zeros_like(x), free[:10])
        return (asked, np.zeros((10, 2)), herd, tuple(range(10)), control, field), {}

    benchmark.pedantic(commands.filtered, setup=draw, rounds=200, warmup_rounds=1)
    seconds = list(benchmark.stats.stats.data)
    record('command filter', f'{1e3 * float(np.median(seconds)):.2f} ms', seconds=seconds)
