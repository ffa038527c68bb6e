# SPDX-License-Identifier: Apache-2.0
"""The mean-field limit of a large flock, by few characteristics (paper, section 7).

For many sheep, f(t, x, v), the density of the flock in position and velocity, solves

    df/dt + v . grad_x f = div_v ((grad P_1 * rho + sum_m grad P_2(x - d_m) + alpha v) f)

with rho = int f dv and * the convolution in x. Its characteristics move like sheep. Here P of
them, each with 1/P of the flock, carry it: blobs of Gaussian shape, so that they feel the
convolution of a smooth density (the blob method; Craig and Bertozzi 2016). A repulsion of a
much shorter range than the blobs' width acts as the pressure that it is in the limit, not as
a repulsion between the few.

So the limit is a crowd like any other, of P sheep with a mollified potential, and rollout,
adjoint and mapping are those of every crowd, at a cost that does not depend on N. It stays
without noise; under common noise the true limit would be a stochastic equation (paper, section 7).
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
"""Width of a blob in units of the distance between two.

With less, few blobs do not make a smooth density; with more, the flock has no edge. Measured
against 10,000 sheep, anything from 0.6 to 0.8 is as good.
"""
_WIDTHS_PER_OCTAVE = 4
"""Widths are rounded, so that one table serves many windows."""
_LEAST_WIDTH = 1e-3
"""For a flock in a single point, or in line [m]."""


def mean_field(crowd: Crowd, state: HerdState, markers: int) -> tuple[Crowd, HerdState]:
    """Return a crowd of `markers` blobs that represents the flock, and its state.

    Centre and momentum are the flock's. The spread lacks that within the leaves: of the order of
    the distance between two blobs squared, and the same for all controls.
    """
    x, v = leaves(state, markers)
    sheep = Mollified(crowd.sheep, blob_width(state.x, markers))
    return replace(crowd, sheep=sheep), HerdState(x, v, state.d)


def blob_width(x: Array, markers: int) -> float:
    """Return the width [m] of blobs that cover a flock at x (N, 2) [m]."""
    # Of the ellipse that has these variances, a quarter of each half-axis squared.
    area = 4.0 * math.pi * math.sqrt(max(float(np.linalg.det(np.cov(x.T, ddof=0))), 0.0))
    width = max(_OVERLAP * math.sqrt(area / markers), _LEAST_WIDTH)
    return float(2.0 ** (round(_WIDTHS_PER_OCTAVE * math.log2(width)) / _WIDTHS_PER_OCTAVE))


def leaves(state: HerdState, count: int) -> tuple[Array, Array]:
    """Return mean positions and velocities (count, 2) of parts of the flock of equal mass.

    The parts are the leaves of a k-d tree (Bentley 1975): the flock is cut across the direction
    in which it is wider, the halves again. A sheep on a cut belongs to both sides, in fractions.
    """
    sheep = np.concatenate([state.x, state.v], axis=1)
    # The order in which sheep are given must not matter, not even to rounding.
    sheep = sheep[np.lexsort(sheep.T[::-1])]
    # In these units each sheep weighs count and each leaf N: integers, so nothing is lost.
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
