# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of walls: how they push sheep, and what it costs dogs to be near.

A wall is a bar: a straight line from one end to the other that is `radius` thick to all sides. A
disc is one whose ends are at the same place. Bars come as rows of an array (S, 5): the ends
(x, y, x, y) and the radius [m].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .external_force import register
from .external_form import Form
from .jit import inlined, kernel
from .state import Array

_MOST_CELLS = 256
"""No more cells to a side of the grid."""


@inlined
def off(x: float, y: float, bar: Array, reach: float) -> tuple[float, float, float, bool]:
    """Return how a point is off a bar's line (2), and its length; whether it is beside an end.

    Of a bar that is farther than reach [m] in x or y the length is infinite.
    """
    ax, ay, bx, by = bar[0], bar[1], bar[2], bar[3]
    far = reach + bar[4]
    if (
        (x < ax - far and x < bx - far)
        or (x > ax + far and x > bx + far)
        or (y < ay - far and y < by - far)
        or (y > ay + far and y > by + far)
    ):
        return 0.0, 0.0, math.inf, False
    ex, ey = bx - ax, by - ay
    square = ex * ex + ey * ey
    along = ((x - ax) * ex + (y - ay) * ey) / square if square > 0.0 else 0.0
    inner = min(max(along, 0.0), 1.0)
    ox, oy = x - ax - inner * ex, y - ay - inner * ey
    return ox, oy, math.sqrt(ox * ox + oy * oy), inner == along and square > 0.0


class _Near(NamedTuple):
    """Which bars are near to a place, by cells of a grid: a step costs the same with many bars.

    low: a corner of the grid; per: cells in a metre; shape: of the grid; first: where the bars of
    each cell begin in `bars`, one cell after the other; bars: their numbers.
    """

    low: tuple[float, float]
    per: float
    shape: tuple[int, int]
    first: NDArray[np.intp]
    bars: NDArray[np.intp]


def _near(bars: Array, reach: float) -> _Near:
    """Return the bars that are nearer than reach [m] to some place of each cell."""
    ends = np.concatenate([bars[:, :2], bars[:, 2:4]])
    margin = reach + bars[:, 4].max()
    low, high = ends.min(axis=0) - margin, ends.max(axis=0) + margin
    cell = max(reach, float((high - low).max()) / _MOST_CELLS)
    shape = tuple(np.ceil((high - low) / cell).astype(int))
    middles = [low[c] + cell * (np.arange(shape[c]) + 0.5) for c in range(2)]
    x, y = (each[..., None] for each in np.meshgrid(*middles, indexing='ij'))
    ax, ay, bx, by, radius = bars.T
    ex, ey = bx - ax, by - ay
    square = ex * ex + ey * ey
    along = ((x - ax) * ex + (y - ay) * ey) / np.where(square, square, 1.0)
    inner = np.clip(along, 0.0, 1.0)
    length = np.hypot(x - ax - inner * ex, y - ay - inner * ey)
    # Half a cell's diagonal, and a hair.
    found = (length - radius < reach + 0.7072 * cell).reshape(-1, len(bars))
    first = np.concatenate([[0], np.cumsum(found.sum(axis=1))]).astype(np.intp)
    numbers = np.nonzero(found)[1].astype(np.intp)
    return _Near((low[0], low[1]), 1.0 / cell, (int(shape[0]), int(shape[1])), first, numbers)


@inlined
def _range_near(x: float, y: float, near: _Near) -> tuple[int, int]:
    """Return where the bars that are near to a place begin and end in near.bars."""
    i = math.floor((x - near.low[0]) * near.per)
    j = math.floor((y - near.low[1]) * near.per)
    if i < 0 or j < 0 or i >= near.shape[0] or j >= near.shape[1]:
        return 0, 0
    cell = int(i) * near.shape[1] + int(j)
    return near.first[cell], near.first[cell + 1]


def _force(x: float, y: float, values: Any) -> tuple[float, float]:
    """Return the sum of b (1 - r/a)^2 n over all bars with r < a; see `Field`."""
    bars, near, strength, reach = values
    fx, fy = 0.0, 0.0
    first, last = _range_near(x, y, near)
    for k in range(first, last):
        bar = bars[near.bars[k]]
        ox, oy, length, _ = off(x, y, bar, reach)
        part = 1.0 - (length - bar[4]) / reach
        if part > 0.0 and length > 0.0:
            push = strength * part * part / length
            fx += push * ox
            fy += push * oy
    return fx, fy


def _product(x: float, y: float, w_x: float, w_y: float, values: Any) -> tuple[float, float]:
    """Return the Hessian of W, f = -grad W, times w: W'' n n.w + W'/r (w - n n.w).

    Beside a straight piece n does not turn, and the second term is zero.
    """
    bars, near, strength, reach = values
    px, py = 0.0, 0.0
    first, last = _range_near(x, y, near)
    for k in range(first, last):
        bar = bars[near.bars[k]]
        ox, oy, length, straight = off(x, y, bar, reach)
        part = 1.0 - (length - bar[4]) / reach
        if part > 0.0 and length > 0.0:
            across = (ox * w_x + oy * w_y) / (length * length)
            along = 0.0 if straight else -strength * part * part / length
            normal = 2.0 * strength * part / reach
            px += along * w_x + (normal - along) * across * ox
            py += along * w_y + (normal - along) * across * oy
    return px, py


_form = register('walls', _force, _product)


def form(bars: Array, strength: float, reach: float) -> Form:
    """Return the force of bars (S, 5) of a strength b [m/s^2] and a range a [m]."""
    return _form(bars, _near(bars, reach), strength, reach)


@kernel
def gaps(points: Array, bars: Array) -> Array:
    """Return how far points (n, 2) [m] are from the nearest of bars (S, 5), S >= 1 [m]."""
    out = np.full(len(points), np.inf)
    for i in range(len(points)):
        for s in range(len(bars)):
            _, _, length, _ = off(points[i, 0], points[i, 1], bars[s], out[i])
            out[i] = min(out[i], length - bars[s, 4])
    return out


@kernel
def nearness(d: Array, bars: Array, distance: float, scale: float, derivative: Array) -> float:
    """Return scale times the sum over dogs at d[1:, :2, M] and bars of max(1 - r/a, 0)^2.

    r is the distance [m] of a dog from a bar and a = distance [m]. The derivative by d is added
    to derivative[K+1, S, M].
    """
    total = 0.0
    for k in range(1, d.shape[0]):
        for m in range(d.shape[2]):
            for s in range(bars.shape[0]):
                ox, oy, length, _ = off(d[k, 0, m], d[k, 1, m], bars[s], distance)
                part = 1.0 - (length - bars[s, 4]) / distance
                if part > 0.0 and length > 0.0:
                    total += part * part
                    slope = -2.0 * scale * part / (distance * length)
                    derivative[k, 0, m] += slope * ox
                    derivative[k, 1, m] += slope * oy
    return scale * total
