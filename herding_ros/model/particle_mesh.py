# SPDX-License-Identifier: Apache-2.0
"""Forces between many sheep in a time that grows with their number, not with its square.

Particle-particle particle-mesh (Hockney and Eastwood 1988): the potential is split as
P = near + smooth. The near part is zero beyond a reach R and summed over pairs. The smooth part
is P beyond R and, within, an even polynomial that joins it smoothly (Potts and Steidl 2003). It
is summed on a mesh: sheep are spread by B-splines, convolved by FFT with the smooth
part in free space, and the field is interpolated by the same splines. The mesh's forces are the
exact gradient of an energy, and its Hessian products their exact derivative.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
import itertools
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from . import mesh_kernels, pair_kernels
from .mesh_kernels import Mesh, ORDER
from .pair_kernels import Cells, CHUNK, Indices, Near
from .potentials import Potential
from .state import Array

_SMOOTHNESS = 8
"""Number of continuous derivatives of the smooth part at the reach, counting the zeroth."""
_DERIVATIVES = np.array(
    [
        [Polynomial.basis(2 * power).deriv(k)(1.0) for power in range(_SMOOTHNESS)]
        for k in range(_SMOOTHNESS)
    ]
)
"""Row k holds the k-th derivatives of z^0, z^2, z^4, ... at z = 1."""
_COLUMNS = 16
"""Columns of cells per reach."""
_WRAP = 12
"""Mesh points beyond the largest distance over which the smooth part is made periodic."""
_PARTS = 4
"""Parts of the flock that may be computed in parallel; fixed, since rounding depends on it."""


def _fft() -> Any:
    # Imported only when needed: it would delay the start of every node by 0.2 s.
    import scipy.fft

    return scipy.fft


@cache
def split(potential: Potential, reach: float) -> tuple[Near, Polynomial]:
    """Return the near part's slope, and the smooth part within the reach [m].

    The slope as coefficients of powers of r, the smooth part as a polynomial of (r / reach)^2.
    """
    # NumPy's annotations cover arrays of one dimension only, and not in all versions.
    interpolate: Any = Chebyshev.interpolate
    slope = reach * interpolate(lambda z: potential.derivative(reach * z), 24, domain=[0.5, 1.5])
    conditions = [float(potential.value(np.array(reach)))]
    conditions += [float(slope.deriv(k)(1.0)) for k in range(_SMOOTHNESS - 1)]
    smooth = Polynomial(np.linalg.solve(_DERIVATIVES, conditions))
    smooth_slope = smooth.deriv()

    def near_slope(z: Array) -> Any:
        return potential.derivative(reach * z) - 2.0 * z / reach * smooth_slope(z * z)

    fitted = interpolate(near_slope, 15, domain=[0.0, 1.0])
    powers_of_z = Polynomial.cast(fitted, domain=[-1.0, 1.0], window=[-1.0, 1.0]).coef
    near = np.zeros(16)
    near[: len(powers_of_z)] = powers_of_z
    return tuple((near / reach ** np.arange(16.0)).tolist()), smooth


Run = Callable[..., Iterator[Any]]
"""`map`, or the `map` of an executor."""


class Part(NamedTuple):
    """A range of strips, its sheep, and the end of the sheep of the strip after it."""

    rows: tuple[int, int]
    sheep: slice
    reactions: int


class Flock(NamedTuple):
    """A flock sorted by cell: x (2, n + CHUNK) [m]; `order` holds the original indices."""

    lanes: int
    x: Array
    order: Indices
    start: Indices
    parts: list[Part]


@dataclass(frozen=True)
class ParticleMesh:
    """Forces of n sheep on each other in a box, by a mesh of a given spacing [m].

    low: (2,) lower corner of the box [m]; extent: (2,) its sides [m]; reach of the near part [m];
    run: applies a function to parts of the flock as `map` does, possibly on several cores.
    """

    potential: Potential
    n: int
    low: Array
    extent: Array
    reach: float
    spacing: float
    run: Run = map

    @cached_property
    def _split(self) -> tuple[Near, Polynomial]:
        near, smooth = split(self.potential, self.reach)
        return tuple(c / self.n for c in near), smooth

    @cached_property
    def _cells(self) -> Cells:
        width = self.reach / _COLUMNS
        columns, rows = np.ceil(self.extent / [width, self.reach]).astype(int).tolist()
        x0, y0 = self.low.tolist()
        return Cells(x0, y0, width, self.reach, columns, rows)

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Mesh points that sheep are spread over, rows and columns."""
        cells = self._cells
        sides = np.array([cells.rows * cells.height, cells.columns * cells.width])
        rows, columns = (sides / self.spacing).astype(int) + 1 + ORDER
        return int(rows), int(columns)

    @cached_property
    def padded(self) -> tuple[int, int]:
        """Mesh points including the padding that separates the periods of the FFT."""
        rows, columns = (
            2 * _fft().next_fast_len(points + _WRAP // 2, real=True) for points in self.shape
        )
        return rows, columns

    @cached_property
    def _influence(self) -> Array:
        """Transform of the smooth part divided by n, corrected for the two uses of the splines.

        The least-squares optimum (Hockney and Eastwood 1988) with the aliases of the splines.
        """
        _, smooth = self._split
        distances, factors = zip(*map(self._axis, self.shape, self.padded), strict=True)
        r = np.hypot(distances[0][:, None], distances[1])
        z = np.minimum(r / self.reach, 1.0)
        quadrant = np.where(
            z < 1.0, smooth(z * z), self.potential.value(np.maximum(r, self.reach))
        )
        rows, columns = (
            np.minimum(np.arange(points), points - np.arange(points)) for points in self.padded
        )
        transform = _fft().rfft2(quadrant[rows][:, columns]).real
        transform *= factors[0][rows][:, None] * factors[1]
        return transform / self.n

    def _axis(self, points: int, period: int) -> tuple[Array, Array]:
        """Return distances along an axis and factors of its wave numbers, over half a period.

        Distances are true up to `points`; beyond, they level off smoothly, so that any function
        of them is periodic.
        """
        steps = np.arange(period // 2 + 1)
        beyond = period / 2 - points
        t = np.maximum(steps - points, 0) / beyond
        level = t - t**5 * (7.0 - 14.0 * t + 10.0 * t**2 - 2.5 * t**3)
        waves = steps / period
        aliases = sum(np.sinc(waves + m) ** (2 * ORDER) for m in range(-2, 3))
        factors = np.sinc(waves) ** (2 * ORDER) / aliases**2
        return self.spacing * (np.minimum(steps, points) + beyond * level), factors

    def holds(self, x: Array) -> bool:
        """Whether all sheep at x (2, lanes) [m] are in the box."""
        share = (x[:, : self.n].T - self.low) / self.extent
        return bool(((share >= 0.0) & (share < 1.0 - 1e-9)).all())  # not on the upper edge

    def gradients(self, x: Array) -> Array:
        """Return 1/n sum_j grad P(x_i - x_j) at x (2, lanes) [m], as (2, lanes) [m/s^2]."""
        flock = self._sort(x)
        pairs = self._pairs(flock, pair_kernels.near_gradients, *flock.x)
        mesh, field = self._field(flock, mesh_kernels.spread, *flock.x)

        def gather(part: Part, out: Array) -> None:
            here = flock.x[:, part.sheep]
            mesh_kernels.gather(*here, mesh, field, *out[:, part.sheep])

        return self._sum(flock, pairs, gather)

    def hessian_products(self, x: Array, mu: Array) -> Array:
        """Return the derivative of the gradients as sheep at x move with velocities mu."""
        flock = self._sort(x)
        moves = np.zeros_like(flock.x)
        pair_kernels.take(mu, flock.order, moves)
        pairs = self._pairs(flock, pair_kernels.near_hessians, *flock.x, *moves)
        mesh, field = self._field(flock, mesh_kernels.spread, *flock.x)
        _, dipoles = self._field(flock, mesh_kernels.spread_dipoles, *flock.x, *moves)

        def gather(part: Part, out: Array) -> None:
            here = (*flock.x[:, part.sheep], *moves[:, part.sheep])
            mesh_kernels.gather_hessians(*here, mesh, field, dipoles, *out[:, part.sheep])

        return self._sum(flock, pairs, gather)

    def _sort(self, x: Array) -> Flock:
        cells = self._cells
        order = np.empty(self.n, dtype=np.int64)
        start = np.empty(cells.rows * cells.columns + 1, dtype=np.int64)
        if not pair_kernels.sort(x, self.n, cells, order, start):
            raise ValueError('all sheep must be in the box of the mesh')
        ordered = np.zeros((2, self.n + CHUNK))
        pair_kernels.take(x, order, ordered)
        begins = start[:: cells.columns]
        shares = np.arange(1, _PARTS) * self.n / _PARTS
        ends = [0, *np.searchsorted(begins, shares).tolist(), cells.rows]
        parts = [
            Part(
                (first, last),
                slice(int(begins[first]), int(begins[last])),
                int(begins[min(last + 1, cells.rows)]),
            )
            for first, last in itertools.pairwise(ends)
        ]
        return Flock(x.shape[1], ordered, order, start, parts)

    def _pairs(self, flock: Flock, kernel: Callable[..., None], *arrays: Array) -> Iterator[Array]:
        """Start the sums over the near pairs of each part; return an iterator over the results."""
        near, _ = self._split

        def of_part(part: Part) -> Array:
            out = np.zeros((2, part.reactions - part.sheep.start + CHUNK))
            kernel(*arrays, self._cells, flock.start, part.rows, self.reach, near, *out)
            return out

        return self.run(of_part, flock.parts)

    def _field(
        self, flock: Flock, kernel: Callable[..., None], *arrays: Array
    ) -> tuple[Mesh, Array]:
        """Return the mesh, and the field on it of what the kernel spreads."""
        cells, (rows, columns), (padded_rows, padded_columns) = (
            self._cells,
            self.shape,
            self.padded,
        )
        per_length = 1.0 / self.spacing

        def of_part(part: Part) -> tuple[int, Array]:
            first, last = (int(row * cells.height * per_length) for row in part.rows)
            first, last = max(first - 1, 0), min(last + 2 + ORDER, rows)
            mesh = Mesh(cells.x0, cells.y0, per_length, columns, first)
            points = np.zeros((last - first, columns))
            kernel(*(array[part.sheep] for array in arrays), mesh, points.reshape(-1))
            return first, points

        points = np.zeros((rows, columns))
        for first, found in self.run(of_part, flock.parts):
            points[first : first + len(found)] += found
        waves = _fft().rfft(points, padded_columns, axis=1)
        waves = _fft().fft(waves, padded_rows, axis=0, overwrite_x=True)
        waves *= self._influence
        waves = _fft().ifft(waves, axis=0, overwrite_x=True)[:rows]
        field = _fft().irfft(waves, padded_columns, axis=1, overwrite_x=True)
        return Mesh(cells.x0, cells.y0, per_length, padded_columns, 0), field.reshape(-1)

    def _sum(
        self, flock: Flock, pairs: Iterator[Array], gather: Callable[[Part, Array], None]
    ) -> Array:
        """Return the sum of both parts in the original order of the sheep, (2, lanes)."""
        total = np.zeros_like(flock.x)
        list(self.run(lambda part: gather(part, total), flock.parts))
        for part, found in zip(flock.parts, pairs, strict=True):
            total[:, part.sheep.start : part.reactions + CHUNK] += found
        out = np.zeros((2, flock.lanes))
        pair_kernels.put(total, flock.order, out)
        return out
