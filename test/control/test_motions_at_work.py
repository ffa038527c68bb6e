# SPDX-License-Identifier: Apache-2.0
"""Flocks are brought home by dogs that are slow, late, have to turn or get stuck."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.control.closed_loop import ClosedLoopRun, play, watched
from herding_ros.control.lockstep_pilot import LockstepPilot
from herding_ros.control.parameters import Bodies, Control
from herding_ros.control.pilot import Decision
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.bodies import closest
from herding_ros.model.crowd import Crowd
from herding_ros.model.motion import Accelerating, Holonomic, MotionModel, Unicycle
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array
import numpy as np
import pytest


@dataclass(frozen=True)
class Herded:
    """A run, and when what was said of dogs that do not do as told [s]."""

    run: ClosedLoopRun
    reported: tuple[tuple[float, str], ...]


class Stuck(Simulation):
    """The first dog stands from some time on [s]."""

    since = 10.0

    def advance(self, u: Array) -> None:
        if self.periods * self.control_period > self.since - 1e-6:
            u = np.concatenate([np.zeros((1, 2)), u[1:]])
        super().advance(u)


def herded(
    motion: MotionModel, delay: float, seed: int, limit: float, goal: float = 1.0, dogs: int = 3,
    kind: type[Simulation] = Simulation,
) -> Herded:  # fmt: skip
    crowd = Crowd()
    world = World(sheep=20, dogs=dogs, seed=seed, motion=motion, delay=delay)
    simulation = kind(crowd, world, np.full(2, goal))
    planner = RecedingHorizon(crowd, Control(motion=motion, delay=delay), simulation.goal, seed)
    reported: list[tuple[float, str]] = []

    def watch(decision: Decision, t: float) -> None:
        events = [event.text for event in decision.events]
        reported.extend((t, text) for text in events if 'do as told' in text or 'does as' in text)

    run = play(simulation, watched(LockstepPilot(planner, dogs), watch), limit)
    return Herded(run, tuple(reported))


WAYS = {
    'at once': (Holonomic(), 0.0),
    'accelerating': (Accelerating(acceleration=0.02), 0.0),
    'unicycle': (Unicycle(turn_rate=0.5), 0.0),
    'late': (Holonomic(), 1.0),
}


@pytest.mark.parametrize('way', WAYS)
def test_a_flock_is_brought_on_its_way(way: str) -> None:
    """Ten seconds of it: no command jumps, no dogs come too near, none is taken for stuck."""
    found = herded(*WAYS[way], seed=1, limit=10.0)
    u, d = found.run.u, found.run.d[..., :2]
    assert np.linalg.norm(d[-1] - d[0], axis=1).max() > 0.15
    assert np.linalg.norm(np.diff(u, axis=0), axis=2).max() <= 0.3 * 0.05
    assert closest(d) > Bodies().separation
    assert not found.reported


@pytest.mark.statistics
@pytest.mark.timeout(3000)
@pytest.mark.parametrize('way', WAYS)
def test_flocks_come_home_and_no_dog_is_taken_for_one_that_does_not_do_as_told(way: str) -> None:
    arrived = 0
    for seed in range(600, 620):
        found = herded(*WAYS[way], seed=seed, limit=250.0)
        arrived += found.run.arrived
        assert closest(found.run.d[..., :2]) > Bodies().separation
        assert np.linalg.norm(np.diff(found.run.u, axis=0), axis=2).max() <= 0.3 * 0.05
        assert not found.reported, (seed, found.reported)
    assert arrived >= 19


@pytest.mark.statistics
@pytest.mark.timeout(3000)
def test_the_others_finish_when_one_is_stuck() -> None:
    arrived = soon = 0
    for seed in range(600, 620):
        found = herded(Holonomic(), 0.0, seed, 250.0, dogs=4, kind=Stuck)
        arrived += found.run.arrived
        soon += bool(found.reported) and 10.0 < found.reported[0][0] <= 12.0 + 1e-6
        assert all('dog_1 does' in text for _, text in found.reported), found.reported
    assert arrived >= 18
    assert soon >= 18
