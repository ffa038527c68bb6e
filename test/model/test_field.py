# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
import re
from typing import Any

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.costs.tracking import Tracking
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.dynamics import forces
from herding_ros.model.expectation import mean_centre
from herding_ros.model.field import Field, field_of, NO_FIELD, read_field, shipped_fields
from herding_ros.model.mean_field import mean_field
from herding_ros.model.noise import noise_paths
from herding_ros.model.parameters import Parameters
from herding_ros.model.sampling import FineModel
from herding_ros.model.scenario import Start
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest
import shapely

HerdMaker = Callable[..., HerdState]

SQUARE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))
FIELD = Field(
    fences=(SQUARE, ((0.3, -0.2), (0.3, 0.4))),
    obstacles=(((-0.6, 0.2), (-0.3, 0.3), (-0.5, 0.6)),),
    discs=((0.1, -0.6, 0.15),),
    range=0.3,
)


def slow_force(x: Array, field: Field = FIELD) -> Array:
    """By shapely's nearest points, piece by piece."""
    lines = [*field.fences, *((*corners, corners[0]) for corners in field.obstacles)]
    pieces = [(shapely.LineString(ends), 0.0) for line in lines for ends in pairwise(line)]
    pieces += [(shapely.Point(x, y), radius) for x, y, radius in field.discs]
    out = np.zeros_like(x)
    for i, place in enumerate(shapely.points(x)):
        for piece, radius in pieces:
            r = place.distance(piece)
            if r - radius < field.range:
                end = shapely.get_coordinates(shapely.shortest_line(piece, place))[0]
                size = field.strength * (1.0 - (r - radius) / field.range) ** 2
                out[i] += size * (x[i] - end) / r
    return out


def random_places(count: int, seed: int = 0) -> Array:
    places = np.random.default_rng(seed).uniform(-1.2, 1.2, (3 * count, 2))
    inside = shapely.contains_xy(FIELD.walls, places)
    return np.ascontiguousarray(places[~inside][:count])


def test_walls_push_sheep_away() -> None:
    x, d = random_places(200), np.array([[50.0, 50.0]])
    crowd = Crowd()
    pushed = forces(FIELD.around(crowd), x, d) - forces(crowd, x, d)
    expected = slow_force(x)
    assert (np.abs(expected).sum(axis=1) > 0.0).mean() > 0.5
    np.testing.assert_allclose(pushed, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize('order', [1, 2])
def test_the_gradient_of_a_plan_among_walls_passes_the_taylor_test(order: int) -> None:
    crowd, rng = FIELD.around(Crowd(order=order)), np.random.default_rng(2)
    x, d = random_places(12, 3), rng.uniform(-0.9, 0.9, (3, 2))
    u, du = rng.normal(0.0, 0.05, (2, 20, 3, 2))
    model = CoarseModel(crowd, HerdState(x, np.zeros_like(x), d), 0.05, 2)
    cost = Tracking(1.0, 3.0, np.full((41, 2), 0.4))
    value, gradient = model.value_and_gradient(cost, u)
    slope = model.inner(gradient, du)
    rest = [
        abs(model.value_and_gradient(cost, u + h * du)[0] - value - h * slope)
        for h in 0.05 * 2.0 ** -np.arange(4.0)
    ]
    assert np.log2(np.divide(rest[:-1], rest[1:])).min() > 1.8
    free = replace(model, crowd=Crowd(order=order))
    assert np.abs(free.value_and_gradient(cost, u)[1] - gradient).max() > 1e-4


def test_paths_and_blobs_feel_walls() -> None:
    x = random_places(60, 4)
    crowd, state = FIELD.around(Crowd(noise=0.0)), HerdState(x, np.zeros_like(x), np.ones((1, 2)))
    u = np.zeros((10, 1, 2))
    fine = FineModel(crowd, state, 0.05, 20, 2)
    paths = noise_paths(np.random.default_rng(0), crowd, 60, 0.05, 20, 16)
    expected = CoarseModel(crowd, state, 0.05, 2).rollout(u).x.mean(axis=1)
    np.testing.assert_allclose(mean_centre(fine, u, paths), expected, rtol=0, atol=1e-12)
    limit, blobs = mean_field(crowd, state, 20)
    pushed = forces(limit, blobs.x, blobs.d) - forces(
        replace(limit, external=Crowd().external), blobs.x, blobs.d
    )
    np.testing.assert_allclose(pushed, slow_force(blobs.x), rtol=0, atol=1e-12)


def test_distances_from_walls_are_those_of_shapely() -> None:
    places = random_places(100, 5)
    gaps, away = FIELD.away(places)
    expected = shapely.distance(shapely.points(places), FIELD.walls)
    # A disc is a polygon for shapely, a little smaller.
    np.testing.assert_allclose(gaps.min(axis=1), expected, rtol=0, atol=2e-4)
    step = 1e-6 * away[np.arange(100), gaps.argmin(axis=1)]
    farther = FIELD.away(places + step)[0].min(axis=1) - gaps.min(axis=1)
    np.testing.assert_allclose(farther, 1e-6, rtol=1e-3)


@pytest.mark.parametrize('crowd', [CROWDS['independent'], Crowd(noise=30.0)])
def test_no_sheep_crosses_a_fence_whatever_the_noise(crowd: Crowd) -> None:
    """In a pen of thin fences, with steps of up to many times the range of these."""
    crowd = replace(crowd, noise=max(crowd.noise, 1.0))
    field = Field(fences=(SQUARE, ((-1.0, 0.0), (1.0, 0.0))), strength=0.0)
    world = World(sheep=30, dogs=1, start=Start(half_width=0.9, dogs='inside', dog_radius=0.0))
    simulation = Simulation(field.around(crowd), world, np.zeros(2))
    simulation.state = replace(simulation.state, d=np.array([[0.5, 0.5]]))
    above = simulation.state.x[:, 1] > 0.0
    paths = []
    for _ in range(50):
        simulation.advance(np.zeros((1, 2)))
        paths.append(simulation.state.x)
    x = np.array(paths)
    assert np.abs(x).max() < 1.0
    assert ((x[..., 1] > 0.0) == above).all()
    assert np.abs(np.diff(x, axis=0)).max() > 0.01  # they do move
    free = Simulation(crowd, world, np.zeros(2))
    for _ in range(50):
        free.advance(np.zeros((1, 2)))
    assert np.abs(free.state.x).max() > 1.0  # and would be elsewhere


@pytest.mark.parametrize('least', [0.0, 0.05])
def test_a_step_is_stopped_if_it_comes_too_near_to_a_wall(least: float) -> None:
    """Against Shapely, step by step."""
    rng = np.random.default_rng(5)
    before = random_places(2000, seed=6)
    after = before + rng.normal(size=(2000, 2)) * rng.uniform(0.0, 0.1, (2000, 1))
    keep = max(least, 0.01 * FIELD.range)
    steps = shapely.linestrings(np.stack([before, after], axis=1))
    nearest = shapely.distance(steps, FIELD.walls)
    nearer = nearest < shapely.distance(shapely.points(before), FIELD.walls) * (1.0 - 1e-9)
    stopped = FIELD.stopped(before, after, least)
    assert (stopped == ((nearest < keep) & nearer)).all()
    assert 20 < np.count_nonzero(stopped) < 1000


def test_a_dog_stops_at_a_wall_and_is_counted() -> None:
    field = Field(fences=(((0.5, -1.0), (0.5, 1.0)),), discs=((0.0, 0.8, 0.1),))
    world = World(sheep=1, dogs=2, max_speed=0.5)
    start = HerdState([[3.0, 3.0]], [[0.0, 0.0]], [[0.0, 0.0], [0.0, 0.5]])
    simulation = Simulation(field.around(Crowd(noise=0.0)), world, np.zeros(2), start)
    for _ in range(20):
        simulation.advance(np.array([[0.5, 0.1], [0.0, 0.5]]))
    d = simulation.state.d
    assert 0.0 <= 0.5 - world.bodies.radius - d[0, 0] < 0.01
    assert 0.0 <= 0.7 - world.bodies.radius - d[1, 1] < 0.01
    assert simulation.stops > 10
    before = simulation.stops
    simulation.advance(np.array([[-0.5, 0.0], [0.0, -0.5]]))  # away it may go
    np.testing.assert_allclose(simulation.state.d - d, [[-0.05, 0.0], [0.0, -0.05]], atol=1e-12)
    assert simulation.stops == before


def test_a_flock_has_arrived_once_the_region_has_held_all_sheep() -> None:
    field = Field(goal=SQUARE[:-1], hold=1.0)
    world = World(sheep=20, dogs=1)
    simulation = Simulation(field.around(Crowd(noise=0.0)), world, field.place)
    arrived = []
    for _ in range(12):
        arrived.append(simulation.arrived)
        simulation.advance(np.zeros((1, 2)))
    assert arrived == [False] * 10 + [True] * 2
    x = simulation.state.x.copy()
    x[0] = [1.1, 0.0]
    simulation.state = replace(simulation.state, x=x)
    simulation.advance(np.zeros((1, 2)))
    assert not simulation.arrived
    simulation.goal = simulation.state.x.mean(axis=0)  # moved: a point like any other
    assert simulation.arrived


def test_herds_start_clear_of_walls() -> None:
    field = Field(fences=(((-0.9, -0.02), (-0.8, 0.1)),))
    with pytest.raises(ValueError, match=re.escape('dogs must start clear of walls, more than')):
        Simulation(field.around(Crowd()), World(dogs=1), np.array([1.0, 0.0]))


def test_crowds_without_a_field_are_in_an_empty_one() -> None:
    assert field_of(Crowd()) is NO_FIELD
    assert NO_FIELD.place is None
    assert not NO_FIELD.holds(np.zeros((1, 2)))
    assert NO_FIELD.kernel_form() == ()
    assert field_of(FIELD.around(Crowd())) == FIELD


def test_two_forces_from_outside_are_refused() -> None:
    class Wind(Parameters):
        def kernel_form(self) -> tuple[()]:
            return ()

    with pytest.raises(ValueError, match='must have no other external force'):
        FIELD.around(Crowd(external=Wind()))


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        ([], 'a field must have some of'),
        ({'fence': []}, 'a field has no fence'),
        ({'fences': [[[0, 0]]]}, 'Field.fences[0] must be a list of at least 2 points'),
        ({'fences': [[[0, 0], [0, float('nan')]]]}, 'Field.fences[0] must be a list'),
        ({'fences': [[[0, 0], 'ab']]}, 'Field.fences[0] must be a list'),
        ({'fences': 3}, 'Field.fences must be a list'),
        ({'discs': [[0, 0]]}, 'Field.discs must be a list of at least 0 points of 3 numbers'),
        ({'discs': [[0, 0, 0]]}, 'Field.discs[0] must have a radius above 0'),
        ({'goal': 'pen'}, 'goal must be a pen, none, got pen'),
        ({'goal': [[0, 0], [1, 1]]}, 'Field.goal must be a point or at least 3 corners'),
        ({'goal': [[0, 0], [1, 1], [1, 0], [0, 1]]}, 'must be a polygon that does not cross'),
        ({'range': 0}, 'Field.range must be a number of at least 1e-06, got 0'),
        ({'strength': 'much'}, "Field.strength must be a number of at least 0, got 'much'"),
        ({'pens': 3}, 'pens must have names, got 3'),
        ({'parameters': 3}, 'parameters must have names, got 3'),
    ],
)
def test_files_that_are_no_fields_are_refused(content: Any, message: str, tmp_path: Path) -> None:
    import yaml

    file = tmp_path / 'field.yaml'
    file.write_text(yaml.safe_dump(content))
    with pytest.raises(ValueError, match=re.escape(message)) as refused:
        read_field(str(file))
    assert str(file) in str(refused.value)


def test_arrays_and_numbers_of_numpy_make_the_same_field() -> None:
    square, other = [[-1, -1], [1, -1], [0, 1]], [[0.3, -0.2], [0.3, 0.4]]
    lists = Field([square, other], [square], [[2, 3, 0.5]], other[:1], 2.0, 1.0)  # type: ignore
    arrays = Field(
        fences=[np.array(square), np.array(other)],  # type: ignore[arg-type]
        obstacles=np.array([square]),  # type: ignore[arg-type]
        discs=np.array([[2, 3, 0.5]]),  # type: ignore[arg-type]
        goal=np.array(other[:1]),  # type: ignore[arg-type]
        hold=np.int64(2),
        range=np.float32(1.0),  # type: ignore[arg-type]
    )
    assert arrays == lists
    assert hash(arrays) == hash(lists)
    with pytest.raises(ValueError, match=r'^Field\.fences\[0\] must be a list of at least 2'):
        Field(fences=np.zeros((1, 2, 3)))  # type: ignore[arg-type]


def test_missing_fields_are_refused_with_the_names_of_those_there_are() -> None:
    with pytest.raises(ValueError, match=r'corner.*pen.*got no_such_field'):
        read_field('no_such_field')


@pytest.mark.parametrize('name', shipped_fields())
def test_herds_start_within_shipped_fields(name: str) -> None:
    """Where a line from the flock to each of them meets no wall."""
    field, parameters = read_field(name)
    crowd = CROWDS[parameters.pop('crowd.preset', 'cohesive')]
    own = {key: value for key, value in parameters.items() if key in World().flat()}
    for seed in range(5):
        world = World(dogs=5, seed=seed).with_values(own)
        herd = Simulation(field.around(crowd), world, field.place).state
        places = np.concatenate([herd.x, herd.dogs])
        lines = [shapely.LineString([place, world.start.centre]) for place in places]
        assert not shapely.intersects(field.walls, lines).any()
