# SPDX-License-Identifier: Apache-2.0
"""How flock and dogs get about among walls: routes, and posts that walls do not hide.

A shortest way among walls leads from corner to corner of them, at a clearance: it is found in the
graph of the corners that see each other (visibility graph; Lozano-Perez and Wesley 1979).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
import math

from herding_ros.model.field import Field
from herding_ros.model.flock import centre, spread
from herding_ros.model.state import Array
import numpy as np
from numpy.typing import NDArray

from .parameters import Bodies

_INNER = 0.9
"""Lines may come this part of the clearance near; round corners are polygons, with less of it."""

_PER_OCTAVE = 4
"""Clearances are rounded down to steps of which so many halve it, so that few graphs are made."""

_STARTS = 50
"""From so many sheep a way is sought: of a huge flock without one, from all would take seconds."""

_DETOUR = 1.5
"""A wide way is not taken if it is more than so many times as long as the shortest."""


@dataclass(frozen=True)
class Corners:
    """The corners of all walls of a field at a clearance [m], and the ways between them."""

    field: Field
    clearance: float

    @cached_property
    def _blocked(self):  # type: ignore[no-untyped-def]  # shapely has no types
        import shapely

        blocked = self.field.walls.buffer(_INNER * self.clearance, quad_segs=8)
        shapely.prepare(blocked)
        return blocked

    @cached_property
    def _edge(self):  # type: ignore[no-untyped-def]
        # Sides of up to 1.5 x 30 deg, so no nearer than cos 22.5 deg > _INNER.
        return self.field.walls.buffer(self.clearance, quad_segs=3).boundary

    @cached_property
    def _graph(self) -> tuple[Array, Array, NDArray[np.int_]]:
        """Corners (n, 2), the lengths of ways between them (n, n), and the corner before each."""
        from scipy.sparse.csgraph import shortest_path
        import shapely

        corners = np.unique(shapely.get_coordinates(self._edge), axis=0)
        lengths = np.linalg.norm(corners[:, None] - corners, axis=2)
        seen = np.where(self.sees(corners, corners), lengths, 0.0)  # 0: no way
        return corners, *shortest_path(seen, directed=False, return_predecessors=True)

    def sees(self, a: Array, b: Array) -> NDArray[np.bool_]:
        """Return whether a straight way leads from each of a (n, 2) to each of b (m, 2)."""
        return ~_cross(self._blocked, a, b)

    def way(self, start: Array, end: Array) -> Array | None:
        """Return the corners (n, 2) of the shortest way between two points; None if there is none.

        A point that is too near to a wall first leaves it.
        """
        points, ends = [start, end], []
        for point in points:
            free = self._freed(point)
            if free is None:
                return None
            ends.append(free)
        a, b = (each[-1:] for each in ends)
        if self.sees(a, b)[0, 0]:
            middle: Array = np.zeros((0, 2))
        else:
            corners, lengths, before = self._graph
            first, last = (
                np.where(
                    self.sees(each, corners)[0], np.linalg.norm(corners - each, axis=1), np.inf
                )
                for each in (a, b)
            )
            total = first[:, None] + lengths + last
            if not np.isfinite(total).any():
                return None
            i, j = np.unravel_index(total.argmin(), total.shape)
            passed = [int(j)]
            while passed[-1] != i:
                passed.append(int(before[i, passed[-1]]))
            middle = corners[passed[::-1]]
        return np.concatenate([ends[0], middle, ends[1][::-1]])

    def first_turns(self, points: Array, ends: Array) -> tuple[Array, Array]:
        """Return where shortest ways from points to ends (n, 2) turn first, and what is left.

        Where walls hide no way that is the end itself, and nothing [m]. The clearance is kept from
        the first corner on: who is nearer to a wall can get there. NaN where there is no way.
        """
        hidden = _hidden(self.field, points, ends)
        turns, rest = np.array(ends), np.zeros(len(points))
        if hidden.any():
            corners, lengths, _ = self._graph
            places, which = np.unique(ends[hidden], axis=0, return_inverse=True)
            left = (lengths[:, :, None] + self._straight(corners, places)).min(axis=1)
            total = self._straight(points[hidden], corners) + left.T[which]
            best = total.argmin(axis=1)
            found = np.isfinite(total.min(axis=1))
            turns[hidden] = np.where(found[:, None], corners[best], np.nan)
            rest[hidden] = np.where(found, left[best, which], np.nan)
        return turns, rest

    def _straight(self, a: Array, b: Array) -> Array:
        """Return the lengths (n, m) of straight ways from a to b [m], infinite through a wall."""
        length = np.linalg.norm(a[:, None] - b, axis=2)
        return np.where(_cross(self.field.walls, a, b), np.inf, length)

    def _freed(self, point: Array) -> Array | None:
        """Return the way (1 or 2, 2) from a point to where the walls are far enough, or None."""
        import shapely

        here = shapely.Point(point)
        if not self._blocked.intersects(here):
            return point[None]
        line = shapely.shortest_line(here, self._edge)
        if line is not None and not line.intersects(self.field.walls):
            return shapely.get_coordinates(line)
        corners, _, _ = self._graph
        away = self._straight(point[None], corners)[0]
        if not np.isfinite(away).any():
            return None
        return np.stack([point, corners[away.argmin()]])


def _cross(shape, a: Array, b: Array) -> NDArray[np.bool_]:  # type: ignore[no-untyped-def]
    """Return whether a shape meets the lines from each of a (n, 2) to each of b (m, 2)."""
    import shapely

    lines = np.stack(np.broadcast_arrays(a[:, None], b[None]), axis=2)
    return np.asarray(shapely.intersects(shape, shapely.linestrings(lines)))


def _hidden(field: Field, a: Array, b: Array) -> NDArray[np.bool_]:
    """Return (n,) whether a wall is between each of a and its counterpart of b (n, 2)."""
    import shapely

    lines = shapely.linestrings(np.stack([a, b], axis=1))
    return np.asarray(shapely.intersects(field.walls, lines))


@lru_cache(maxsize=64)
def corners(field: Field, clearance: float) -> Corners:
    """Return the corners of a field, made once."""
    return Corners(field, clearance)


def _clearances(most: float, least: float) -> Iterator[float]:
    """Yield clearances [m] of a series of fixed ones between the most and the least."""
    step = math.floor(_PER_OCTAVE * math.log2(max(most, least)))
    while (clearance := 2.0 ** (step / _PER_OCTAVE)) > least:
        yield clearance
        step -= 1


def route(field: Field, start: Array, goal: Array, width: float, least: float) -> Array:
    """Return the route (n, 2) [m] of a flock from start to goal (2,) [m].

    It keeps as far from walls as the flock is wide (half its width) or, where that leaves no way
    or one that is too long, as far as the narrowest gate on it allows: at least `least` [m].
    Raises ValueError if there is no way.
    """
    shortest = corners(field, least).way(start, goal)
    if shortest is None:
        raise ValueError(
            f'a way must lead from ({start[0]:g}, {start[1]:g}) to ({goal[0]:g}, {goal[1]:g}) m, '
            f'got walls with no gap of {2.0 * least:g} m; open a gate in the field'
        )
    for clearance in _clearances(width, least):
        found = corners(field, clearance).way(start, goal)
        if found is not None and _length(found) <= _DETOUR * _length(shortest):
            return found
    return shortest


def _length(way: Array) -> float:
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def _middles(field: Field, x: Array) -> Iterator[Array]:
    """Yield where a flock at x (N, 2) may be said to be (2,) [m], the best first.

    That is its centre; but where it is on both sides of a corner, a wall may be before its centre,
    and then it is the place of the sheep that is nearest to that. This one may be observed on the
    wrong side of a wall, by noise: then it is the next.
    """
    middle = centre(x)
    nearest = x[np.square(x - middle).sum(axis=1).argsort(kind='stable')]
    if not _hidden(field, nearest[:1], middle[None])[0]:
        yield middle
    yield from nearest[:_STARTS]


@dataclass(frozen=True)
class Ways:
    """The ways of a flock and its dogs in a field.

    route: (n, 2) [m] of the flock's centre, from where it is to the goal; ahead: how far along it
    the dogs aim [m]; clearance: that dogs keep from walls [m].
    """

    field: Field
    route: Array
    ahead: float
    clearance: float

    @classmethod
    def of(cls, field: Field, bodies: Bodies, x: Array, goal: Array) -> Ways | None:
        """Return the ways of a flock at x (N, 2) [m] to a goal (2,) [m]; None without walls.

        Raises ValueError if no way leads from any sheep.
        """
        if not len(field.bars):
            return None
        clearance = bodies.wall_distance + 2.0 * bodies.margin
        width = math.sqrt(2.0) * float(spread(x))  # the radius of a disc with that spread
        shut_in: ValueError | None = None
        for start in _middles(field, x):
            try:
                return cls(field, route(field, start, goal, width, clearance), width, clearance)
            except ValueError as error:
                shut_in = shut_in or error
        assert shut_in is not None
        raise shut_in

    def aim(self, x: Array) -> Array:
        """Return where a flock at x (N, 2) is to be driven (2,) [m]: a point ahead on its route.

        It is the end of the leg that the flock is on, unless that is nearer than `ahead`.
        """
        middle = next(_middles(self.field, x))
        start, along = self.route[:-1], np.diff(self.route, axis=0)
        lengths = np.maximum(np.linalg.norm(along, axis=1), 1e-12)
        part = np.clip(((middle - start) * along).sum(axis=1) / lengths**2, 0.0, 1.0)
        off = np.linalg.norm(start + part[:, None] * along - middle, axis=1)
        leg = int(off.argmin())
        left = self.ahead - (1.0 - part[leg]) * lengths[leg]
        for k in range(leg + 1, len(lengths)):
            if left <= 0.0:
                break
            if left < lengths[k]:
                return start[k] + left / lengths[k] * along[k]
            leg, left = k, left - lengths[k]
        return self.route[leg + 1]

    def in_front(self, x: Array, posts: Array) -> Array:
        """Return posts (M, 2) [m] on the same side of walls as the sheep nearest to them."""
        import shapely

        nearest = x[np.linalg.norm(posts[:, None] - x, axis=2).argmin(axis=1)]
        lines = shapely.linestrings(np.stack([nearest, posts], axis=1))
        out = np.array(posts)
        for m in np.flatnonzero(shapely.intersects(self.field.walls, lines)):
            hit = shapely.distance(
                shapely.Point(nearest[m]), shapely.intersection(lines[m], self.field.walls)
            )
            out[m] = nearest[m] + hit / shapely.length(lines[m]) * (posts[m] - nearest[m])
            out[m] += 1e-3 * (nearest[m] - posts[m])  # on its side
        for _ in range(2):  # out of a corner
            if self.field.gaps(out).min() >= self.clearance:
                break
            gaps, away = self.field.away(out)
            lacking = np.maximum(self.clearance - gaps, 0.0)
            for bar in np.flatnonzero(lacking.any(axis=0)):
                out += lacking[:, bar, None] * away[:, bar]
        return out

    def round_walls(self, x: Array, place: Array) -> tuple[Array, Array]:
        """Return where sheep at x (n, 2) are led first on their ways to a place, and the rest.

        NaN, and no rest [m], where no wall is before them, or no way leads round it.
        """
        places = np.broadcast_to(place, x.shape)
        turns, rest = corners(self.field, self.clearance).first_turns(x, places)
        return np.where(rest[:, None] > 0.0, turns, np.nan), np.where(rest > 0.0, rest, 0.0)

    def steps(self, d: Array, posts: Array) -> Array:
        """Return where dogs at d (M, 2) [m] go first on their ways to posts (M, 2).

        That is the post itself, unless a wall is between.
        """
        found, _ = corners(self.field, self.clearance).first_turns(d, posts)
        return np.where(np.isnan(found), posts, found)
