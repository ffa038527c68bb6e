# SPDX-License-Identifier: Apache-2.0
"""Walls of a map against its cells, one by one."""

from __future__ import annotations

import math

from herding_ros.checks import Refused
from herding_ros.model.field import Field
from herding_ros.nodes.occupancy import Grid, MOST_PIECES, Walls, walls_of
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.typing import NDArray
import pytest
import shapely

Cells = NDArray[np.bool_]
THICKER = 1.5 + 1.5
"""By so much a wall may be thicker than its cells [cells].

A corner that is left out stood out by 1.5 at most: so far the wall may lie outside, and by as
much it is made thicker.
"""


def inside(walls: Walls) -> shapely.Geometry:
    """What the walls enclose, which is occupied: outlines in outlines are free, and so on."""
    rings = [shapely.LinearRing(line) for line in (*walls.fences, *walls.obstacles)]
    return shapely.build_area(shapely.union_all(rings)) if rings else shapely.Polygon()


def centres(cells: Cells, grid: Grid) -> NDArray[np.object_]:
    """The middles of those cells, in metres, the slow way."""
    points = []
    for row, column in zip(*np.nonzero(cells), strict=True):
        x, y = (column + 0.5) * grid.resolution, (row + 0.5) * grid.resolution
        angle = math.atan2(y, x) + grid.yaw
        r = math.hypot(x, y)
        points.append((grid.x + r * math.cos(angle), grid.y + r * math.sin(angle)))
    return shapely.points(np.array(points).reshape(-1, 2))


def check(grid: Grid) -> Walls:
    """Every occupied cell is in a wall, and no free one that is far from all occupied ones."""
    walls = walls_of(grid)
    area, tiny = inside(walls), 1e-6 * grid.resolution
    occupied = centres(grid.occupied, grid)
    assert (shapely.distance(occupied, area) <= tiny).all()
    free = centres(~grid.occupied, grid)
    in_walls = free[shapely.intersects(area, free)]
    if len(in_walls):
        near = shapely.distance(in_walls[:, None], occupied).min(axis=1)
        # Blocks of cells may begin so many cells before an occupied one, along each side.
        more = (walls.coarsened - 1) * math.sqrt(2.0)
        thickness = THICKER * walls.coarsened + more + math.sqrt(0.5)  # from a cell's middle
        assert near.max() <= thickness * grid.resolution
    assert len(walls.added_to(Field()).bars) <= MOST_PIECES
    return walls


def drawn(shape: tuple[int, int], lines: list[tuple[float, float, float, float]]) -> Cells:
    cells = np.zeros(shape, bool)
    for low_x, low_y, high_x, high_y in lines:
        t = np.linspace(0.0, 1.0, 8 * max(shape))
        rows = ((1.0 - t) * low_y + t * high_y) * (shape[0] - 1)
        columns = ((1.0 - t) * low_x + t * high_x) * (shape[1] - 1)
        cells[np.rint(rows).astype(int), np.rint(columns).astype(int)] = True
    return cells


parts = st.floats(0.0, 1.0)
maps = st.builds(
    drawn,
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.lists(st.tuples(parts, parts, parts, parts), max_size=5),
)


@given(
    maps, st.sampled_from([0.02, 0.05, 1.0]), st.floats(-1e3, 1e3), st.floats(-math.pi, math.pi)
)
@settings(max_examples=60, deadline=None)
def test_walls_hold_all_occupied_cells_and_hardly_more(
    cells: Cells, resolution: float, x: float, yaw: float
) -> None:
    check(Grid(cells, resolution, x, -x, yaw))


@pytest.mark.parametrize('density', [0.003, 0.02, 0.5, 0.97])
def test_so_do_those_of_maps_that_have_to_be_simplified(density: float) -> None:
    cells = np.random.default_rng(0).random((60, 70)) < density
    check(Grid(cells, 0.1, 3.0, 1.0, 0.3))


def test_straight_walls_are_what_they_are() -> None:
    """Four fences of one cell around a paddock, with a gate, in a field of 40 m."""
    cells = np.zeros((800, 800), bool)
    cells[100, 100:700] = cells[699, 100:700] = True
    cells[100:700, 100] = cells[100:700, 699] = True
    cells[300:360, 699] = False
    walls = check_area(Grid(cells, 0.05, -20.0, -20.0, 0.0))
    assert not walls.fences
    assert sum(map(len, walls.obstacles)) == 12
    gate = shapely.LineString([(14.97, -4.99), (14.97, -2.01)])
    assert not inside(walls).intersects(gate)


def check_area(grid: Grid) -> Walls:
    walls = walls_of(grid)
    area = grid.occupied.sum() * grid.resolution**2
    assert inside(walls).area == pytest.approx(area, rel=0.01)
    return walls


@pytest.mark.parametrize('angle', [0.05, 0.3, math.pi / 4, 1.2])
def test_a_slanting_wall_is_a_few_pieces(angle: float) -> None:
    """Two cells thick, 300 long."""
    rows, columns = np.mgrid[:320, :320]
    along = (columns - 10) * math.cos(angle) + (rows - 10) * math.sin(angle)
    across = (rows - 10) * math.cos(angle) - (columns - 10) * math.sin(angle)
    cells = (np.abs(across) < 1.0) & (along > 0.0) & (along < 300.0)
    walls = walls_of(Grid(cells, 0.05, 0.0, 0.0, 0.0))
    assert walls.coarsened == 1
    assert len(walls.added_to(Field()).bars) < 20  # of hundreds of stairs


def test_a_hole_in_a_wall_stays_free() -> None:
    cells = np.ones((40, 40), bool)
    cells[10:30, 10:30] = False
    walls = check(Grid(cells, 0.5, 0.0, 0.0, 0.0))
    assert len(walls.fences) == 2
    assert not inside(walls).intersects(shapely.Point(10.0, 10.0))


def test_walls_are_added_to_those_of_a_field() -> None:
    field = Field(fences=(((0.0, 0.0), (1.0, 0.0)),), discs=((5.0, 5.0, 1.0),), goal=((9.0, 9.0),))
    more = walls_of(Grid(np.ones((1, 1), bool), 2.0, -3.0, 0.0, 0.0)).added_to(field)
    assert (more.fences, more.discs, more.goal) == (field.fences, field.discs, field.goal)
    assert shapely.Polygon(more.obstacles[0]).area == pytest.approx(4.0, rel=0.01)
    assert walls_of(Grid(np.zeros((5, 5), bool), 2.0, 0.0, 0.0, 0.0)).added_to(field) == field


def test_specks_all_over_are_refused_with_the_remedy() -> None:
    cells = np.zeros((1600, 1600), bool)
    cells[::200, ::200] = True
    with pytest.raises(Refused, match='without specks') as refused:
        walls_of(Grid(cells, 0.05, 0.0, 0.0, 0.0))
    assert refused.value.kind == 'too many walls'
