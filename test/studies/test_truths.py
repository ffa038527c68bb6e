# SPDX-License-Identifier: Apache-2.0
"""Worlds that are not what the controller is told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array
from herding_ros.studies.experiments.truths import GUST_AT, OtherWorld, Truth
import numpy as np
import pytest

GOAL = np.array([1.0, 1.0])
WORLD = World(sheep=10, dogs=2, seed=3)


def world(**truth: Any) -> OtherWorld:
    return OtherWorld(Crowd(), WORLD, GOAL, Truth(**truth))


def drive(plant: Simulation, periods: int = 20) -> Array:
    """Return where the sheep are after dogs have run straight at them."""
    for _ in range(periods):
        plant.advance(-0.05 * plant.state.d)
    return plant.state.x


def test_the_same_truth_is_the_simulation_bit_for_bit() -> None:
    expected = drive(Simulation(Crowd(), WORLD, GOAL))
    np.testing.assert_array_equal(drive(world()), expected)


def test_steps_one_by_one_are_those_of_the_simulation() -> None:
    """A limit that nobody reaches changes rounding alone."""
    expected = drive(Simulation(Crowd(), WORLD, GOAL))
    np.testing.assert_allclose(drive(world(speed_limit=10.0)), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize('truth', [Truth(force=0.5), Truth(reach=2.0)])
def test_a_dogs_force_is_scaled_and_stretched(truth: Truth) -> None:
    r = np.linspace(0.05, 3.0, 20)
    told, true = Crowd().dog, truth.crowd(Crowd()).dog
    expected = truth.force * told.derivative(r / truth.reach)
    np.testing.assert_allclose(true.derivative(r), expected, rtol=1e-12)


def test_a_response_scales_what_a_dog_does() -> None:
    """Without forces between sheep, half the response to dogs is half the force of dogs."""
    alone = replace(Crowd(), sheep=replace(Crowd().sheep, repulsion=0.0, attraction=0.0))
    plant = OtherWorld(alone, WORLD, GOAL, Truth(speed_limit=10.0))
    plant.response[:] = 0.5
    halved = OtherWorld(alone, WORLD, GOAL, Truth(force=0.5))
    np.testing.assert_allclose(drive(plant), drive(halved), rtol=0, atol=1e-13)


def test_sheep_differ_by_the_lognormal_law_and_some_ignore_dogs() -> None:
    many = replace(WORLD, sheep=4000)
    logs = np.log(OtherWorld(Crowd(), many, GOAL, Truth(diversity=0.5)).response)
    assert logs.std() == pytest.approx(0.5, rel=0.05)
    assert abs(logs.mean()) < 4.0 * 0.5 / np.sqrt(4000)
    assert (world(ignoring=0.2).response == 0.0).sum() == 2


def test_no_sheep_is_faster_than_the_limit() -> None:
    plant = world(speed_limit=0.005)
    drive(plant)
    speed = np.linalg.norm(plant.state.v, axis=1)
    assert speed.max() == pytest.approx(0.005)


def test_those_that_ignore_dogs_need_not_arrive() -> None:
    plant = world(ignoring=0.2)
    x = np.where(plant.response[:, None] > 0.0, plant.state.x - plant.state.x.mean(axis=0), 50.0)
    heeding = plant.response > 0.0
    x[heeding] += GOAL - x[heeding].mean(axis=0)
    plant.state = replace(plant.state, x=x)
    assert plant.arrived
    x[~heeding], x[np.flatnonzero(heeding)[0]] = GOAL, 50.0
    plant.state = replace(plant.state, x=x)
    assert not plant.arrived


def test_observations_are_late_and_at_first_those_of_the_start() -> None:
    prompt, late = world(), world(delay=0.3)
    seen = []
    for plant in (prompt, late):
        x = []
        for _ in range(6):
            x.append(plant.observe().state.x)
            drive(plant, 1)
        seen.append(x)
    for k, x in enumerate(seen[1]):
        np.testing.assert_array_equal(x, seen[0][max(k - 3, 0)])


def test_a_lost_command_stops_its_dog_for_a_period() -> None:
    plant, u = world(loss=0.3), np.array([[0.03, 0.0], [0.0, 0.04]])
    run = []
    for _ in range(500):
        plant.advance(u)
        run.append(plant.dog_velocities)
    stood = (np.array(run) == 0.0).all(axis=2)
    assert stood.mean() == pytest.approx(0.3, abs=4.0 * np.sqrt(0.21 / stood.size))
    assert (stood[:, 0] != stood[:, 1]).any()
    assert (np.array(run)[~stood] == np.tile(u, (500, 1, 1))[~stood]).all()


def test_a_gust_displaces_all_sheep_once() -> None:
    calm, windy = world(), world(gust=0.3)
    periods = round(GUST_AT / WORLD.control_period)
    np.testing.assert_array_equal(drive(windy, periods - 1), drive(calm, periods - 1))
    moved = drive(windy, 1) - drive(calm, 1)
    assert np.linalg.norm(moved, axis=1) == pytest.approx(0.3)
    assert np.ptp(moved, axis=0) == pytest.approx(0.0, abs=1e-12)
