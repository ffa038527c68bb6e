# SPDX-License-Identifier: Apache-2.0
"""The cells of a map that are occupied, as a few walls. No ROS."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import TYPE_CHECKING

from herding_ros.checks import Refused
from herding_ros.model.field import Field, Point
from herding_ros.model.state import Array
import numpy as np
from numpy.typing import NDArray
import shapely

if TYPE_CHECKING:
    from shapely import Geometry

MOST_PIECES = 100
"""Straight pieces of wall: the first route among so many takes a second to find, others 10 ms."""

_COARSEST = 16
"""So many cells along each side are taken together at most."""

_MOST_BLOCKS = 2_000
"""Rectangles of cells that are joined; it takes 0.3 s."""

_TOLERANCES = ((0.75, 1), (1.5, 2))
"""Corners that stand out by less are left out [cells], where that leaves so many times fewer.

By the first, above 1/sqrt(2), stairs at 45 deg become a line, and a line of single cells stays
what it is; by the second, above sqrt(2), all others do, too.
"""

_TOUCH = 1e-3
"""Cells that touch at a corner are joined by so much [cells]."""


@dataclass(frozen=True)
class Grid:
    """A map.

    occupied: (rows, columns); resolution: side of a cell [m]; x, y, yaw: where the corner of
    occupied[0, 0] is [m], and where its rows lead [rad].
    """

    occupied: NDArray[np.bool_]
    resolution: float
    x: float
    y: float
    yaw: float

    def equals(self, other: Grid) -> bool:
        """Whether it is the same map."""
        place = self.resolution, self.x, self.y, self.yaw
        return place == (other.resolution, other.x, other.y, other.yaw) and np.array_equal(
            self.occupied, other.occupied
        )


@dataclass(frozen=True)
class Walls:
    """Walls as a `Field` has them: fences, and obstacles; the unit is the metre.

    coarsened: how many cells of the map were taken together along a side.
    """

    fences: tuple[tuple[Point, ...], ...] = ()
    obstacles: tuple[tuple[Point, ...], ...] = ()
    coarsened: int = 1

    def added_to(self, field: Field) -> Field:
        """Return a field with these walls too; ValueError if its goal is in one of them."""
        return replace(
            field,
            fences=(*field.fences, *self.fences),
            obstacles=(*field.obstacles, *self.obstacles),
        )


NO_WALLS = Walls()


def walls_of(grid: Grid) -> Walls:
    """Return walls that hold all occupied cells.

    They are obstacles, or fences along the outlines of what has holes. Stairs of cells become
    straight, which makes a wall up to three cells thicker. Where more than MOST_PIECES straight
    pieces are left, the map is made coarser, and so walls thicker: a block of cells is occupied
    if one of them is. Raises Refused where blocks of 16 x 16 do not suffice.
    """
    occupied, coarsened = grid.occupied, 1
    while coarsened <= _COARSEST:
        blocks = _blocks(occupied)
        if len(blocks) <= _MOST_BLOCKS:
            parts = shapely.get_parts(_joined(blocks))
            if 3 * len(parts) <= MOST_PIECES:
                area = shapely.union_all([_simplified(part) for part in parts])
                if shapely.get_num_coordinates(area) <= MOST_PIECES:
                    return _in_metres(area, grid, coarsened)
        occupied, coarsened = _coarser(occupied), 2 * coarsened
    raise Refused(
        'too many walls',
        f'walls must have at most {MOST_PIECES} straight pieces, got more even with cells of '
        f'{_COARSEST * grid.resolution:g} m; publish a map without specks and small things',
    )


def _blocks(occupied: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Return rectangles (n, 4) of occupied cells: the first row and column, and past the last."""
    edges = np.diff(np.pad(occupied, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    rows, first = np.nonzero(edges == 1)
    last = np.nonzero(edges == -1)[1]
    order = np.lexsort((rows, last, first))
    rows, first, last = rows[order], first[order], last[order]
    # Equal runs of cells in successive rows are one.
    goes_on = (np.diff(rows) == 1) & (np.diff(first) == 0) & (np.diff(last) == 0)
    begin = np.flatnonzero(~np.concatenate([[False], goes_on])) if len(rows) else rows
    end = np.concatenate([begin[1:], [len(rows)]]) - 1 if len(rows) else rows
    return np.stack([rows[begin], first[begin], rows[end] + 1, last[begin]], axis=1)


def _joined(blocks: NDArray[np.int_]) -> Geometry:
    low_y, low_x, high_y, high_x = blocks.T
    boxes = shapely.box(low_x - _TOUCH, low_y - _TOUCH, high_x + _TOUCH, high_y + _TOUCH)
    return shapely.union_all(boxes)


def _simplified(part: Geometry) -> Geometry:
    """Return a polygon with fewer corners that holds all of this one."""
    corners = shapely.points(shapely.get_coordinates(part))
    best, least = part, len(corners)
    for tolerance, times in _TOLERANCES:
        simple = part.simplify(tolerance)
        out = shapely.distance(corners, simple).max()
        if out > 0.0:
            simple = simple.buffer(out + _TOUCH, join_style='bevel')
        count = shapely.get_num_coordinates(simple)
        if times * count <= least and simple.covers(part):
            best, least = simple, count
    return best


def _coarser(occupied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the map in blocks of 2 x 2 cells, which are occupied if one of them is."""
    rows, columns = occupied.shape
    padded = np.pad(occupied, ((0, rows % 2), (0, columns % 2)))
    blocks = padded.reshape(-(-rows // 2), 2, -(-columns // 2), 2)
    return np.asarray(blocks.any(axis=(1, 3)))


def _in_metres(area: Geometry, grid: Grid, coarsened: int) -> Walls:
    scale, c, s = coarsened * grid.resolution, math.cos(grid.yaw), math.sin(grid.yaw)

    def placed(ring: Geometry) -> tuple[Point, ...]:
        x, y = scale * shapely.get_coordinates(ring).T
        points: Array = np.stack([grid.x + c * x - s * y, grid.y + s * x + c * y], axis=1)
        return tuple((float(a), float(b)) for a, b in points)

    fences, obstacles = [], []
    for part in shapely.get_parts(area):
        rings = [placed(ring) for ring in shapely.get_rings(part)]
        if len(rings) == 1:
            obstacles.append(rings[0][:-1])  # closed anyway
        else:
            fences += rings
    return Walls(tuple(fences), tuple(obstacles), coarsened)
