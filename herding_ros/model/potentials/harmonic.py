# SPDX-License-Identifier: Apache-2.0
"""A repulsion that ends at some distance."""

from __future__ import annotations

from dataclasses import dataclass, replace

from herding_ros.model.parameters import quantity, TINY
from herding_ros.model.state import Array
import numpy as np

from .potential import Potential


@dataclass(frozen=True)
class Harmonic(Potential):
    """P(r) = k / 2 (R - r)^2 within the reach R, zero beyond: a spring that only pushes.

    Its force k (R - r) is that of herders on targets in Lama and di Bernardo (2024,
    arXiv:2307.16797); between sheep it makes a soft core.
    """

    stiffness: float = quantity(0.1, 'stiffness k', '1/s^2', low=0.0)
    reach: float = quantity(0.5, 'distance R from which on there is no force', 'm', low=TINY)

    def value(self, r: Array) -> Array:
        """P(r) [m^2/s^2]."""
        return 0.5 * self.stiffness * np.square(self._overlap(r))

    def derivative(self, r: Array) -> Array:
        """P'(r) [m/s^2]."""
        return -self.stiffness * self._overlap(r)

    def second_derivative(self, r: Array) -> Array:
        """P''(r) [1/s^2]."""
        return np.where(r < self.reach, self.stiffness, 0.0)

    def without_ranges_below(self, length: float) -> Harmonic:
        """Return the potential, without any force if its reach is no longer than this [m]."""
        return self if self.reach > length else replace(self, stiffness=0.0)

    def _overlap(self, r: Array) -> Array:
        return np.maximum(self.reach - r, 0.0)
