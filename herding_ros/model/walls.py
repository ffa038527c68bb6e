# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of walls: how they push sheep, and what it costs dogs to be near.

A wall is a bar: a straight line from one end to the other that is `radius` thick to all sides. A
disc is one whose ends are at the same place. Bars come as rows of an array (S, 5): the ends
(x, y, x, y) and the radius [m].
"""

from __future__ import annotations

import math
from typing import Any

from .external_force import register
from .jit import inlined, kernel
from .state import Array


@inlined
def _off(x: float, y: float, bar: Array, reach: float) -> tuple[float, float, float, bool]:
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


def _force(x: float, y: float, values: Any) -> tuple[float, float]:
    """Return the sum of b (1 - r/a)^2 n over all bars with r < a; see `Field`."""
    bars, strength, reach = values
    fx, fy = 0.0, 0.0
    for k in range(bars.shape[0]):
        ox, oy, length, _ = _off(x, y, bars[k], reach)
        part = 1.0 - (length - bars[k, 4]) / reach
        if part > 0.0 and length > 0.0:
            push = strength * part * part / length
            fx += push * ox
            fy += push * oy
    return fx, fy


def _product(x: float, y: float, w_x: float, w_y: float, values: Any) -> tuple[float, float]:
    """Return the Hessian of W, f = -grad W, times w: W'' n n.w + W'/r (w - n n.w).

    Beside a straight piece n does not turn, and the second term is zero.
    """
    bars, strength, reach = values
    px, py = 0.0, 0.0
    for k in range(bars.shape[0]):
        ox, oy, length, straight = _off(x, y, bars[k], reach)
        part = 1.0 - (length - bars[k, 4]) / reach
        if part > 0.0 and length > 0.0:
            across = (ox * w_x + oy * w_y) / (length * length)
            along = 0.0 if straight else -strength * part * part / length
            normal = 2.0 * strength * part / reach
            px += along * w_x + (normal - along) * across * ox
            py += along * w_y + (normal - along) * across * oy
    return px, py


form = register('walls', _force, _product)
"""The form of the force of bars (S, 5) of a strength b [m/s^2] and a range a [m]."""


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
                ox, oy, length, _ = _off(d[k, 0, m], d[k, 1, m], bars[s], distance)
                part = 1.0 - (length - bars[s, 4]) / distance
                if part > 0.0 and length > 0.0:
                    total += part * part
                    slope = -2.0 * scale * part / (distance * length)
                    derivative[k, 0, m] += slope * ox
                    derivative[k, 1, m] += slope * oy
    return scale * total
