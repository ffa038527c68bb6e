# SPDX-License-Identifier: Apache-2.0
"""The compiled loops over near pairs of a large flock: sort, gradients, Hessian products.

They call no other kernels, and so can have a file of their own (see `kernels`). Sheep are
sorted by cell: strips of the height of the reach, cut into narrow columns, so that all sheep of
a strip between two columns lie side by side in memory. Arrays of sorted sheep have CHUNK unused
entries at the end: loops over neighbours run in whole chunks, with a mask for the rest. Indices
are unsigned: one that may be negative stops vectorisation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .jit import inlined, kernel
from .state import Array

Indices = NDArray[np.int64]

CHUNK = 8
"""Number of neighbours that are processed at a time."""

Near = tuple[float, ...]
"""16 coefficients c_k of the near part: P'(r) = sum_k c_k r^k up to the reach, 0 beyond it."""


class Cells(NamedTuple):
    """Cells of a box: `rows` strips of height `height`, each with `columns` columns.

    The box begins at (x0, y0) [m].
    """

    x0: float
    y0: float
    width: float
    height: float
    columns: int
    rows: int


@kernel
def sort(x: Array, n: int, cells: Cells, order: Indices, start: Indices) -> bool:
    """Sort n sheep at x[2, :] by cell; return whether all are in the box.

    order[n] receives the indices of the sheep, start[rows * columns + 1] where each cell begins.
    """
    cell = np.empty(n, dtype=np.int64)
    start[:] = 0
    for i in range(n):
        column = math.floor((x[0, i] - cells.x0) / cells.width)
        row = math.floor((x[1, i] - cells.y0) / cells.height)
        if not (0 <= column < cells.columns and 0 <= row < cells.rows):
            return False
        cell[i] = row * cells.columns + column
        start[cell[i] + 1] += 1
    for c in range(start.shape[0] - 1):
        start[c + 1] += start[c]
    place = start.copy()
    for i in range(n):
        order[place[cell[i]]] = i
        place[cell[i]] += 1
    return True


@kernel
def put(values: Array, order: Indices, out: Array) -> None:
    """Put values[2, :n] in out[2, order]."""
    for c in range(2):
        for i in range(order.shape[0]):
            out[c, order[i]] = values[c, i]


@kernel
def take(values: Array, order: Indices, out: Array) -> None:
    """Put values[2, order] in out[2, :n]."""
    for c in range(2):
        for i in range(order.shape[0]):
            out[c, i] = values[c, order[i]]


@inlined
def _even_and_odd(r2: float, c: Near) -> tuple[float, float]:
    """Return e, o with e(r^2) + r o(r^2) = sum_k c_k r^k (Estrin's scheme)."""
    r4 = r2 * r2
    e = (c[14] * r2 + c[12]) * r4 + (c[10] * r2 + c[8])
    e = (e * r4 + (c[6] * r2 + c[4])) * r4 + (c[2] * r2 + c[0])
    o = (c[15] * r2 + c[13]) * r4 + (c[11] * r2 + c[9])
    o = (o * r4 + (c[7] * r2 + c[5])) * r4 + (c[3] * r2 + c[1])
    return e, o


@inlined
def _gradient_of_chunks(
    x: Array, y: Array, bx: Array, by: Array, xi: float, yi: float, begin: int, end: int,
    shift: int, reach2: float, near: Near,
) -> tuple[float, float]:  # fmt: skip
    """Return the gradient at a sheep due to those from begin to end; subtract reactions from b."""
    ax = 0.0
    ay = 0.0
    first, there = np.uint64(begin), np.uint64(begin - shift)
    count = np.uint64(max(end - begin, 0))
    chunks = np.uint64(-(-max(end - begin, 0) // CHUNK) * CHUNK)
    for j in range(chunks):
        sx = xi - x[first + j]
        sy = yi - y[first + j]
        r2 = sx * sx + sy * sy
        e, o = _even_and_odd(r2, near)
        a = e * (math.sqrt(r2) / r2) + o
        a = a if 0.0 < r2 < reach2 else 0.0
        a = a if j < count else 0.0
        ax += a * sx
        ay += a * sy
        bx[there + j] -= a * sx
        by[there + j] -= a * sy
    return ax, ay


@inlined
def _neighbours(
    xi: float, yi: float, row: int, reach: float, cells: Cells, start: Indices
) -> tuple[int, int, int]:
    """Return the end of the neighbours in a sheep's own strip; begin and end in the next."""
    column = min(int((xi + reach - cells.x0) / cells.width), cells.columns - 1)
    own_end = start[row * cells.columns + column + 1]
    if row + 1 == cells.rows:
        return own_end, 0, 0
    up = cells.y0 + cells.height * (row + 1) - yi
    half = math.sqrt(max(reach * reach - up * up, 0.0))
    column = max(int((xi - half - cells.x0) / cells.width), 0)
    begin = start[(row + 1) * cells.columns + column]
    column = min(int((xi + half - cells.x0) / cells.width), cells.columns - 1)
    end = start[(row + 1) * cells.columns + column + 1]
    return own_end, begin, end


@kernel
def near_gradients(
    x: Array, y: Array, cells: Cells, start: Indices, rows: tuple[int, int], reach: float,
    near: Near, ax: Array, ay: Array,
) -> None:  # fmt: skip
    """Add the near gradients between sheep of some rows, and between those and the next row.

    ax, ay hold the sheep from the first row to the row after the last, and CHUNK unused entries.
    Each pair is evaluated once.
    """
    shift = start[rows[0] * cells.columns]
    for row in range(rows[0], rows[1]):
        for i in range(start[row * cells.columns], start[(row + 1) * cells.columns]):
            own_end, begin, end = _neighbours(x[i], y[i], row, reach, cells, start)
            fx, fy = _gradient_of_chunks(
                x, y, ax, ay, x[i], y[i], i + 1, own_end, shift, reach * reach, near
            )
            gx, gy = _gradient_of_chunks(
                x, y, ax, ay, x[i], y[i], begin, end, shift, reach * reach, near
            )
            ax[i - shift] += fx + gx
            ay[i - shift] += fy + gy


@inlined
def _hessians_of_chunks(
    x: Array, y: Array, mu_x: Array, mu_y: Array, bx: Array, by: Array, i: int, begin: int,
    end: int, shift: int, reach2: float, near: Near,
) -> tuple[float, float]:  # fmt: skip
    """The same as `_gradient_of_chunks` for Hessians times (mu_i - mu_j)."""
    hx = 0.0
    hy = 0.0
    first, there = np.uint64(begin), np.uint64(begin - shift)
    count = np.uint64(max(end - begin, 0))
    chunks = np.uint64(-(-max(end - begin, 0) // CHUNK) * CHUNK)
    for j in range(chunks):
        sx = x[i] - x[first + j]
        sy = y[i] - y[first + j]
        wx = mu_x[i] - mu_x[first + j]
        wy = mu_y[i] - mu_y[first + j]
        r2 = sx * sx + sy * sy
        a, b = _near_hessian(r2, near)
        a = a if 0.0 < r2 < reach2 else 0.0
        b = b if 0.0 < r2 < reach2 else 0.0
        a = a if j < count else 0.0
        b = b if j < count else 0.0
        b *= sx * wx + sy * wy
        hx += a * wx + b * sx
        hy += a * wy + b * sy
        bx[there + j] -= a * wx + b * sx
        by[there + j] -= a * wy + b * sy
    return hx, hy


@inlined
def _near_hessian(r2: float, near: Near) -> tuple[float, float]:
    """Return a, b with a w + b (s.w) s = Hessian times w, as `kernels.hessian` does."""
    slope, curvature = 0.0, 0.0
    r = math.sqrt(r2)
    for k in range(len(near) - 1, -1, -1):
        curvature = curvature * r + slope
        slope = slope * r + near[k]
    a = slope / r
    return a, (curvature - a) / r2


@kernel
def near_hessians(
    x: Array, y: Array, mu_x: Array, mu_y: Array, cells: Cells, start: Indices,
    rows: tuple[int, int], reach: float, near: Near, hx: Array, hy: Array,
) -> None:  # fmt: skip
    """The same as `near_gradients` for Hessians times (mu_i - mu_j)."""
    shift = start[rows[0] * cells.columns]
    for row in range(rows[0], rows[1]):
        for i in range(start[row * cells.columns], start[(row + 1) * cells.columns]):
            own_end, begin, end = _neighbours(x[i], y[i], row, reach, cells, start)
            fx, fy = _hessians_of_chunks(
                x, y, mu_x, mu_y, hx, hy, i, i + 1, own_end, shift, reach * reach, near
            )
            gx, gy = _hessians_of_chunks(
                x, y, mu_x, mu_y, hx, hy, i, begin, end, shift, reach * reach, near
            )
            hx[i - shift] += fx + gx
            hy[i - shift] += fy + gy
