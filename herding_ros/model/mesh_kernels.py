"""The compiled inner loops of the particle mesh: sort, near pairs, spread and gather.

They call nothing of `kernels`, so they may stand in a file of their own. Sheep are sorted by
cell: strips of height `reach`, cut into narrow columns, so that all sheep of a strip between two
columns lie side by side in memory. Arrays of sorted sheep have CHUNK unused entries at the end.
Loops over neighbours run in whole chunks, with a mask for the rest. Indices are unsigned: one
that may be negative stops vectorisation.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numba import njit
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from .state import Array

Indices = NDArray[np.int64]

CHUNK = 8
"""Neighbours are visited so many at a time."""

ORDER = 8
"""Sheep are spread over so many mesh points in each direction, by a B-spline of this order."""

_OPTIONS: dict[str, Any] = {'cache': True, 'nogil': True, 'error_model': 'numpy'}
_FAST: dict[str, Any] = {'fastmath': {'reassoc', 'contract', 'nsz'}}
_kernel = njit(**_OPTIONS, **_FAST)
_inlined = njit(**_OPTIONS, **_FAST, forceinline=True)


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


Near = tuple[float, ...]
"""16 coefficients c_k: the near force's P'(r) = sum_k c_k r^k up to the reach, then zero."""


@_kernel
def sort(x: Array, n: int, cells: Cells, order: Indices, start: Indices) -> bool:
    """Sort n sheep at x[2, :] by cell; return whether all are in the box.

    order[n] gets the numbers of the sheep, start[rows * columns + 1] where each cell begins.
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


@_kernel
def put(values: Array, order: Indices, out: Array) -> None:
    """Put values[2, :n] in out[2, order]."""
    for c in range(2):
        for i in range(order.shape[0]):
            out[c, order[i]] = values[c, i]


@_kernel
def take(values: Array, order: Indices, out: Array) -> None:
    """Put values[2, order] in out[2, :n]."""
    for c in range(2):
        for i in range(order.shape[0]):
            out[c, i] = values[c, order[i]]


@_inlined
def _even_and_odd(r2: float, c: Near) -> tuple[float, float]:
    """Return e, o with e(r^2) + r o(r^2) = sum_k c_k r^k (Estrin's scheme)."""
    r4 = r2 * r2
    e = (c[14] * r2 + c[12]) * r4 + (c[10] * r2 + c[8])
    e = (e * r4 + (c[6] * r2 + c[4])) * r4 + (c[2] * r2 + c[0])
    o = (c[15] * r2 + c[13]) * r4 + (c[11] * r2 + c[9])
    o = (o * r4 + (c[7] * r2 + c[5])) * r4 + (c[3] * r2 + c[1])
    return e, o


@_inlined
def _gradient_of_chunks(
    x: Array, y: Array, bx: Array, by: Array, xi: float, yi: float, begin: int, end: int,
    shift: int, reach2: float, near: Near,
) -> tuple[float, float]:  # fmt: skip
    """Return the gradient at one sheep from those of begin to end; subtract theirs from b."""
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


@_inlined
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


@_kernel
def near_gradients(
    x: Array, y: Array, cells: Cells, start: Indices, rows: tuple[int, int], reach: float,
    near: Near, ax: Array, ay: Array,
) -> None:  # fmt: skip
    """Add the near gradients between sheep of some rows, and between those and the next row.

    ax, ay begin with the first sheep of the first row and end with the last one of the row
    after the last, and CHUNK more. Each pair is looked at once.
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


def _spline_pieces() -> tuple[tuple[float, ...], ...]:
    """Return the cardinal B-spline's polynomial on each of its ORDER intervals, from the left.

    Powers ascend. Seen from a point at u beyond a mesh point, piece ORDER - 1 - q is the weight
    of the q-th mesh point from there.
    """
    spline = BSpline.basis_element(np.arange(ORDER + 1.0))
    return tuple(
        tuple(float(spline(left, power)) / math.factorial(power) for power in range(ORDER))
        for left in range(ORDER)
    )


_PIECES = _spline_pieces()[::-1]

Weights = tuple[float, float, float, float, float, float, float, float]


@_inlined
def _value(u: float, c: Weights) -> float:
    e = ((c[7] * u + c[6]) * u + c[5]) * u + c[4]
    return (((e * u + c[3]) * u + c[2]) * u + c[1]) * u + c[0]


@_inlined
def _slope(u: float, c: Weights) -> float:
    e = ((7.0 * c[7] * u + 6.0 * c[6]) * u + 5.0 * c[5]) * u + 4.0 * c[4]
    return ((e * u + 3.0 * c[3]) * u + 2.0 * c[2]) * u + c[1]


@_inlined
def _curvature(u: float, c: Weights) -> float:
    e = ((42.0 * c[7] * u + 30.0 * c[6]) * u + 20.0 * c[5]) * u + 12.0 * c[4]
    return (e * u + 6.0 * c[3]) * u + 2.0 * c[2]


@_inlined
def _all(of_piece: Any, u: float) -> Weights:
    """Return a function of all pieces at u: the weights of ORDER mesh points, or derivatives."""
    return (
        of_piece(u, _PIECES[0]),
        of_piece(u, _PIECES[1]),
        of_piece(u, _PIECES[2]),
        of_piece(u, _PIECES[3]),
        of_piece(u, _PIECES[4]),
        of_piece(u, _PIECES[5]),
        of_piece(u, _PIECES[6]),
        of_piece(u, _PIECES[7]),
    )


@_inlined
def _add_row(mesh: Array, at: int, factor: float, w: Weights) -> None:
    mesh[at] += factor * w[0]
    mesh[at + np.uint64(1)] += factor * w[1]
    mesh[at + np.uint64(2)] += factor * w[2]
    mesh[at + np.uint64(3)] += factor * w[3]
    mesh[at + np.uint64(4)] += factor * w[4]
    mesh[at + np.uint64(5)] += factor * w[5]
    mesh[at + np.uint64(6)] += factor * w[6]
    mesh[at + np.uint64(7)] += factor * w[7]


@_inlined
def _add_outer(mesh: Array, at: int, stride: int, factor: float, wy: Weights, wx: Weights) -> None:
    """Add factor wy wx^T to the mesh points from `at` on."""
    _add_row(mesh, at, factor * wy[0], wx)
    _add_row(mesh, at + stride, factor * wy[1], wx)
    _add_row(mesh, at + np.uint64(2) * stride, factor * wy[2], wx)
    _add_row(mesh, at + np.uint64(3) * stride, factor * wy[3], wx)
    _add_row(mesh, at + np.uint64(4) * stride, factor * wy[4], wx)
    _add_row(mesh, at + np.uint64(5) * stride, factor * wy[5], wx)
    _add_row(mesh, at + np.uint64(6) * stride, factor * wy[6], wx)
    _add_row(mesh, at + np.uint64(7) * stride, factor * wy[7], wx)


@_inlined
def _row(mesh: Array, at: int, w: Weights) -> float:
    low = (mesh[at] * w[0] + mesh[at + np.uint64(1)] * w[1]) + (
        mesh[at + np.uint64(2)] * w[2] + mesh[at + np.uint64(3)] * w[3]
    )
    high = (mesh[at + np.uint64(4)] * w[4] + mesh[at + np.uint64(5)] * w[5]) + (
        mesh[at + np.uint64(6)] * w[6] + mesh[at + np.uint64(7)] * w[7]
    )
    return low + high


@_inlined
def _inner(mesh: Array, at: int, stride: int, wy: Weights, wx: Weights) -> float:
    """Return wy^T mesh wx, of the mesh points from `at` on."""
    total = wy[0] * _row(mesh, at, wx) + wy[1] * _row(mesh, at + stride, wx)
    total += wy[2] * _row(mesh, at + np.uint64(2) * stride, wx)
    total += wy[3] * _row(mesh, at + np.uint64(3) * stride, wx)
    total += wy[4] * _row(mesh, at + np.uint64(4) * stride, wx)
    total += wy[5] * _row(mesh, at + np.uint64(5) * stride, wx)
    total += wy[6] * _row(mesh, at + np.uint64(6) * stride, wx)
    return total + wy[7] * _row(mesh, at + np.uint64(7) * stride, wx)


class Mesh(NamedTuple):
    """Points of a mesh in a plain array: rows of `stride` points, `per_length` to the metre.

    (x0, y0) [m] is the corner from which sheep count their mesh points, first_row the first
    row in the array.
    """

    x0: float
    y0: float
    per_length: float
    stride: int
    first_row: int


@_inlined
def _place(x: float, y: float, mesh: Mesh) -> tuple[Any, float, float]:
    """Return the first mesh point of a sheep, and the ways from it in units of the mesh."""
    gx, gy = (x - mesh.x0) * mesh.per_length, (y - mesh.y0) * mesh.per_length
    column, row = int(gx), int(gy)
    at = np.uint64((row - mesh.first_row) * mesh.stride + column)
    return at, gx - column, gy - row


@_kernel
def spread(x: Array, y: Array, mesh: Mesh, points: Array) -> None:
    """Add each sheep's spline weights to the mesh points about it."""
    stride = np.uint64(mesh.stride)
    for i in range(x.shape[0]):
        at, u, v = _place(x[i], y[i], mesh)
        _add_outer(points, at, stride, 1.0, _all(_value, v), _all(_value, u))


@_kernel
def gather(x: Array, y: Array, mesh: Mesh, points: Array, ax: Array, ay: Array) -> None:
    """Add the gradient of the field, interpolated between the mesh points, to ax, ay."""
    stride = np.uint64(mesh.stride)
    for i in range(x.shape[0]):
        at, u, v = _place(x[i], y[i], mesh)
        wx, wy = _all(_value, u), _all(_value, v)
        ax[i] += mesh.per_length * _inner(points, at, stride, wy, _all(_slope, u))
        ay[i] += mesh.per_length * _inner(points, at, stride, _all(_slope, v), wx)


@_kernel
def spread_dipoles(
    x: Array, y: Array, mu_x: Array, mu_y: Array, mesh: Mesh, points: Array
) -> None:
    """Add the derivative of what `spread` adds, as the sheep move with velocities mu."""
    stride = np.uint64(mesh.stride)
    for i in range(x.shape[0]):
        at, u, v = _place(x[i], y[i], mesh)
        wx, wy = _all(_value, u), _all(_value, v)
        _add_outer(points, at, stride, mesh.per_length * mu_x[i], wy, _all(_slope, u))
        _add_outer(points, at, stride, mesh.per_length * mu_y[i], _all(_slope, v), wx)


@_kernel
def gather_hessians(
    x: Array, y: Array, mu_x: Array, mu_y: Array, mesh: Mesh, points: Array, dipoles: Array,
    hx: Array, hy: Array,
) -> None:  # fmt: skip
    """Add the derivative of what `gather` adds, as the sheep move with velocities mu.

    dipoles is the field of `spread_dipoles`, as points is that of `spread`.
    """
    stride, scale = np.uint64(mesh.stride), mesh.per_length
    for i in range(x.shape[0]):
        at, u, v = _place(x[i], y[i], mesh)
        wx, wy = _all(_value, u), _all(_value, v)
        dx, dy = _all(_slope, u), _all(_slope, v)
        xx = _inner(points, at, stride, wy, _all(_curvature, u))
        xy = _inner(points, at, stride, dy, dx)
        yy = _inner(points, at, stride, _all(_curvature, v), wx)
        hx[i] += scale * scale * (xx * mu_x[i] + xy * mu_y[i])
        hy[i] += scale * scale * (xy * mu_x[i] + yy * mu_y[i])
        hx[i] += scale * _inner(dipoles, at, stride, wy, dx)
        hy[i] += scale * _inner(dipoles, at, stride, dy, wx)


@_inlined
def _hessians_of_chunks(
    x: Array, y: Array, mu_x: Array, mu_y: Array, bx: Array, by: Array, i: int, begin: int,
    end: int, shift: int, reach2: float, near: Near,
) -> tuple[float, float]:  # fmt: skip
    """Do for Hessians times (mu_i - mu_j) what `_gradient_of_chunks` does for gradients."""
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


@_inlined
def _near_hessian(r2: float, near: Near) -> tuple[float, float]:
    """Return a, b with a w + b (s.w) s = Hessian times w, as `kernels.hessian` does."""
    slope, curvature = 0.0, 0.0
    r = math.sqrt(r2)
    for k in range(len(near) - 1, -1, -1):
        curvature = curvature * r + slope
        slope = slope * r + near[k]
    a = slope / r
    return a, (curvature - a) / r2


@_kernel
def near_hessians(
    x: Array, y: Array, mu_x: Array, mu_y: Array, cells: Cells, start: Indices,
    rows: tuple[int, int], reach: float, near: Near, hx: Array, hy: Array,
) -> None:  # fmt: skip
    """Do for Hessians times (mu_i - mu_j) what `near_gradients` does for gradients."""
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
