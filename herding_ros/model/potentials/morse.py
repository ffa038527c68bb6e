# SPDX-License-Identifier: Apache-2.0
"""The Morse potential, the paper's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from herding_ros.model.parameters import quantity, TINY
from herding_ros.model.state import Array
import numpy as np

from .potential import Potential

if TYPE_CHECKING:
    from .forms import MorseCoefficients


@dataclass(frozen=True)
class Morse(Potential):
    """Morse potential P(r) = C_r exp(-r / l_r) - C_a exp(-r / l_a) (paper, section 6)."""

    repulsion: float = quantity(1.0, 'strength C_r of the repulsion', 'm^2/s^2', low=0.0)
    repulsion_length: float = quantity(1e-2, 'range l_r of the repulsion', 'm', low=TINY)
    attraction: float = quantity(5e-4, 'strength C_a of the attraction', 'm^2/s^2', low=0.0)
    attraction_length: float = quantity(2.0, 'range l_a of the attraction', 'm', low=TINY)

    @property
    def coefficients(self) -> tuple[float, float, float, float]:
        """(C_r / l_r, 1 / l_r, C_a / l_a, 1 / l_a), as the kernels take them."""
        return (
            self.repulsion / self.repulsion_length,
            1.0 / self.repulsion_length,
            self.attraction / self.attraction_length,
            1.0 / self.attraction_length,
        )

    def kernel_form(self) -> MorseCoefficients:
        """Return the coefficients: kernels evaluate the formula of Morse potentials."""
        return self.coefficients

    def value(self, r: Array) -> Array:
        """P(r) [m^2/s^2]."""
        return self.repulsion * np.exp(-r / self.repulsion_length) - self.attraction * np.exp(
            -r / self.attraction_length
        )

    def derivative(self, r: Array) -> Array:
        """P'(r) [m/s^2]."""
        a, _ = self._terms(np.square(r))
        return a * r

    def second_derivative(self, r: Array) -> Array:
        """P''(r) [1/s^2]."""
        a, b = self._terms(np.square(r))
        return a + b * np.square(r)

    def _terms(self, r2: Array) -> tuple[Array, Array]:
        from .forms import pair_terms  # a program's help needs no Numba

        return pair_terms(r2, self.coefficients)

    def without_ranges_below(self, length: float) -> Morse:
        """Return the potential without what has a shorter range than this [m], or the same."""
        return replace(
            self,
            repulsion=self.repulsion if self.repulsion_length > length else 0.0,
            attraction=self.attraction if self.attraction_length > length else 0.0,
        )
