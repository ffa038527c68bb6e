# SPDX-License-Identifier: Apache-2.0
"""The fastest summation of the forces in a large flock, checked against the direct sum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np

from . import kernels
from .particle_mesh import ParticleMesh, Run
from .potentials import Potential
from .potentials.forms import divided, PotentialForm
from .state import Array

CROSSOVER = 1500
"""From this number of sheep on the summation is chosen: measured, see doc/performance.md."""

ACCURACY = 1e-4
"""Error of the forces on all sheep, relative in the Euclidean norm, that is kept."""

_CHECKED = 256
"""Number of sheep whose forces are compared with the direct sum."""
_SAFETY = 0.7
"""A sample must keep this part of the bound: the error of the whole flock may be larger."""
_PERIOD = 32
"""Steps after which a mesh is prepared again."""
_MARGIN = 0.02
"""The box is wider than the flock by this part of the flock, on each side, or some more."""
_BOXES_PER_OCTAVE = 8
"""Boxes have few sizes, so that what a mesh needs of the potential is found once."""
_COUNTED = 2**12
"""At most this many sheep are counted to estimate the number of near pairs."""

# Seconds, of one thread, for a pair in the direct sum, for one within the reach, and for a mesh
# point. Only their ratios matter. They are constants so that the same flock gets the same mesh.
_DIRECT, _PAIR, _POINT = 0.9e-9, 0.9e-9, 7e-9
# Mesh points on the longer side of the box. The most bounds the memory.
_POINTS = 16.0 * 2.0 ** (np.arange(29) / 4.0)
_RATIO_STEP = 0.5
_LEAST_GAIN = 0.9
"""If a higher ratio leaves more than this part of the error, no higher one is tried."""


@dataclass(frozen=True)
class DirectSum:
    """The same sums over all pairs, n (n - 1) / 2 of them."""

    potential: Potential
    n: int

    @cached_property
    def _form(self) -> PotentialForm:
        return divided(self.potential.kernel_form(), self.n)

    def holds(self, x: Array) -> bool:
        """Return True: sheep may be anywhere."""
        return True

    def gradients(self, x: Array) -> Array:
        """Return 1/n sum_j grad P(x_i - x_j) at x (2, lanes) [m], as (2, lanes) [m/s^2]."""
        out = np.empty_like(x)
        ring = np.empty((2, 2, 2 * x.shape[1]))
        physics = kernels.Physics(self.n, 1.0, self._form, self._form, 0.0)
        kernels.acceleration(x, x, np.empty((2, 0)), physics, ring, out)
        return -out

    def hessian_products(self, x: Array, mu: Array) -> Array:
        """Return the derivative of the gradients as sheep at x move with velocities mu."""
        out = np.empty_like(x)
        ring = np.empty((3, 2, 2 * x.shape[1]))
        kernels.hessian_products(x, mu, self.n, self._form, ring, out)
        return out


Sums = ParticleMesh | DirectSum
"""A summation of forces: `gradients`, `hessian_products`, and whether its box `holds` x."""


def prepare(
    potential: Potential, x: Array, n: int, accuracy: float = ACCURACY, run: Run = map
) -> Sums:
    """Return the fastest summation of forces on n sheep near x (2, lanes) [m], to the accuracy.

    The ratio of reach and mesh spacing sets the accuracy of a mesh. It starts where repulsion
    like the default crowd's needs it, and is raised until the error of a sample holds. For each
    ratio the reach is that of least cost. The result depends on the arguments only.
    """
    direct = DirectSum(potential, n)
    here = x[:, :n]
    low, high = here.min(axis=1), here.max(axis=1)
    if not np.isfinite([low, high]).all() or (high == low).all():  # lost, or all in one place
        return direct
    margin = _MARGIN * (high - low).max()
    unit = potential.extent
    octaves = np.ceil(_BOXES_PER_OCTAVE * np.log2((high - low + 2.0 * margin) / unit))
    extent = unit * 2.0 ** (octaves / _BOXES_PER_OCTAVE)
    low = low - 0.5 * (extent - (high - low))
    sample = np.linspace(0, n - 1, min(_CHECKED, n)).astype(int)
    exact = np.zeros((2, kernels.lanes(len(sample))))
    places = np.zeros_like(exact)
    places[:, : len(sample)] = here[:, sample]
    form = divided(potential.kernel_form(), n)
    kernels.subtract_gradients(*exact, *places, np.ascontiguousarray(here), form)
    exact = exact[:, : len(sample)]
    ratio, last = max(4.0, 4.5 - (math.log10(accuracy) + 3.5) / 0.55), math.inf
    while True:
        reach, cost = _cheapest(here, low, extent, ratio)
        if cost > 0.5 * _DIRECT * n**2:
            break
        mesh = ParticleMesh(potential, n, low, extent, reach, reach / ratio, run)
        error = float(np.linalg.norm(mesh.gradients(x)[:, sample] + exact))
        if error <= _SAFETY * accuracy * np.linalg.norm(exact):
            return mesh
        if error > _LEAST_GAIN * last:  # not for want of mesh points
            break
        ratio, last = ratio + _RATIO_STEP, error
    return direct


def _cheapest(x: Array, low: Array, extent: Array, ratio: float) -> tuple[float, float]:
    """Return the reach [m] of least cost for a ratio of reach and spacing, and its cost [s].

    Pairs within the reach are estimated from the numbers of sheep in squares.
    """
    counted = x[:, :: -(-x.shape[1] // _COUNTED)]
    scale = (x.shape[1] / counted.shape[1]) ** 2
    best = (math.inf, math.inf)
    for reach in (ratio * extent.max() / _POINTS).tolist():
        mesh_cost = _POINT * 4.0 * float(np.prod(ratio * extent / reach + 16.0))
        if mesh_cost > best[0]:  # and so are all that follow
            break
        columns = int(extent[0] / reach) + 1
        column, row = ((counted - low[:, None]) / reach).astype(int)
        numbers = np.bincount(row * columns + column)
        pairs = 0.5 * math.pi * scale * float(numbers @ (numbers - 1.0))
        best = min(best, (mesh_cost + _PAIR * pairs, reach))
    return best[1], best[0]


def summation(
    potential: Potential, n: int, accuracy: float = ACCURACY, run: Run = map
) -> Callable[[int, Array], Sums]:
    """Return a function from step number k and x (2, lanes) [m] to the summation of its forces.

    It is to be called for k = 0, 1, ... of a rollout in turn, and depends on no later step: a
    rollout in the making and, later, its reverse sweep get the same. Less than CROSSOVER sheep
    are summed directly.
    """
    if n < CROSSOVER:
        direct = DirectSum(potential, n)
        return lambda k, x: direct
    present: Sums | None = None

    def sums(k: int, x: Array) -> Sums:
        nonlocal present
        if present is None or k % _PERIOD == 0 or not present.holds(x):
            present = prepare(potential, x, n, accuracy, run)
        return present

    return sums
