# SPDX-License-Identifier: Apache-2.0
"""What stands in the field: fences, obstacles and pens, and where the flock should go.

A field is the external force of a crowd, `Crowd(external=field)`: sheep keep away from walls. Who
needs to know where these are asks `field_of` the crowd.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
import math
from numbers import Real
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .crowd import Crowd
from .external_form import ExternalForm, NoForce
from .parameters import LARGE
from .state import Array, HerdState

if TYPE_CHECKING:
    from shapely import Geometry

Point = tuple[float, float]

_SKIN = 0.01
"""Sheep are stopped at this part of the range of a wall from it."""

_ROUNDING = 1e-9
"""Who comes nearer by no more than this part of the distance does not come nearer."""


@dataclass(frozen=True)
class Field:
    """Walls, and the goal. All coordinates are in metres.

    fences: polylines; obstacles: polygons, whose last corner joins the first; discs: (x, y,
    radius); goal: polygon that has to hold all sheep, or a single point, or () for that of the
    parameters; hold: how long it has to hold them [s]. A wall at the distance r < a pushes a
    sheep straight away from it with the force

        b (1 - r / a)^2,    a = range [m], b = strength [m/s^2].

    Raises ValueError for what is none of this.
    """

    fences: tuple[tuple[Point, ...], ...] = ()
    obstacles: tuple[tuple[Point, ...], ...] = ()
    discs: tuple[tuple[float, float, float], ...] = ()
    goal: tuple[Point, ...] = ()
    hold: float = 5.0
    range: float = 0.12
    strength: float = 0.1

    def __post_init__(self) -> None:
        """Check, and convert lists to tuples."""
        for name, least in (('fences', 2), ('obstacles', 3)):
            lines = tuple(
                _points(f'Field.{name}[{k}]', line, least, 2)
                for k, line in enumerate(_sequence(f'Field.{name}', getattr(self, name)))
            )
            object.__setattr__(self, name, lines)
        object.__setattr__(self, 'discs', _points('Field.discs', self.discs, 0, 3))
        object.__setattr__(self, 'goal', _points('Field.goal', self.goal, 0, 2))
        if len(self.goal) == 2:
            raise ValueError('Field.goal must be a point or at least 3 corners, got 2 points')
        for name, low in (('hold', 0.0), ('range', 1e-6), ('strength', 0.0)):
            value = getattr(self, name)
            number = isinstance(value, Real) and not isinstance(value, bool)
            if not (number and low <= value <= LARGE):
                raise ValueError(
                    f'Field.{name} must be a number of at least {low:g}, got {value!r}'
                )
            object.__setattr__(self, name, float(value))
        for k, (_, _, radius) in enumerate(self.discs):
            if radius <= 0.0:
                raise ValueError(f'Field.discs[{k}] must have a radius above 0, got {radius:g}')
        if self.region is not None:
            self._check_region()

    def _check_region(self) -> None:
        from shapely import is_valid

        if not is_valid(self.region):
            raise ValueError('Field.goal must be a polygon that does not cross itself')
        if self.walls.contains(self.region):
            raise ValueError('Field.goal must not lie within an obstacle')

    @cached_property
    def bars(self) -> Array:
        """All walls as bars, (S, 5): the two ends, and how thick it is to all sides [m]."""
        lines = [*self.fences, *((*corners, corners[0]) for corners in self.obstacles)]
        straight = [(*a, *b, 0.0) for line in lines for a, b in pairwise(line) if a != b]
        round_ = [(x, y, x, y, radius) for x, y, radius in self.discs]
        return np.array([*straight, *round_], dtype=np.float64).reshape(-1, 5)

    @cached_property
    def outline(self) -> Array:
        """All walls as straight pieces (n, 2, 2) [m] for drawing; discs have 32 sides."""
        angles = np.linspace(0.0, 2.0 * np.pi, 33)
        circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        pieces: list[Array] = [self.bars[self.bars[:, 4] == 0.0, :4].reshape(-1, 2, 2)]
        for x, y, radius in self.discs:
            ring = np.array([x, y]) + radius * circle
            pieces.append(np.stack([ring[:-1], ring[1:]], axis=1))
        return np.concatenate(pieces)

    @cached_property
    def walls(self) -> Geometry:
        """All walls as one geometry."""
        import shapely  # a program's help needs none

        lines = [shapely.LineString(fence) for fence in self.fences]
        areas = [shapely.Polygon(corners) for corners in self.obstacles]
        discs = [shapely.Point(x, y).buffer(radius) for x, y, radius in self.discs]
        walls = shapely.union_all([*lines, *areas, *discs])
        shapely.prepare(walls)
        return walls

    @cached_property
    def region(self) -> Geometry | None:
        """The polygon that has to hold all sheep; None if there is none."""
        if len(self.goal) < 3:
            return None
        import shapely

        region = shapely.Polygon(self.goal)
        shapely.prepare(region)
        return region

    @cached_property
    def place(self) -> Array | None:
        """Where the middle of the flock should be (2,) [m]; None if the field has no goal."""
        if self.region is None:
            return np.array(self.goal[0]) if self.goal else None
        inside = self.region.centroid
        if not self.region.contains(inside):
            inside = self.region.representative_point()
        return np.round([inside.x, inside.y], 9) + 0.0  # no -0

    def kernel_form(self) -> ExternalForm:
        """Return the force of the walls in compiled code."""
        return self._form

    @cached_property
    def _form(self) -> ExternalForm:
        if not len(self.bars):
            return ()
        from .walls import form

        return form(self.bars, self.strength, self.range)

    def holds(self, x: Array) -> bool:
        """Whether all sheep at x (N, 2) [m] are where they should be; False without a region."""
        from shapely import contains_xy

        return self.region is not None and bool(contains_xy(self.region, x).all())

    def is_judge(self, goal: Array) -> bool:
        """Whether a flock with this goal (2,) [m] has arrived once the region holds it."""
        return (
            self.region is not None
            and self.place is not None
            and bool(np.array_equal(goal, self.place))
        )

    def away(self, points: Array) -> tuple[Array, Array]:
        """Return how far points (n, 2) [m] are from each bar, (n, S) [m], and in which direction.

        The directions (n, S, 2) are unit vectors that lead straight away; of a point on a wall
        they are zero.
        """
        start, end, radius = self.bars[:, :2], self.bars[:, 2:4], self.bars[:, 4]
        along = end - start
        square = np.square(along).sum(axis=1)
        part = ((points[:, None] - start) * along).sum(axis=2) / np.where(square, square, 1.0)
        off = points[:, None] - start - np.clip(part, 0.0, 1.0)[..., None] * along
        length = np.linalg.norm(off, axis=2)
        return length - radius, off / np.where(length, length, 1.0)[..., None]

    def gaps(self, points: Array) -> Array:
        """Return how far points (n, 2) [m] are from the nearest bar, (n,) [m]."""
        from .walls import gaps

        return gaps(np.ascontiguousarray(points), self.bars)  # one kernel for all layouts

    def check_clear(self, state: HerdState, radius: float) -> None:
        """Raise ValueError unless no sheep is on a wall, and no dog of this radius [m]."""
        if not len(self.bars):
            return
        from shapely import distance, points

        for name, places, least in (('sheep', state.x, 0.0), ('dogs', state.dogs, radius)):
            gaps = distance(points(places), self.walls)
            if not (gaps > least).all():
                worst = int(gaps.argmin())
                raise ValueError(
                    f'{name} must start clear of walls, more than {least:g} m from them, got '
                    f'({places[worst, 0]:g}, {places[worst, 1]:g}), {gaps[worst]:g} m from one; '
                    'see start.*'
                )

    def stopped(self, before: Array, after: Array, least: float = 0.0) -> NDArray[np.bool_]:
        """Return which straight steps from before to after (n, 2) [m] a wall stops.

        These are those that come nearer to it than `least` [m] or, for sheep, a hundredth of its
        range, unless they lead away. So who takes the others only never crosses a wall.
        """
        from shapely import distance, linestrings, points

        least = max(least, _SKIN * self.range)
        stopped = np.zeros(len(before), dtype=np.bool_)
        near = self.gaps(before) <= 1.001 * (np.linalg.norm(after - before, axis=1) + least)
        if not near.any():  # as nearly always; the exact answer takes longer
            return stopped
        before, after = before[near], after[near]
        nearest = distance(linestrings(np.stack([before, after], axis=1)), self.walls)
        was = distance(points(before), self.walls)
        stopped[near] = (nearest < least) & (nearest < was * (1.0 - _ROUNDING))
        return stopped

    def turned_back(self, x: Array, v: Array) -> Array:
        """Return velocities v (n, 2) [m/s] of sheep at x (n, 2) [m] reflected at the nearest wall.

        Those that lead away from it stay.
        """
        gaps, directions = self.away(x)
        normal = directions[np.arange(len(x)), gaps.argmin(axis=1)]
        towards = np.minimum((v * normal).sum(axis=1, keepdims=True), 0.0)
        return v - 2.0 * towards * normal

    def around(self, crowd: Crowd) -> Crowd:
        """Return a crowd in this field; ValueError if another force from outside acts on it."""
        if not isinstance(crowd.external, NoForce | Field):
            raise ValueError(
                f'a crowd in a field must have no other external force, got {crowd.external!r}'
            )
        return replace(crowd, external=self)

    @classmethod
    def of(cls, content: Any) -> Field:
        """Return the field that the content of a file describes; ValueError if it does not."""
        keys = {'fences', 'obstacles', 'discs', 'pens', 'goal', 'hold', 'range', 'strength'}
        if not isinstance(content, Mapping):
            raise ValueError(f'a field must have some of {", ".join(sorted(keys))}')
        given = {key: value for key, value in content.items() if key != 'parameters'}
        if unknown := sorted(map(str, set(given) - keys)):
            raise ValueError(
                f'a field has no {", ".join(unknown)}; it may have parameters and '
                + ', '.join(sorted(keys))
            )
        pens = given.pop('pens', {})
        if not isinstance(pens, Mapping):
            raise ValueError(f'pens must have names, got {pens!r}')
        goal = given.pop('goal', ())
        if isinstance(goal, str):
            if goal not in pens:
                raise ValueError(f'goal must be a pen, {" or ".join(pens) or "none"}, got {goal}')
            goal = pens[goal]
        elif goal and isinstance(goal[0], int | float):
            goal = (goal,)
        return cls(goal=goal, **given)


def _sequence(name: str, value: object) -> Sequence[Any] | NDArray[Any]:
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
        raise ValueError(f'{name} must be a list, got {value!r}')
    return value


def _points(name: str, value: object, least: int, size: int) -> tuple[Any, ...]:
    """Return points as tuples of `size` numbers, at least so many."""
    try:
        points = tuple(
            tuple(float(each) for each in _sequence(name, point))
            for point in _sequence(name, value)
        )
    except (TypeError, ValueError):
        points = ((math.nan,),)
    numbers = all(
        len(point) == size and all(abs(each) <= LARGE for each in point) for point in points
    )
    if not numbers or len(points) < least:
        raise ValueError(
            f'{name} must be a list of at least {least} points of {size} numbers, got {value!r}'
        )
    return points


_SHIPPED = Path(__file__).with_name('fields')

_LARGEST = 1_000_000
"""A bag, which may come from anybody, names the file; to read it must not take for ever."""


def shipped_fields() -> list[str]:
    """Return the names of the fields that come with the package."""
    return sorted(file.stem for file in _SHIPPED.glob('*.yaml'))


def read_field(name: str) -> tuple[Field, dict[str, Any]]:
    """Return a field and the parameters that go with it, by their dotted names.

    name: of a field that comes with the package, such as pen, or a YAML file. Raises ValueError
    if there is none, or it is no field.
    """
    import yaml

    shipped = name in shipped_fields()
    file = _SHIPPED / f'{name}.yaml' if shipped else Path(name).expanduser()
    try:
        if not (file.is_file() and file.stat().st_size <= _LARGEST):
            raise ValueError(f'it must be a file of at most {_LARGEST} bytes')
        content = yaml.safe_load(file.read_text(encoding='utf-8'))
        field = Field.of(content)
        parameters = content.get('parameters') or {}
        if not isinstance(parameters, Mapping):
            raise ValueError(f'parameters must have names, got {parameters!r}')
    except (OSError, yaml.YAMLError, TypeError, ValueError) as error:
        raise ValueError(
            f'field must be {", ".join(shipped_fields())} or the file of one, got {name}: {error}'
        ) from None
    return field, dict(parameters)


NO_FIELD = Field()
"""A field without anything in it."""


def field_of(crowd: Crowd) -> Field:
    """Return the field that a crowd is in."""
    return crowd.external if isinstance(crowd.external, Field) else NO_FIELD
