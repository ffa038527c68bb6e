# SPDX-License-Identifier: Apache-2.0
"""The compiled loops of who fetches whom: the middle of a flock, and ways round a disc."""

from __future__ import annotations

import math

from herding_ros.model.jit import kernel
from herding_ros.model.state import Array
import numpy as np
from numpy.typing import NDArray

_TINY = 1e-12


@kernel
def middle(x: Array, out: Array) -> None:
    """Write the middle (2,) of most sheep at x (N, 2): see `errands`."""
    n = len(x)
    kept: NDArray[np.bool_] = np.ones(n, dtype=np.bool_)
    off = np.empty(n)
    for turn in range(3):
        out[:] = 0.0
        count = 0
        for i in range(n):
            if kept[i]:
                out[0] += x[i, 0]
                out[1] += x[i, 1]
                count += 1
        out /= count
        if turn < 2:
            for i in range(n):
                off[i] = math.hypot(x[i, 0] - out[0], x[i, 1] - out[1])
            kept = off <= np.median(off)


@kernel
def detours(
    start: Array, end: Array, radius: float, length: Array, by_start: Array, by_end: Array
) -> None:
    """Write lengths (P,) and their gradients (P, 2) of the ways from start to end (P, 2).

    See `detour` for what they are.
    """
    for p in range(len(start)):
        sx, sy, ex, ey = start[p, 0], start[p, 1], end[p, 0], end[p, 1]
        a, b = max(math.hypot(sx, sy), _TINY), max(math.hypot(ex, ey), _TINY)
        r = min(radius, a, b)
        cross = sx * ey - sy * ex
        theta = abs(math.atan2(cross, sx * ex + sy * ey))
        arc = theta - math.acos(r / a) - math.acos(r / b)
        if arc <= 0.0:
            way = math.hypot(ex - sx, ey - sy)
            length[p] = way
            hx, hy = (ex - sx) / max(way, _TINY), (ey - sy) / max(way, _TINY)
            by_start[p, 0], by_start[p, 1], by_end[p, 0], by_end[p, 1] = -hx, -hy, hx, hy
            continue
        turn = 1.0 if cross >= 0.0 else -1.0
        # In this form they are 0 at r exactly, also with fused operations.
        from_start = math.sqrt((a - r) * (a + r))
        from_end = math.sqrt((b - r) * (b + r))
        length[p] = from_start + from_end + r * arc
        # A point within the disc is the one on its edge: its distance is the radius.
        out_start = from_start / a + (arc if a <= b and a <= radius else 0.0)
        out_end = from_end / b + (arc if b < a and b <= radius else 0.0)
        across_start, across_end = -turn * r / a, turn * r / b
        by_start[p, 0] = (out_start * sx - across_start * sy) / a
        by_start[p, 1] = (out_start * sy + across_start * sx) / a
        by_end[p, 0] = (out_end * ex - across_end * ey) / b
        by_end[p, 1] = (out_end * ey + across_end * ex) / b
