# SPDX-License-Identifier: Apache-2.0
"""Dogs that run to and fro, without ROS."""

from __future__ import annotations

from dataclasses import replace

from herding_ros.control.closed_loop import as_policy, ClosedLoopRun, play
from herding_ros.control.excitation import ExcitingPilot
from herding_ros.control.parameters import Control
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import Simulation, World
import numpy as np
import pytest

GOAL = np.array([0.5, 0.5])


def excited(crowd: Crowd, world: World, control: Control, duration: float) -> ClosedLoopRun:
    pilot = ExcitingPilot(RecedingHorizon(crowd, control, GOAL, 0), world.dogs)
    return play(Simulation(crowd, world, GOAL), as_policy(pilot, []), duration, stop=False)


@pytest.fixture(scope='module')
def run() -> ClosedLoopRun:
    """Exactly seen, and dogs that may come as near as they like."""
    control = Control().with_values(
        {'bodies.separation': 0.0, 'bodies.sheep_distance': 0.0, 'bodies.ramp': 0.0}
    )
    world = World(sheep=12, dogs=3, seed=1, position_noise=0.0, velocity_noise=0.0)
    return excited(Crowd(), world, control, 120.0)


def test_each_dog_keeps_to_a_diameter_of_its_own(run: ClosedLoopRun) -> None:
    arm = run.d[300:] - run.x[300:].mean(axis=1)[:, None]
    angle = 2.0 * np.pi * np.arange(3) / 3.0
    along, across = (
        np.array([np.cos(angle), np.sin(angle)]),
        np.array([-np.sin(angle), np.cos(angle)]),
    )
    aside = np.einsum('tmc,cm->tm', arm, across)
    assert np.abs(aside).max() < 0.1
    way = np.einsum('tmc,cm->tm', arm, along)
    # From one side to the other, and past the middle of the flock on the way.
    assert (way.max(axis=0) > 0.6).all()
    assert (way.min(axis=0) < -0.6).all()
    assert (np.linalg.norm(run.u, axis=-1) <= Control().max_speed * (1.0 + 1e-9)).all()


def test_in_another_world_it_is_the_same_to_scale(run: ClosedLoopRun) -> None:
    length, time = 16.0, 0.25
    control = Control().with_values(
        {'bodies.separation': 0.0, 'bodies.sheep_distance': 0.0, 'bodies.ramp': 0.0}
    )
    crowd, control = (each.rescaled(length, time) for each in (Crowd(), control))
    world = World(sheep=12, dogs=3, seed=1, position_noise=0.0, velocity_noise=0.0)
    world = world.rescaled(length, time)
    pilot = ExcitingPilot(RecedingHorizon(crowd, control, length * GOAL, 0), 3)
    other = play(
        Simulation(crowd, world, length * GOAL), as_policy(pilot, []), 10.0 * time, stop=False
    )
    np.testing.assert_allclose(other.d / length, run.d[: len(other.d)], atol=1e-6)


def test_silent_dogs_stand_and_the_others_go_on() -> None:
    from herding_ros.control.pilot import Observed

    world = World(sheep=6, dogs=3, seed=2)
    state = Simulation(Crowd(), world, GOAL).observe().state
    pilot = ExcitingPilot(RecedingHorizon(Crowd(), Control(), GOAL, 0), 3)
    seen = replace(state, d=state.d[[0, 2]])
    command = pilot.decide(Observed(0, np.arange(6), seen, (0, 2))).command
    assert command is not None
    np.testing.assert_array_equal(command[1], 0.0)
    assert (np.linalg.norm(command[[0, 2]], axis=1) > 0.0).all()
