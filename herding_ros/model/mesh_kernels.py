# SPDX-License-Identifier: Apache-2.0
"""The compiled loops between sheep and mesh: spread weights and gather fields by B-splines.

They call nothing of the other kernels, so they may stand in a file of their own. A mesh is a
plain array of rows. Indices are unsigned: one that may be negative stops vectorisation. Sums over
mesh points are written out, which the compiler turns into operations on whole vectors.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from .jit import inlined, kernel
from .state import Array

ORDER = 8
"""Sheep are spread over so many mesh points in each direction, by a B-spline of this order."""


def _spline_pieces() -> tuple[tuple[float, ...], ...]:
    """Return the cardinal B-spline's polynomial on each of its ORDER intervals, from the left.

    Powers ascend. Seen from a point at u beyond a mesh point, piece ORDER - 1 - q is the weight
    of the q-th mesh point from there.
    """
    # B(x) = sum_k (-1)^k C(n, k) max(x - k, 0)^(n-1) / (n-1)! (Schoenberg 1946), in integers.
    n = ORDER

    def coefficient(left: int, power: int) -> float:
        terms = (
            (-1) ** k * math.comb(n, k) * (left - k) ** (n - 1 - power) for k in range(left + 1)
        )
        return math.comb(n - 1, power) * sum(terms) / math.factorial(n - 1)

    return tuple(
        tuple(coefficient(left, power) for power in range(ORDER)) for left in range(ORDER)
    )


_PIECES = _spline_pieces()[::-1]

Weights = tuple[float, float, float, float, float, float, float, float]


@inlined
def _value(u: float, c: Weights) -> float:
    e = ((c[7] * u + c[6]) * u + c[5]) * u + c[4]
    return (((e * u + c[3]) * u + c[2]) * u + c[1]) * u + c[0]


@inlined
def _slope(u: float, c: Weights) -> float:
    e = ((7.0 * c[7] * u + 6.0 * c[6]) * u + 5.0 * c[5]) * u + 4.0 * c[4]
    return ((e * u + 3.0 * c[3]) * u + 2.0 * c[2]) * u + c[1]


@inlined
def _curvature(u: float, c: Weights) -> float:
    e = ((42.0 * c[7] * u + 30.0 * c[6]) * u + 20.0 * c[5]) * u + 12.0 * c[4]
    return (e * u + 6.0 * c[3]) * u + 2.0 * c[2]


@inlined
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


@inlined
def _add_row(mesh: Array, at: int, factor: float, w: Weights) -> None:
    mesh[at] += factor * w[0]
    mesh[at + np.uint64(1)] += factor * w[1]
    mesh[at + np.uint64(2)] += factor * w[2]
    mesh[at + np.uint64(3)] += factor * w[3]
    mesh[at + np.uint64(4)] += factor * w[4]
    mesh[at + np.uint64(5)] += factor * w[5]
    mesh[at + np.uint64(6)] += factor * w[6]
    mesh[at + np.uint64(7)] += factor * w[7]


@inlined
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


@inlined
def _row(mesh: Array, at: int, w: Weights) -> float:
    low = (mesh[at] * w[0] + mesh[at + np.uint64(1)] * w[1]) + (
        mesh[at + np.uint64(2)] * w[2] + mesh[at + np.uint64(3)] * w[3]
    )
    high = (mesh[at + np.uint64(4)] * w[4] + mesh[at + np.uint64(5)] * w[5]) + (
        mesh[at + np.uint64(6)] * w[6] + mesh[at + np.uint64(7)] * w[7]
    )
    return low + high


@inlined
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


@inlined
def _place(x: float, y: float, mesh: Mesh) -> tuple[Any, float, float]:
    """Return the first mesh point of a sheep, and the offsets from it in units of the mesh."""
    gx, gy = (x - mesh.x0) * mesh.per_length, (y - mesh.y0) * mesh.per_length
    column, row = int(gx), int(gy)
    at = np.uint64((row - mesh.first_row) * mesh.stride + column)
    return at, gx - column, gy - row


@kernel
def spread(x: Array, y: Array, mesh: Mesh, points: Array) -> None:
    """Add each sheep's spline weights to the mesh points about it."""
    stride = np.uint64(mesh.stride)
    for i in range(x.shape[0]):
        at, u, v = _place(x[i], y[i], mesh)
        _add_outer(points, at, stride, 1.0, _all(_value, v), _all(_value, u))


@kernel
def gather(x: Array, y: Array, mesh: Mesh, points: Array, ax: Array, ay: Array) -> None:
    """Add the gradient of the field, interpolated between the mesh points, to ax, ay."""
    stride = np.uint64(mesh.stride)
    for i in range(x.shape[0]):
        at, u, v = _place(x[i], y[i], mesh)
        wx, wy = _all(_value, u), _all(_value, v)
        ax[i] += mesh.per_length * _inner(points, at, stride, wy, _all(_slope, u))
        ay[i] += mesh.per_length * _inner(points, at, stride, _all(_slope, v), wx)


@kernel
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


@kernel
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
