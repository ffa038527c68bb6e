# SPDX-License-Identifier: Apache-2.0
import socket

from herding_ros.view.page import _free_port, _grid, faded, on_the_ground, polylines, thinned
import numpy as np
import pytest


def test_click_hits_the_ground_where_the_ray_does() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        eye, place = np.add(rng.normal(size=3), [0, 0, 5]), rng.normal(size=2)
        away = rng.uniform(0.1, 3.0) * (np.append(place, 0.0) - eye)
        assert on_the_ground(eye, away) == pytest.approx(place)
    assert on_the_ground((0, 0, 1), (0, 1, 0)) is None  # along the ground
    assert on_the_ground((0, 0, 1), (0, 0, 1)) is None  # into the sky


def test_polylines_join_each_point_with_the_next_of_the_same_dog() -> None:
    points = np.arange(12.0).reshape(3, 2, 2)
    expected = [[points[k, m], points[k + 1, m]] for k in range(2) for m in range(2)]
    assert np.array_equal(polylines(points), expected)


def test_colours_fade_to_white() -> None:
    assert faded((10, 20, 30), np.array([0.0, 1.0])).tolist() == [[255] * 3, [10, 20, 30]]


def test_port_in_use_is_passed_over_and_a_foreign_address_refused() -> None:
    with socket.create_server(('127.0.0.1', 0)) as taken:
        port = taken.getsockname()[1]
        assert port < _free_port('127.0.0.1', port) <= port + 99
    with pytest.raises(ValueError, match=r'address of this machine.*got 192\.0\.2\.1'):
        _free_port('192.0.2.1', 8080)


def test_planned_way_is_drawn_by_few_points_from_its_start_to_its_end() -> None:
    way = np.stack([np.arange(1000.0), np.zeros(1000)], axis=1)[:, None]
    few = thinned(way, 40)
    assert few.shape == (40, 1, 2)
    assert np.array_equal(few[[0, -1]], way[[0, -1]])
    assert np.ptp(np.diff(few[:, 0, 0])) <= 1.0
    assert np.array_equal(thinned(way[:3], 40), way[:3])
    assert thinned(way[:0], 40).shape == (0, 1, 2)


def test_grid_has_a_line_through_each_multiple_and_no_other() -> None:
    lines = _grid(np.array([-7.0, 3.0]), np.array([6.0, 11.0]), 5)
    across = sorted(x for (x, _), (other, _) in lines if x == other)
    along = sorted(y for (_, y), (_, other) in lines if y == other)
    assert across == [-5.0, 0.0, 5.0]
    assert along == [5.0, 10.0]
    assert {(y, other) for (x, y), (there, other) in lines if x == there} == {(3.0, 11.0)}
