# SPDX-License-Identifier: Apache-2.0
"""Who fetches whom: the sheep that have strayed, and a dog for each."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.flock import centre
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array, HerdState
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from .detour import detour
from .reach import Reach
from .ways import Ways

_STRAYED = 2.5
"""Multiple of the median distance from the flock's middle beyond which a sheep has strayed.

Of a normally distributed flock about one in eighty sheep is farther off than that.
"""
_CLEARANCE = 0.25
"""Dogs pass a flock at this part of their reach."""
_SCATTERED = 2.0
"""A flock is herded one by one when its radius exceeds this multiple of the dogs' reach."""


@dataclass(frozen=True)
class Errands:
    """Which dogs fetch which sheep, and where to.

    together: (N,) whether a sheep is with the flock; dogs, sheep: (k,) indices of the pairs;
    goal: (2,) [m] to which each sheep is driven by itself, None: strays are brought to the flock;
    inner: distance [m] from there within which a sheep needs no fetching; around: radius [m] of
    the disc around it that dogs do not cross; standoff, reach: see `Reach`; via: (k, 2) [m] where
    a stray is led first that has a wall before it, else NaN; rest: (k,) [m] how long its way is
    from there; idle: dogs that fetch nothing; drivers: (j,) of them, those that go behind the
    flock, where too few are; behind: (2,) [m] where that is, from its place.
    """

    together: NDArray[np.bool_]
    dogs: NDArray[np.int_]
    sheep: NDArray[np.int_]
    goal: Array | None
    inner: float
    around: float
    standoff: float
    reach: float
    via: Array
    rest: Array
    idle: NDArray[np.int_]
    drivers: NDArray[np.int_]
    behind: Array

    @classmethod
    def of(cls, reach: Reach, state: HerdState, goal: Array, ways: Ways | None = None) -> Errands:
        """Return the errands in a state; dogs take them so that their ways are shortest.

        Strays are sheep that are farther from the flock's middle than 2.5 times the median. Of a
        flock so scattered that dogs do not feel across it, each sheep is driven to the goal
        (2,) [m] by itself. If there are more strays than dogs, each dog fetches, of those that
        are nearer to it than to others, the farthest. Among walls strays are led along `ways`.
        Where most dogs are before the flock, among walls all of them, these go behind it.
        """
        x, d = state.x, state.dogs
        middle = _middle(x)
        off = np.linalg.norm(x - middle, axis=1)
        radius = float(np.median(off))
        individually = radius > _SCATTERED * reach.reach
        if individually:
            inner, place = reach.reach, goal
            together = np.linalg.norm(x - goal, axis=1) <= inner
            around = inner
        else:
            inner = 0.5 * _STRAYED * radius
            together = off <= _STRAYED * radius
            place = centre(x[together])
            around = float(np.linalg.norm(x[together] - place, axis=1).max())
        strays = np.flatnonzero(~together)
        around += _CLEARANCE * reach.reach
        via: Array = np.full((len(strays), 2), np.nan)
        rest: Array = np.zeros(len(strays))
        if ways is not None and len(strays):
            via, rest = ways.round_walls(x[strays], place)
        posts = behind_each(x[strays], np.where(np.isnan(via), place, via), reach.standoff)
        lengths = detour(d[:, None] - place, posts[None] - place, around)[0]
        dogs, found = _assign(lengths, np.linalg.norm(x[strays] - place, axis=1))
        left = float(np.linalg.norm(goal - place))
        ahead = (goal - place) / max(left, TINY)
        drivers = np.flatnonzero((d - place) @ ahead > 0.0)
        behind = -around * ahead
        if ways is None:
            # About a flock that is nearly home there are dogs on all sides.
            goes = 2 * len(drivers) > len(d) and left > around
        else:
            # Past a flock in a lane the way is narrow, and long: only if no dog is behind.
            goes = len(drivers) == len(d)
        if individually or not goes:
            drivers = drivers[:0]
        elif ways is not None:
            behind = ways.in_front(x, (place + behind)[None])[0] - place
        idle = np.setdiff1d(np.arange(len(d)), dogs)
        return cls(
            together, dogs, strays[found], goal if individually else None, inner, around,
            reach.standoff, reach.reach, via[found], rest[found],
            idle, np.intersect1d(drivers, idle), behind,
        )  # fmt: skip

    def place(self, x: Array) -> Array:
        """Return where strays are brought (2,) [m], for sheep at x (N, 2) [m]."""
        return centre(x[self.together]) if self.goal is None else self.goal

    def places(self, x: Array) -> Array:
        """Return where each stray is led first (k, 2) [m]."""
        return np.where(np.isnan(self.via), self.place(x), self.via)


def _middle(x: Array) -> Array:
    """Return the middle (2,) of most sheep: of the half that is nearest to the centre, twice."""
    # A program's help needs no Numba.
    from herding_ros.model.errand_kernels import middle

    out = np.empty(2)
    middle(np.ascontiguousarray(x), out)
    return out


def behind_each(x: Array, place: Array, standoff: float) -> Array:
    """Return posts (n, 2) [m] behind sheep at x (n, 2), as seen from a place (2,) or (n, 2)."""
    off = x - place
    distance = np.linalg.norm(off, axis=1, keepdims=True)
    return x + standoff * np.divide(off, distance, out=np.zeros_like(off), where=distance > 0.0)


def _assign(ways: Array, off: Array) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Return dogs and strays in pairs, for ways (M, n) [m] and how far off strays are (n,)."""
    dogs, strays = ways.shape
    if strays <= dogs:
        return linear_sum_assignment(ways)
    nearest = ways.argmin(axis=0)
    pairs = [
        (m, max(mine, key=lambda i: off[i]))
        for m in range(dogs)
        if len(mine := np.flatnonzero(nearest == m))
    ]
    busy, fetched = (np.array(each, dtype=np.int_) for each in zip(*pairs, strict=True))
    free = np.setdiff1d(np.arange(dogs), busy)
    left = np.setdiff1d(np.arange(strays), fetched)
    more, others = linear_sum_assignment(ways[np.ix_(free, left)])
    return np.concatenate([busy, free[more]]), np.concatenate([fetched, left[others]])
