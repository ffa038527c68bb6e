# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of dogs that keep apart: the nearest point of convex sets, and a cost."""

from __future__ import annotations

from herding_ros.model.jit import kernel
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array
from herding_ros.model.walls import off
import numpy as np
from numpy.typing import NDArray

_Indices = NDArray[np.intp]
_Flags = NDArray[np.bool_]

_PARTING = 10.0
"""How much it costs not to part at the full rate: this times the part that is missing, squared."""

_AROUND = 0.2
"""A pair that blocks each other slips sideways by this part of the speed that is taken from it."""


@kernel
def neighbours(
    d: Array, distance: float, bars: Array, keep: Array, passed: _Flags, reach: float
) -> tuple[_Indices, _Indices, Array, Array, _Flags]:
    """Return the fields of `control.separation.Neighbours`: pairs of dogs at d[M, 2], then bars.

    Dogs at one place part as if they stood on a circle; a dog that is right on a bar has no
    direction to leave it in, and the bar is left out.
    """
    dogs = len(d)
    most = dogs * (dogs - 1) // 2 + dogs * len(bars)
    one, other = np.empty(most, dtype=np.intp), np.empty(most, dtype=np.intp)
    normals, gaps = np.empty((most, 2)), np.empty(most)
    passes = np.empty(most, dtype=np.bool_)
    n = 0
    for i in range(dogs):
        for j in range(i + 1, dogs):
            x, y = d[i, 0] - d[j, 0], d[i, 1] - d[j, 1]
            gap = np.sqrt(x * x + y * y) - distance
            if gap >= 2.0 * reach:
                continue
            if gap + distance <= TINY:
                a, b = 2.0 * np.pi * i / dogs, 2.0 * np.pi * j / dogs
                x, y = np.cos(a) - np.cos(b), np.sin(a) - np.sin(b)
            length = np.sqrt(x * x + y * y)
            one[n], other[n], gaps[n], passes[n] = i, j, gap, True
            normals[n, 0], normals[n, 1] = x / length, y / length
            n += 1
    for i in range(dogs):
        for s in range(len(bars)):
            x, y, length, _ = off(d[i, 0], d[i, 1], bars[s], keep[s] + reach)
            gap = length - bars[s, 4] - keep[s]
            if gap < reach and length > TINY:
                one[n], other[n], gaps[n], passes[n] = i, -1, gap, passed[s]
                normals[n, 0], normals[n, 1] = x / length, y / length
                n += 1
    return one[:n], other[:n], normals[:n], gaps[:n], passes[:n]


@kernel
def rates(v: Array, one: _Indices, other: _Indices, normals: Array) -> Array:
    """Return how fast each pair parts, normals[k] . (v[one[k]] - v[other[k]]), v[-1] being 0."""
    out = np.empty(len(one))
    for k in range(len(one)):
        x, y = v[one[k], 0], v[one[k], 1]
        if other[k] >= 0:
            x, y = x - v[other[k], 0], y - v[other[k], 1]
        out[k] = normals[k, 0] * x + normals[k, 1] * y
    return out


@kernel
def give_way(
    u: Array, one: _Indices, other: _Indices, normals: Array, blocked: Array, passed: _Flags
) -> None:
    """Add to u[M, 2] something sideways for pairs that would else push against each other.

    blocked[K]: the part of each pair's speed that is taken from it, if positive. Without this two
    dogs that want to change places would stand for ever. Seen from each, both turn to the right.
    """
    asked = u.copy()
    for k in range(len(one)):
        if not (passed[k] and blocked[k] > 0.0):
            continue
        i, j = one[k], other[k]
        x, y = asked[i, 0], asked[i, 1]
        if j >= 0:
            x, y = x - asked[j, 0], y - asked[j, 1]
        slip = -normals[k, 1] * x + normals[k, 0] * y
        if abs(slip) >= _AROUND * blocked[k]:
            continue
        more = _AROUND * blocked[k] - slip
        if j >= 0:
            more *= 0.5
            u[j, 0] += more * normals[k, 1]
            u[j, 1] -= more * normals[k, 0]
        u[i, 0] -= more * normals[k, 1]
        u[i, 1] += more * normals[k, 0]


@kernel
def nearest(
    u: Array,
    one: _Indices,
    other: _Indices,
    normal: Array,
    square: Array,
    least: Array,
    before: Array,
    most: float,
    sweeps: int,
    tolerance: float,
) -> int:
    """Move u[M, 2] to the nearest point that fulfils all conditions; return the sweeps it took.

    Conditions: normal[k, 0] . u[one[k]] - normal[k, 1] . u[other[k]] >= least[k], u[-1] being 0,
    |u| <= 1, and |u - before| <= most. square[k] is |normal[k]|^2. Where least is positive, of
    that the part 1 - slack / _PARTING, with slack >= 0 as small as possible, one for all pairs and
    one for each dog's other conditions. By Dykstra's alternating projections (Boyle and Dykstra
    1986), for half-planes Hildreth's method, until a sweep moves none by more than the tolerance.
    """
    pull = np.zeros(len(least))
    excess, drag = np.zeros_like(u), np.zeros_like(u)
    slack, slack_pull = np.zeros(len(u) + 1), np.zeros(len(u) + 1)
    for sweep in range(sweeps):
        largest = 0.0
        for k in range(len(least)):
            i, j = one[k], other[k]
            rate = normal[k, 0, 0] * u[i, 0] + normal[k, 0, 1] * u[i, 1]
            own = i
            if j >= 0:
                rate -= normal[k, 1, 0] * u[j, 0] + normal[k, 1, 1] * u[j, 1]
                own = len(u)
            give = max(least[k], 0.0) / _PARTING
            change = (least[k] - rate - give * slack[own]) / (square[k] + give * give)
            change = max(change, -pull[k])
            pull[k] += change
            for c in range(2):
                u[i, c] += change * normal[k, 0, c]
                if j >= 0:
                    u[j, c] -= change * normal[k, 1, c]
            slack[own] += change * give
            largest = max(largest, abs(change))
        for i in range(len(slack)):
            change = max(-slack[i], -slack_pull[i])
            slack_pull[i] += change
            slack[i] += change
        for i in range(len(u)):
            x, y = u[i, 0] + excess[i, 0], u[i, 1] + excess[i, 1]
            speed = max(np.sqrt(x * x + y * y), 1.0)
            largest = max(largest, abs(x / speed - u[i, 0]), abs(y / speed - u[i, 1]))
            u[i, 0], u[i, 1] = x / speed, y / speed
            excess[i, 0], excess[i, 1] = x - u[i, 0], y - u[i, 1]
        for i in range(len(u) if most < np.inf else 0):
            x, y = u[i, 0] + drag[i, 0] - before[i, 0], u[i, 1] + drag[i, 1] - before[i, 1]
            factor = most / max(np.sqrt(x * x + y * y), most)
            to_x, to_y = before[i, 0] + factor * x, before[i, 1] + factor * y
            largest = max(largest, abs(to_x - u[i, 0]), abs(to_y - u[i, 1]))
            drag[i, 0], drag[i, 1] = (1.0 - factor) * x, (1.0 - factor) * y
            u[i, 0], u[i, 1] = to_x, to_y
        if largest < tolerance:
            return sweep + 1
    return sweeps


@kernel
def spacing(d: Array, square: float, scale: float, derivative: Array) -> float:
    """Return scale times the sum over pairs at d[1:, :2, M] of max(1 - r^2 / square, 0)^2.

    Its derivative by d is added to derivative[K+1, S, M].
    """
    total = 0.0
    for k in range(1, len(d)):
        for i in range(d.shape[2]):
            for j in range(i):
                x, y = d[k, 0, i] - d[k, 0, j], d[k, 1, i] - d[k, 1, j]
                near = square - x * x - y * y
                if near > 0.0:
                    near /= square
                    total += near * near
                    slope = 4.0 * scale * near / square
                    derivative[k, 0, i] -= slope * x
                    derivative[k, 1, i] -= slope * y
                    derivative[k, 0, j] += slope * x
                    derivative[k, 1, j] += slope * y
    return scale * total
