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
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array
import numpy as np
from numpy.typing import NDArray

_AROUND = 0.2
"""A pair that blocks each other slips sideways by this part of the speed that is taken from it."""

_TOLERANCE = 1e-8
"""Commands are the nearest ones to this part of the speed limit."""

_MISSED = 1e-6
"""Conditions that are missed by this part of the limit: the next command makes up for it."""

_MOST_WORK = 2_000_000
"""Conditions that are looked at for one command, some 20 ms, before a simpler answer is given."""

_Indices = NDArray[np.intp]


@dataclass(frozen=True)
class HalfPlanes:
    """Places that dogs must not enter: dog dogs[k] keeps its gap[k] along normal[k].

    dogs: (K,) indices; normals: (K, 2) unit vectors that lead away from what is kept free;
    gaps: (K,) how far the dog may still go against its normal [m], negative where it is too far;
    round: whether a dog that runs right against it passes on the right, as it does another dog.
    """

    dogs: _Indices
    normals: Array
    gaps: Array
    round: bool | NDArray[np.bool_] = False

    @classmethod
    def none(cls) -> HalfPlanes:
        """Return no half-plane."""
        return cls(np.zeros(0, dtype=np.intp), np.zeros((0, 2)), np.zeros(0))

    @classmethod
    def around(cls, points: Array, d: Array, distance: float, reach: float = np.inf) -> HalfPlanes:
        """Keep dogs at d (M, 2) so far [m] from points (n, 2) that do not give way.

        Points that are farther than `reach` [m] beyond this distance are left out.
        """
        apart = d[:, None] - points[None]
        length = np.linalg.norm(apart, axis=2)
        dogs, others = np.nonzero((length > TINY) & (length < distance + reach))
        length = length[dogs, others]
        return cls(dogs, apart[dogs, others] / length[:, None], length - distance, True)

    def and_also(self, other: HalfPlanes) -> HalfPlanes:
        """Return these and others."""
        return HalfPlanes(
            np.concatenate([self.dogs, other.dogs]),
            np.concatenate([self.normals, other.normals]),
            np.concatenate([self.gaps, other.gaps]),
            np.concatenate(
                [np.broadcast_to(each.round, len(each.gaps)) for each in (self, other)]
            ),
        )


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
    d: Array,
    u: Array,
    distance: float,
    gain: float,
    max_speed: float,
    planes: HalfPlanes | None = None,
    part: bool = True,
    agility: Agility | None = None,
) -> Array:
    """Return the commands (M, 2) [m/s] nearest to u that keep dogs at d (M, 2) [m] apart.

    Nearest in the sum of squares, but for this: a pair that would only block each other passes
    on the right. Dogs that are nearer than `distance` [m] part, at up to gain [1/s] times what is
    missing; without `part` they come no nearer. No command is faster than max_speed [m/s]. Where
    nothing has to be changed, u itself is returned. Conditions that `agility` rules out are met as
    far as braking does, all dogs by the same part of their speed.
    """
    planes = HalfPlanes.none() if planes is None else planes
    # Speeds are counted in units of the limit.
    agility = Agility(np.zeros_like(u)) if agility is None else agility
    conditions = _Conditions.of(d, distance, gain / max_speed, planes)
    conditions = replace(
        conditions,
        before=agility.before / max_speed,
        change=agility.change / max_speed,
        along=agility.along,
    )
    if not part:
        conditions = replace(conditions, least=np.minimum(conditions.least, 0.0))
    if agility.change < np.inf:
        conditions = replace(
            conditions, least=np.minimum(conditions.least, conditions.rates(conditions.braked()))
        )
    asked = u / max_speed
    if conditions.hold(asked):
        return u
    return conditions.nearest(conditions.with_right_of_way(asked)) * max_speed


@dataclass(frozen=True)
class _Conditions:
    """normal . (u_one - u_other) >= least, with u_other = 0 where other is -1.

    round: of what can be passed on the right; before, change, along: see `Agility`. Speeds are in
    units of the limit. Conditions that hold for any two speeds are left out.
    """

    one: _Indices
    other: _Indices
    normal: Array
    least: Array
    round: NDArray[np.bool_]
    before: Array | None = None
    change: float = np.inf
    along: Array | None = None

    @classmethod
    def of(cls, d: Array, distance: float, gain: float, planes: HalfPlanes) -> _Conditions:
        one, other = np.triu_indices(len(d), k=1)
        apart = d[one] - d[other]
        length = np.linalg.norm(apart, axis=1)
        # Dogs at one place part as if they stood on a circle.
        angle = 2.0 * np.pi / len(d) * np.arange(len(d))
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        apart = np.where(length[:, None] > TINY, apart, circle[one] - circle[other])
        near = gain * (length - distance) < 2.0
        by = gain * planes.gaps < 1.0
        apart = apart[near]
        return cls(
            np.concatenate([one[near], planes.dogs[by]]),
            np.concatenate([other[near], np.full(int(by.sum()), -1)]),
            np.concatenate([apart / np.linalg.norm(apart, axis=1)[:, None], planes.normals[by]]),
            np.minimum(gain * np.concatenate([distance - length[near], -planes.gaps[by]]), 1.0),
            np.concatenate(
                [np.full(len(apart), True), np.broadcast_to(planes.round, len(by))[by]]
            ),
        )

    def rates(self, u: Array) -> Array:
        """Return the left-hand sides."""
        if self.along is not None:
            u = (self.along @ u[..., None])[..., 0]
        moves = np.vstack([u, np.zeros(2)])  # what stands is the last one
        relative = moves[self.one] - moves[self.other]
        return (self.normal * relative).sum(axis=1)

    def braked(self) -> Array:
        """Return the last commands, all slowed down by the same part, as far as can be."""
        assert self.before is not None
        fastest = float(np.linalg.norm(self.before, axis=1).max())
        return self.before * max(1.0 - self.change / max(fastest, TINY), 0.0)

    def hold(self, u: Array) -> bool:
        return bool((self.rates(u) >= self.least).all())

    def with_right_of_way(self, u: Array) -> Array:
        """Return u with something sideways for pairs that would else push against each other.

        Without it two dogs that want to change places would stand for ever. Seen from each, both
        turn to the right.
        """
        blocked = np.minimum(self.least, 0.0) - self.rates(u)
        here = self.round & (blocked > 0.0)
        one, other, blocked = self.one[here], self.other[here], _AROUND * blocked[here]
        sideways = self.normal[here] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
        moves = np.vstack([u, np.zeros(2)])  # what stands is the last one
        slip = (sideways * (moves[one] - moves[other])).sum(axis=1)
        more = np.where(np.abs(slip) < blocked, blocked - slip, 0.0)[:, None] * sideways
        np.add.at(moves, one, np.where(other[:, None] < 0, more, 0.5 * more))
        np.add.at(moves, other, -0.5 * more)
        return moves[:-1]

    def nearest(self, u: Array) -> Array:
        """Return the speeds (M, 2) nearest to u, at most 1, for which the conditions hold.

        Where dogs are too near already they part as far as they can, all pairs by the same part
        of `least`. Should the search take too long, the dogs slow down together.
        """
        # A program's help needs no Numba.
        from herding_ros.model.separation_kernels import nearest

        assert self.before is not None
        out = np.array(u, dtype=np.float64, order='C')
        sides = np.stack([self.normal, self.normal], axis=1)
        square = np.where(self.other < 0, 1.0, 2.0)
        if self.along is not None:
            turns = np.concatenate([self.along, np.zeros((1, 2, 2))])
            sides = np.stack(
                [np.einsum('kij,ki->kj', turns[k], self.normal) for k in (self.one, self.other)],
                axis=1,
            )
            square = np.maximum(np.square(sides).sum(axis=(1, 2)), TINY)
        sweeps = _MOST_WORK // len(self.least)
        nearest(
            out, self.one, self.other, sides, square, self.least, self.before, self.change, sweeps,
            _TOLERANCE,
        )  # fmt: skip
        if self.change < np.inf:
            return out
        most = np.minimum(self.least, 0.0)
        rates = self.rates(out)
        over = rates < most - _MISSED
        return out * float((most[over] / rates[over]).min(initial=1.0))
