# SPDX-License-Identifier: Apache-2.0
import math
import re

from herding_ros.control.parameters import Bodies, Control
from herding_ros.control.reference import reference
from herding_ros.control.scale import Scale
from herding_ros.control.ways import Corners, route, Ways
from herding_ros.model.crowd import CROWDS
from herding_ros.model.field import Field, read_field, shipped_fields
from herding_ros.model.simulation import World
from herding_ros.model.state import Array
import numpy as np
import pytest
import shapely

WALL = Field(fences=(((1.0, -0.5), (1.0, 0.7)),))
START, GOAL = np.zeros(2), np.array([2.0, 0.0])


def length(way: Array) -> float:
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def test_a_route_is_straight_where_nothing_is_in_the_way() -> None:
    np.testing.assert_array_equal(route(WALL, START, np.full(2, 2.0), 0.1, 0.05), [START, [2, 2]])


def test_a_route_leads_round_a_wall_at_the_clearance() -> None:
    """The exact length: a tangent, an arc round the nearer end, a tangent."""
    radius, away = 0.25, math.hypot(1.0, 0.5)
    angle = 2.0 * (math.pi - math.atan2(1.0, 0.5) - math.acos(radius / away))
    exact = 2.0 * math.sqrt(away**2 - radius**2) + radius * angle
    found = Corners(WALL, radius).way(START, GOAL)
    assert found is not None
    assert found[1:-1, 1].max() < -0.5  # round the nearer end
    gap = shapely.LineString(found).distance(WALL.walls)
    assert 0.9 * radius <= gap <= radius
    assert 0.98 * exact < length(found) < 1.02 * exact


@pytest.mark.parametrize('width', [0.05, 0.3, 0.9])
def test_a_route_narrows_before_a_gate(width: float) -> None:
    field = Field(fences=(((1.0, 0.3), (1.0, 3.0)), ((1.0, -0.3), (1.0, -3.0))))
    found = route(field, np.array([0.0, 1.0]), np.array([2.0, 1.0]), width, 0.05)
    gap = shapely.LineString(found).distance(field.walls)
    # As far as it may: half the gate, less what clearances are rounded by.
    expected = min(width, 0.3)
    assert 0.9 * 2.0**-0.25 * expected - 1e-9 <= gap <= expected


def test_walls_without_a_gap_are_refused() -> None:
    ring = ((1.0, -1.0), (3.0, -1.0), (3.0, 1.0), (1.0, 1.0), (1.0, 0.1), (1.0, 0.0), (1.0, -1.0))
    with pytest.raises(ValueError, match=re.escape('walls with no gap of 0.2 m; open a gate')):
        route(Field(fences=(ring,)), START, GOAL, 0.5, 0.1)


def test_a_start_beside_a_wall_first_leaves_it() -> None:
    found = Corners(WALL, 0.3).way(np.array([0.9, 0.1]), GOAL)
    assert found is not None
    np.testing.assert_allclose(found[1], [0.7, 0.1], atol=0.03)
    assert not shapely.LineString(found).intersects(WALL.walls)


def test_the_reference_goes_along_the_route_at_its_speed() -> None:
    legs = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    times = np.linspace(0.0, 8.0, 81)
    path = reference('attainable', 0.5, legs, times)
    np.testing.assert_allclose(path[[10, 20, 40, 60, 80]], [
        [0.5, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 2.0], [1.0, 2.0],
    ], atol=1e-12)  # fmt: skip
    speeds = np.linalg.norm(np.diff(path[:60], axis=0), axis=1) / 0.1
    np.testing.assert_allclose(speeds, 0.5, rtol=1e-9)
    within = reference('interpolated', 0.0, legs, times)
    np.testing.assert_allclose(within[[0, 40, 80]], [[0.0, 0.0], [1.0, 0.5], [1.0, 2.0]])


def test_dogs_aim_ahead_on_the_route() -> None:
    legs = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    ways = Ways(WALL, legs, 0.3, 0.1)

    def aim(*place: float) -> Array:
        return ways.aim(np.array([place]))

    np.testing.assert_allclose(aim(0.2, 0.1), [1.0, 0.0])  # the end of the leg
    np.testing.assert_allclose(aim(0.9, 0.0), [1.0, 0.2])  # round its corner
    np.testing.assert_allclose(aim(1.1, 1.9), [1.0, 2.0])  # the goal


def test_posts_are_on_the_side_of_their_sheep() -> None:
    bodies = Bodies()
    ways = Ways.of(WALL, bodies, np.array([[0.9, 0.0], [0.5, 0.3]]), np.array([-1.0, 0.0]))
    assert ways is not None
    posts = ways.in_front(
        np.array([[0.8, 0.0], [0.5, 0.3]]), np.array([[1.2, 0.0], [0.4, 0.4], [0.97, 0.1]])
    )
    np.testing.assert_allclose(posts[1], [0.4, 0.4])
    np.testing.assert_allclose(posts[[0, 2], 0], 1.0 - ways.clearance)


def test_dogs_go_round_walls_to_their_posts() -> None:
    ways = Ways.of(WALL, Bodies(), np.zeros((2, 2)), GOAL)
    assert ways is not None
    d, posts = np.array([[0.5, 0.0], [0.5, 0.0]]), np.array([[0.6, 0.5], [1.5, 0.0]])
    first = ways.steps(d, posts)
    np.testing.assert_array_equal(first[0], posts[0])
    assert first[1, 1] < -0.5
    assert not shapely.LineString([d[1], first[1]]).intersects(WALL.walls)


def test_without_walls_there_are_no_ways() -> None:
    assert Ways.of(Field(goal=((1.0, 1.0),)), Bodies(), np.zeros((2, 2)), GOAL) is None


@pytest.mark.parametrize('name', shipped_fields())
def test_every_flock_within_a_field_has_a_route(name: str) -> None:
    """Wherever its sheep are, beside a wall, or with one before the centre of two clusters."""
    field, given = read_field(name)
    crowd = CROWDS[given.get('crowd.preset', 'cohesive')]
    scale = Scale.of(crowd, given.get('max_speed', World.max_speed))
    bodies = scale.apply(Control()).bodies
    assert field.place is not None
    around = shapely.box(*field.walls.bounds).buffer(1.0)
    parts = shapely.get_parts(around.difference(field.walls.buffer(1e-3 * field.range)))
    room = next(part for part in parts if part.contains(shapely.Point(field.place)))
    low, high = np.reshape(room.bounds, (2, 2))
    rng = np.random.default_rng(0)
    for _ in range(60):
        places = rng.uniform(low, high, (400, 2))
        places = places[shapely.contains_xy(room, places)]
        clusters = places[:2]
        nearest = np.argsort(np.linalg.norm(places[:, None] - clusters, axis=2).min(axis=1))
        x = places[nearest[: rng.integers(1, 15)]]
        ways = Ways.of(field, bodies, x, field.place)
        assert ways is not None
        assert not shapely.LineString(ways.route).intersects(field.walls)
        assert np.isfinite(ways.aim(x)).all()


def test_a_sheep_that_is_observed_behind_a_wall_leaves_the_flock_its_route() -> None:
    """Noise has it there; it is nearest to the centre, which a stray has drawn there as well."""
    ring = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))
    wall = ((-0.9, -0.1), (0.5, -0.1), (0.5, 0.1), (-0.9, 0.1))
    field = Field(fences=(ring,), obstacles=(wall,))
    beside = np.stack([np.linspace(-0.6, 0.0, 5), np.full(5, -0.12)], axis=1)
    beside[2, 1] = -0.09
    x = np.concatenate([beside, [[-0.3, 0.13]]])
    ways = Ways.of(field, Bodies(), x, np.array([0.0, 0.7]))
    assert ways is not None
    assert not shapely.LineString(ways.route).intersects(field.walls)
    assert np.isfinite(ways.aim(x)).all()


def test_every_flock_in_a_random_field_has_a_route() -> None:
    """To wherever a wide enough way leads from where its sheep are."""
    rng = np.random.default_rng(11)
    for _ in range(12):
        obstacles = []
        for _ in range(rng.integers(1, 7)):
            angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 8)))
            circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            obstacles.append(rng.uniform(-1.5, 1.5, 2) + rng.uniform(0.1, 0.4) * circle)
        steps = rng.normal(0.0, 0.3, (4, 2))
        fence = rng.uniform(-1.5, 1.5, 2) + np.cumsum(steps, axis=0)
        field = Field(obstacles=[each.tolist() for each in obstacles], fences=[fence.tolist()])
        free = shapely.box(-2.2, -2.2, 2.2, 2.2).difference(field.walls.buffer(0.11))
        room = max(shapely.get_parts(free), key=lambda part: part.area)
        for _ in range(5):
            places = rng.uniform(-2.0, 2.0, (200, 2))
            places = places[shapely.contains_xy(room, places)]
            ways = Ways.of(field, Bodies(), places[: rng.integers(1, 12)], places[-1])
            assert ways is not None
            assert not shapely.LineString(ways.route).intersects(field.walls)
