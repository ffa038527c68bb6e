# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of dogs that keep apart: the nearest point of convex sets, and a cost."""

from __future__ import annotations

from herding_ros.model.jit import kernel
from herding_ros.model.state import Array
import numpy as np
from numpy.typing import NDArray

_PARTING = 10.0
"""How much it costs not to part at the full rate: this times the part that is missing, squared."""


@kernel
def nearest(
    u: Array,
    one: NDArray[np.intp],
    other: NDArray[np.intp],
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
