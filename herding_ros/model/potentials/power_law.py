# SPDX-License-Identifier: Apache-2.0
"""Power laws of the distance, smoothed where they would be singular."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.parameters import quantity, TINY
from herding_ros.model.state import Array

from .potential import Potential


@dataclass(frozen=True)
class PowerLaw(Potential):
    """P(r) = C_r q^-p_r - C_a q^-p_a with q = sqrt(1 + (r/l)^2).

    A power of the distance for r >> l (Plummer's softening, 1911), smooth within l.
    """

    repulsion: float = quantity(5e-3, 'strength C_r of the repulsion', 'm^2/s^2', low=0.0)
    repulsion_exponent: float = quantity(3.0, 'exponent p_r of the repulsion', low=TINY, high=12.0)
    attraction: float = quantity(1e-3, 'strength C_a of the attraction', 'm^2/s^2', low=0.0)
    attraction_exponent: float = quantity(
        1.0, 'exponent p_a of the attraction', low=TINY, high=12.0
    )
    length: float = quantity(0.05, 'distance l within which it is smoothed', 'm', low=TINY)

    @property
    def _terms(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return (
            (self.repulsion, self.repulsion_exponent),
            (-self.attraction, self.attraction_exponent),
        )

    def value(self, r: Array) -> Array:
        """P(r) [m^2/s^2]."""
        q2 = 1.0 + (r / self.length) ** 2
        return sum((c * q2 ** (-0.5 * p) for c, p in self._terms), 0.0 * r)

    def derivative(self, r: Array) -> Array:
        """P'(r) [m/s^2]."""
        z = r / self.length
        q2 = 1.0 + z**2
        return sum(
            (-c * p * z / self.length * q2 ** (-0.5 * p - 1.0) for c, p in self._terms), 0.0 * r
        )

    def second_derivative(self, r: Array) -> Array:
        """P''(r) [1/s^2]."""
        z2 = (r / self.length) ** 2
        q2 = 1.0 + z2
        return sum(
            (
                c * p / self.length**2 * q2 ** (-0.5 * p - 2.0) * ((p + 1.0) * z2 - 1.0)
                for c, p in self._terms
            ),
            0.0 * r,
        )
