# SPDX-License-Identifier: Apache-2.0
"""A potential convolved with a Gaussian: the interaction of blobs of sheep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
import math
from typing import Any

from herding_ros.model.parameters import quantity, TINY
from herding_ros.model.state import Array
import numpy as np

from .potential import Potential

_WINDOW = 8.0
"""Widths beyond which a Gaussian is negligible (1e-14)."""
_PER_PANEL = 6
_HALVINGS = 8
"""Panels are halved so often towards distance 0, where potentials may be short and sharp."""
_FAR_NODES = 12


@dataclass(frozen=True)
class Mollified(Potential):
    """The convolution in the plane of a potential with a Gaussian of standard deviation width.

    The angle is integrated by Bessel functions, with z = r s / width^2 and e^-z I_n(z) scaled:

        P_w'(r) = int_0^inf P'(s) I_1(z) g(r, s) ds,
        P_w''(r) = int_0^inf (P''(s) (I_0(z) - I_1(z) / z) + P'(s) / s I_1(z) / z) g(r, s) ds,
        g(r, s) = s / width^2 exp(-(r - s)^2 / (2 width^2)) e^-z,

    and likewise P_w with P(s) I_0(z). A part C exp(-r / l) with l much shorter than the width
    becomes 2 pi l^2 C times the Gaussian; what varies slowly over a width stays as it is.
    """

    potential: Potential
    width: float = quantity(0.05, 'standard deviation of the Gaussian', 'm', low=TINY)

    @property
    def nearest(self) -> float:
        """Distance [m] within which P'/r is constant, to 3e-4."""
        return self.width / 32.0

    def value(self, r: Array) -> Array:
        """P(r) [m^2/s^2]."""
        reach = self.potential.reach
        beyond = self.potential.value(np.array([reach]))[0] if math.isfinite(reach) else 0.0

        def integrand(s: Array, z: Array) -> Array:
            return (self.potential.value(s) - beyond) * _bessel().i0e(z)

        return beyond + self._integral(r, integrand)

    def derivative(self, r: Array) -> Array:
        """P'(r) [m/s^2]."""

        def integrand(s: Array, z: Array) -> Array:
            return self.potential.derivative(s) * _bessel().i1e(z)

        return self._integral(r, integrand)

    def second_derivative(self, r: Array) -> Array:
        """P''(r) [1/s^2]."""

        def integrand(s: Array, z: Array) -> Array:
            across = _bessel().i1e(z) / z
            along = _bessel().i0e(z) - across
            p = self.potential
            return p.second_derivative(s) * along + p.derivative(s) / s * across

        return self._integral(r, integrand)

    def _integral(self, r: Array, integrand: Callable[[Array, Array], Array]) -> Array:
        """Integrate integrand(s, r s / width^2) g(r, s) over s, for r of any shape.

        Near by fixed panels, far out, where all is smooth over a width, by Gauss and Hermite.
        Nothing is smooth where a potential ends: then by panels alone, which end there as well.
        """
        flat, end = np.ravel(r) / self.width, self.potential.reach / self.width
        ends = math.isfinite(end)
        far = np.full(flat.shape, False) if ends else flat >= _WINDOW
        out = np.empty_like(flat)
        t, weights = _panels(end if ends else 2.0 * _WINDOW)
        nodes, far_weights = np.polynomial.hermite_e.hermegauss(_FAR_NODES)
        for here, s, w in (
            (~far, t, weights * np.exp(-0.5 * np.square(flat[~far, None] - t))),
            (far, flat[far, None] + nodes, far_weights),
        ):
            out[here] = (w * s * integrand(s * self.width, flat[here, None] * s)).sum(axis=1)
        return out.reshape(np.shape(r))


def _bessel() -> Any:
    # Imported where it is needed: nodes would start later by a tenth of a second.
    import scipy.special

    return scipy.special


@cache
def _panels(end: float) -> tuple[Array, Array]:
    """Return Gauss nodes and weights from 0 to the end, in widths.

    They resolve short ranges and the Gaussian.
    """
    small = 0.5 ** np.arange(_HALVINGS, -1.0, -1.0)
    edges = np.concatenate([[0.0], small, np.arange(2.0, math.ceil(end))])
    edges = np.append(edges[edges < end], end)
    x, w = np.polynomial.legendre.leggauss(_PER_PANEL)
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    return (middle[:, None] + half[:, None] * x).ravel(), (half[:, None] * w).ravel()
