# SPDX-License-Identifier: Apache-2.0
from herding_ros.control.parameters import Reference
from herding_ros.control.reference import reference
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

GOAL = np.array([0.5, 0.5])


def flock_at(centre: Array, spread: float, dogs: int) -> HerdState:
    """Four sheep on a circle."""
    around = spread * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    return HerdState(centre + around, np.zeros((4, 2)), np.zeros((dogs, 2)))


def test_interpolated_reference_reaches_the_goal_with_the_window() -> None:
    times, start = np.linspace(0.0, 8.0, 81), np.array([-0.1, 0.2])
    found = reference(Reference(kind='interpolated'), flock_at(start, 0.4, 1), GOAL, times)
    expected = [start + t / 8.0 * (GOAL - start) for t in times]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize('away', [0.0, 0.1, 5.0])
def test_attainable_reference_keeps_its_speed_and_waits_at_the_goal(away: float) -> None:
    times, start = np.linspace(0.0, 20.0, 201), GOAL - away * np.array([0.6, 0.8])
    kind = Reference(kind='attainable', speed=0.02)
    found = reference(kind, flock_at(start, 0.2, 4), GOAL, times)
    np.testing.assert_allclose(found[0], start)
    way = np.linalg.norm(found - start, axis=1)
    np.testing.assert_allclose(way, np.minimum(0.02 * times, away), rtol=0, atol=1e-14)
    left = np.linalg.norm(GOAL - found, axis=1)
    np.testing.assert_allclose(way + left, away, rtol=0, atol=1e-14)  # straight there


@pytest.mark.parametrize(('dogs', 'expected'), [(1, 0.01), (2, 0.02), (3, 0.03), (9, 0.03)])
def test_attainable_reference_goes_as_fast_as_so_many_dogs_can_drive(
    dogs: int, expected: float
) -> None:
    kind, far = Reference(speed=0.03), np.array([-50.0, 3.0])
    found = reference(kind, flock_at(far, 0.2, dogs), GOAL, np.array([0.0, 10.0]))
    assert np.linalg.norm(found[1] - found[0]) == pytest.approx(10.0 * expected, rel=1e-12)
