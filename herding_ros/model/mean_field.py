# SPDX-License-Identifier: Apache-2.0
"""The mean-field limit of a large flock, by a few characteristics (paper, section 7).

For many sheep, f(t, x, v), the density of the flock in position and velocity, solves

    df/dt + v . grad_x f = div_v ((grad P_1 * rho + sum_m grad P_2(x - d_m) + alpha v) f)

with rho = int f dv and * the convolution in x. Its characteristics move like sheep. Here P of
them represent it, each 1/P of the flock. They are Gaussian blobs, so that the force on each is
the convolution with a smooth density (the blob method; Craig and Bertozzi 2016). A repulsion of
a much shorter range than the width of the blobs acts as a pressure, as it does in the limit, and
not between single blobs. Alignment has no such short range: it acts between the blobs' centres.

So the limit is a crowd like any other, of P sheep with a mollified potential, and rollout,
adjoint and mapping are those of every crowd, at a cost that does not depend on N. It has no
noise, although under common noise the true limit is a stochastic equation (paper, section 7).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
import math

import numpy as np
from numpy.typing import NDArray

from .crowd import Crowd
from .potentials import Mollified
from .state import Array, HerdState

_OVERLAP = 0.7
"""Width of a blob relative to the distance between neighbours.

With less, the blobs do not add up to a smooth density; with more, the edge of the flock is
blurred. Compared with 10,000 sheep, any value from 0.6 to 0.8 does as well.
"""
_WIDTHS_PER_OCTAVE = 4
"""Widths are rounded, so that one table serves many windows."""
_LEAST_WIDTH = 5e-4
"""Least width in extents of the potential, for a flock in one point or on a line."""


def mean_field(crowd: Crowd, state: HerdState, markers: int) -> tuple[Crowd, HerdState]:
    """Return a crowd of `markers` blobs that represents the flock, and its state.

    Centre and momentum are the flock's. The variance lacks that within the leaves, which is of the
    order of the squared distance between two blobs and the same for all controls.
    """
    x, v = leaves(state, markers)
    sheep = Mollified(crowd.sheep, blob_width(state.x, markers, crowd.sheep.extent))
    return replace(crowd, sheep=sheep), HerdState(x, v, state.d)


def blob_width(x: Array, markers: int, extent: float) -> float:
    """Return the width [m] of blobs that cover a flock at x (N, 2) [m].

    It is rounded in units of the extent [m] of the potential between sheep.
    """
    # That of the ellipse with these variances, each a quarter of a squared half-axis.
    area = 4.0 * math.pi * math.sqrt(max(float(np.linalg.det(np.cov(x.T, ddof=0))), 0.0))
    width = max(_OVERLAP * math.sqrt(area / markers) / extent, _LEAST_WIDTH)
    return float(
        extent * 2.0 ** (round(_WIDTHS_PER_OCTAVE * math.log2(width)) / _WIDTHS_PER_OCTAVE)
    )


def leaves(state: HerdState, count: int) -> tuple[Array, Array]:
    """Return mean positions and velocities (count, 2) of parts of the flock of equal mass.

    The parts are the leaves of a k-d tree (Bentley 1975): the flock is cut across the direction
    in which it is wider, the halves again. A sheep on a cut belongs to both sides, in fractions.
    """
    sheep = np.concatenate([state.x, state.v], axis=1)
    # The order in which sheep are given must not matter, not even to rounding.
    sheep = sheep[np.lexsort(sheep.T[::-1])]
    # In these units each sheep weighs count and each leaf N: integers, so nothing is rounded.
    mass = np.full(len(sheep), count)
    means = np.array(list(_leaves(sheep, mass, count)))
    return means[:, :2], means[:, 2:]


def _leaves(sheep: Array, mass: NDArray[np.int_], count: int) -> Iterator[Array]:
    """Yield the mean (4,) of each of so many parts of equal mass."""
    if count == 1:
        yield mass @ sheep / mass.sum()
        return
    x = sheep[:, :2]
    wider = int(np.argmax(mass @ np.square(x - mass @ x / mass.sum())))
    order = np.argsort(x[:, wider], kind='stable')
    sheep, mass = sheep[order], mass[order]
    first = count // 2
    left = np.diff(np.minimum(np.cumsum(mass), mass.sum() * first // count), prepend=0)
    for part, parts in ((left, first), (mass - left, count - first)):
        inside = part > 0
        yield from _leaves(sheep[inside], part[inside], parts)
