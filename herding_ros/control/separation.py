# SPDX-License-Identifier: Apache-2.0
"""Dogs are kept apart: the commands nearest to those asked for that bring no two too near.

Two dogs at a distance r, of which d is allowed, may approach at no more than gain (r - d):

    n . (u_i - u_j) >= -gain (|r| - d),    n = r / |r|

(a control barrier function, after Ames et al. 2019). While commands hold for h <= 1 / gain the
relative motion of two holonomic dogs is a straight line, whose part along n never falls below d;
so neither does the distance, at no time in between. Standing still fulfils all conditions, so
there always are commands that do, and the speed limit costs nothing of it.

A command that takes effect later acts on dogs that are elsewhere. Gaps then shrink by no more
than a factor exp(-s t), with s = gain exp(s delay), which has a solution if gain * delay <= 1/e:
so `gain_for` keeps that. Time between two commands counts as delay.

Dogs whose speed changes no faster than by b [m/s^2] have to brake in time. Where all slow down in
proportion, each condition goes on to hold, and gaps shrink as exp(-s t) while speeds do; that
needs b >= s max_speed. So s is kept below b / max_speed, and braking alike is always allowed.

A dog that has to turn moves with some matrix times its command, which takes the place of u_i.

What stands in the field, as a wall does, keeps dogs away in the same manner, with u_j = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array
import numpy as np
from numpy.typing import NDArray

_TOLERANCE = 1e-8
"""Commands are the nearest ones to this part of the speed limit."""

_MISSED = 1e-6
"""Conditions that are missed by this part of the limit: the next command makes up for it."""

_MOST_WORK = 2_000_000
"""Conditions that are looked at for one command, some 20 ms, before a simpler answer is given."""

_Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Obstacles:
    """What stands where dogs may not go.

    bars: (S, 5), see `model.walls`; of a point both ends are there; keep: (S,) how far dogs keep
    from each [m]; passed: (S,) whether a dog that runs right against it passes on the right, as it
    does another dog.
    """

    bars: Array
    keep: Array
    passed: NDArray[np.bool_]

    @classmethod
    def none(cls) -> Obstacles:
        """Return nothing."""
        return cls.walls(np.zeros((0, 5)), 0.0)

    @classmethod
    def walls(cls, bars: Array, keep: float) -> Obstacles:
        """Return walls, (S, 5) bars, that dogs keep so far [m] from."""
        return cls(bars, np.full(len(bars), keep), np.zeros(len(bars), dtype=np.bool_))

    @classmethod
    def points(cls, points: Array, keep: float) -> Obstacles:
        """Return points (n, 2) [m], such as standing dogs, that dogs keep so far [m] from."""
        bars = np.concatenate([points, points, np.zeros((len(points), 1))], axis=1)
        return cls(bars, np.full(len(bars), keep), np.ones(len(bars), dtype=np.bool_))

    def and_also(self, other: Obstacles) -> Obstacles:
        """Return these and others."""
        return Obstacles(
            np.concatenate([self.bars, other.bars]),
            np.concatenate([self.keep, other.keep]),
            np.concatenate([self.passed, other.passed]),
        )


@dataclass(frozen=True)
class Neighbours:
    """The pairs that may come too near: of two dogs, one[k] and other[k], or of one and a thing.

    one, other: (K,) indices, other -1 for what stands; normals: (K, 2) unit vectors that lead from
    the other to the one; gaps: (K,) how much farther they are apart than they must be [m]; passed:
    (K,) see `Obstacles`.
    """

    one: _Indices
    other: _Indices
    normals: Array
    gaps: Array
    passed: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        d: Array,
        distance: float,
        obstacles: Obstacles | None = None,
        reach: float = np.inf,
    ) -> Neighbours:
        """Return the neighbours of dogs at d (M, 2) [m] that keep `distance` [m] apart.

        Gaps that are wider than `reach` [m], of two dogs than twice that, are left out.
        """
        # A program's help needs no Numba.
        from herding_ros.model.separation_kernels import neighbours

        there = Obstacles.none() if obstacles is None else obstacles
        d = np.ascontiguousarray(d)  # Numba compiles another kernel for each layout
        return cls(*neighbours(d, distance, there.bars, there.keep, there.passed, reach))


def gain_for(delay: float, control_period: float, braking: float = np.inf) -> float:
    """Return the largest gain [1/s] that is safe for commands that take effect so late [s].

    braking: the part of their speed limit by which dogs can slow down in a unit of time [1/s].
    """
    late = delay + control_period
    s = min(1.0, braking * late)
    return s / (late * math.exp(s))


@dataclass(frozen=True)
class Agility:
    """How dogs respond to commands u (M, 2) [m/s].

    before: (M, 2) their last commands [m/s]; change: by how much one may differ from these [m/s];
    along: (M, 2, 2) matrices that make their positions' velocities of commands; None: these are.
    """

    before: Array
    change: float = np.inf
    along: Array | None = None


def kept_apart(
    near: Neighbours,
    u: Array,
    gain: float,
    max_speed: float,
    margin: float = 0.0,
    part: bool = True,
    agility: Agility | None = None,
) -> Array:
    """Return the commands (M, 2) [m/s] nearest to u that keep dogs from their neighbours.

    Nearest in the sum of squares, but for this: a pair that would only block each other passes
    on the right. Gaps stay wider than the margin [m]. Dogs that are nearer part, at up to gain
    [1/s] times what is missing, all pairs by the same part of it; without `part` they come no
    nearer. No command is faster than max_speed [m/s]. Where nothing has to be changed, u itself is
    returned. Conditions that `agility` rules out are met as far as braking does, all dogs by the
    same part of their speed. Should the search take too long, the dogs slow down together.
    """
    # A program's help needs no Numba.
    from herding_ros.model.separation_kernels import give_way, nearest, rates

    agility = Agility(np.zeros_like(u)) if agility is None else agility
    one, other, along = near.one, near.other, agility.along

    def parting(u: Array) -> Array:
        v = u if along is None else (along @ u[..., None])[..., 0]
        return rates(v, one, other, near.normals)

    sides = np.stack([near.normals, near.normals], axis=1)
    square = np.where(other < 0, 1.0, 2.0)
    if along is not None:
        turns = np.concatenate([along, np.zeros((1, 2, 2))])
        sides = np.stack(
            [np.einsum('kij,ki->kj', turns[k], near.normals) for k in (one, other)], axis=1
        )
        square = np.maximum(np.square(sides).sum(axis=(1, 2)), TINY)
    # Speeds are counted in units of the limit.
    before, change = agility.before / max_speed, agility.change / max_speed
    least = np.minimum(gain / max_speed * (margin - near.gaps), 1.0)
    if not part:
        least = np.minimum(least, 0.0)
    if change < np.inf:
        fastest = float(np.linalg.norm(before, axis=1).max())
        braked = before * max(1.0 - change / max(fastest, TINY), 0.0)
        least = np.minimum(least, parting(braked))
    out = u / max_speed
    if (parting(out) >= least).all():
        return u
    blocked = np.minimum(least, 0.0) - parting(out)
    give_way(out, one, other, near.normals, blocked, near.passed)
    nearest(
        out, one, other, sides, square, least, before, change, _MOST_WORK // len(least),
        _TOLERANCE,
    )  # fmt: skip
    if change == np.inf:
        most, found = np.minimum(least, 0.0), parting(out)
        over = found < most - _MISSED
        out *= float((most[over] / found[over]).min(initial=1.0))
    return out * max_speed
