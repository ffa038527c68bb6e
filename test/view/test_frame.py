# SPDX-License-Identifier: Apache-2.0
from herding_ros.bag.recorded_run import in_play, Route
from herding_ros.view.frame import Curve, MOST_TRAIL, TRAIL, Trails
import numpy as np


def route(start: float, value: float) -> Route:
    times = start + np.arange(4.0)
    return Route(times, np.full((4, 2), value))


def test_route_ahead_begins_at_the_time() -> None:
    straight = Route(np.arange(5.0), np.outer(np.arange(5.0), [1.0, 2.0]))
    assert np.array_equal(straight.ahead(2.0), [[2, 4], [3, 6], [4, 8]])
    assert np.array_equal(straight.ahead(2.1), [[3, 6], [4, 8]])
    assert len(straight.ahead(9.0)) == 0


def test_plan_in_play_is_the_last_to_begin_however_they_were_announced() -> None:
    """A window is announced ahead, and feedbacks between the announcement and its start."""
    routes = [route(0.0, 0), route(10.0, 1), route(6.0, 2), route(10.0, 3), route(8.0, 4)]
    found = {t: in_play(routes, t) for t in (0.0, 7.0, 9.0, 10.0, 50.0)}
    assert {t: each.points[0, 0] for t, each in found.items() if each} == {
        0.0: 0, 7.0: 2, 9.0: 4, 10.0: 3, 50.0: 3,
    }  # fmt: skip
    assert in_play(routes, -1.0) is None


def test_trails_are_as_long_as_said_and_forgotten_with_the_herd() -> None:
    trails = Trails()
    for k in range(1000):
        trails.add(0.1 * k, np.array([[0.1 * k, 0.0], [0.1 * k, 2.0]]), np.zeros((3, 2)))
    assert trails.dogs.shape == (len(trails.centre), 3, 2)
    assert np.allclose(
        trails.centre[[0, -1]], [[99.9 - TRAIL, 1.0], [99.9, 1.0]], atol=TRAIL / MOST_TRAIL
    )
    assert MOST_TRAIL / 2 < len(trails.dogs) <= MOST_TRAIL + 1
    trails.add(0.0, np.zeros((2, 2)), np.zeros((3, 2)))  # a reset
    assert len(trails.dogs) == 1
    trails.add(1.0, np.zeros((2, 2)), np.zeros((4, 2)))  # another dog
    assert trails.dogs.shape == (1, 4, 2)


def test_long_curve_keeps_its_whole_time_with_fewer_values() -> None:
    curve = Curve('value')
    for k in range(20_000):
        curve.add(0.1 * k, float(k))
    assert 400 < len(curve.times) <= 1001
    assert curve.times[0] == 0.0
    assert curve.times[-1] > 1995.0
    assert np.allclose(np.array(curve.values), 10.0 * np.array(curve.times))
    assert np.diff(curve.times).max() < 3.0 * np.diff(curve.times).min() + 0.2
    curve.add(0.0, 1.0)
    assert curve.times == [0.0]
