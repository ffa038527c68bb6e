# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

from herding_ros.control.reach import Reach
from herding_ros.control.reference import pace, reference
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.dynamics import rollout
from herding_ros.model.potentials import Harmonic, Morse, Tabulated
from herding_ros.model.state import HerdState
import numpy as np
import pytest

GOAL = np.array([0.5, 0.5])
ONE = HerdState(np.zeros((1, 2)), np.zeros((1, 2)), np.array([[9.0, 9.0]]))
"""A sheep; where the dog is does not count."""


def test_interpolated_reference_reaches_the_goal_with_the_window() -> None:
    times, start = np.linspace(0.0, 8.0, 81), np.array([-0.1, 0.2])
    found = reference('interpolated', 0.0, np.stack([start, GOAL]), times)
    expected = [start + t / 8.0 * (GOAL - start) for t in times]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize('away', [0.0, 0.1, 5.0])
def test_attainable_reference_keeps_its_speed_and_waits_at_the_goal(away: float) -> None:
    times, start = np.linspace(0.0, 20.0, 201), GOAL - away * np.array([0.6, 0.8])
    found = reference('attainable', 0.02, np.stack([start, GOAL]), times)
    np.testing.assert_allclose(found[0], start)
    way = np.linalg.norm(found - start, axis=1)
    np.testing.assert_allclose(way, np.minimum(0.02 * times, away), rtol=0, atol=1e-14)
    left = np.linalg.norm(GOAL - found, axis=1)
    np.testing.assert_allclose(way + left, away, rtol=0, atol=1e-14)  # straight there


def test_reference_takes_each_leg_of_a_route_at_one_speed() -> None:
    route = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.4]])
    found = reference('attainable', 0.1, route, np.array([0.0, 1.5, 3.0, 5.0, 7.0, 9.0]))
    expected = [[0.0, 0.0], [0.15, 0.0], [0.3, 0.0], [0.3, 0.2], [0.3, 0.4], [0.3, 0.4]]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)


def test_pace_is_the_speed_that_a_sheep_keeps_before_a_dog_at_the_standoff() -> None:
    """One dog that follows one sheep at 80 % of its greatest force, simulated."""
    crowd = Crowd(dog=Morse(1e-3, 0.5, 0.0, 1.0))
    standoff = -0.5 * np.log(0.8)
    x, v = np.zeros((1, 2)), np.zeros((1, 2))
    for _ in range(400):
        d = x - standoff * np.array([[1.0, 0.0]])
        end = rollout(crowd, HerdState(x, v, d), np.zeros((1, 1, 2)), 0.05).at(-1)
        x, v = end.x, end.v
    reach = Reach.of(crowd, 1.0)
    found = pace(crowd, reach, ONE, np.array([3.0, 0.0]), 1.0)
    assert found == pytest.approx(float(v[0, 0]), rel=0.01)


def test_pace_of_dogs_whose_push_ends_sharply_is_what_they_can_do_to_half_a_flock() -> None:
    """A dog that stood a standoff off the flock would move few of its sheep."""
    edge, push = 0.15, 0.02
    r = np.linspace(0.0, edge, 31)
    dog = Tabulated(tuple(r), tuple(push * (edge - r)))
    crowd = Crowd(sheep=Harmonic(), dog=dog, friction=1.0, order=1)
    x = 0.05 * np.random.default_rng(1).standard_normal((50, 2))
    state = HerdState(x, np.zeros_like(x), np.array([[9.0, 9.0]]))
    reach = Reach.of(crowd, 1.0)
    assert 0.3 * push < pace(crowd, reach, state, GOAL, 1.0) < push


@pytest.mark.parametrize('crowd', CROWDS.values(), ids=CROWDS)
def test_pace_is_in_proportion_to_what_dogs_do_until_they_run_as_fast_as_they_can(
    crowd: Crowd,
) -> None:
    reach = Reach.of(crowd, 1e3)
    found = pace(crowd, reach, ONE, GOAL, 1e3)
    assert pace(
        replace(crowd, friction=2.0 * crowd.friction), reach, ONE, GOAL, 1e3
    ) == pytest.approx(0.5 * found)
    assert pace(crowd, reach, ONE, GOAL, 0.5 * found) == 0.5 * found
    assert pace(crowd, reach, ONE, ONE.x[0], 0.05) == 0.05  # at the goal there is no direction
