# SPDX-License-Identifier: Apache-2.0
"""A potential from a table, for example from measured data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from herding_ros.model.state import Array, finite
from herding_ros.model.units import factor
import numpy as np

from .potential import Potential


@dataclass(frozen=True)
class Tabulated(Potential):
    """The cubic spline through values at some distances; without force beyond the last one.

    distances: (n,) increasing, at least 2 [m]; values: (n,) [m^2/s^2]. Nearer than the first
    distance the force is that at the first, beyond the last the potential is constant. The
    slope is continuous, as the spline is made to end flat.
    """

    distances: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        """Validate, and convert to tuples, so that equal tables are equal."""
        r = finite('Tabulated.distances', self.distances, (None,))
        values = finite('Tabulated.values', self.values, (len(r),))
        if len(r) < 2 or r[0] < 0.0 or (np.diff(r) <= 0.0).any():
            raise ValueError(
                'Tabulated.distances must be at least two increasing numbers of at least 0, '
                f'got {r.tolist()}'
            )
        object.__setattr__(self, 'distances', tuple(r.tolist()))
        object.__setattr__(self, 'values', tuple(values.tolist()))

    def rescaled(self, length: float, time: float) -> Tabulated:
        """Return the potential in a world whose lengths and times are so many times ours."""
        strength = factor('m^2/s^2', length, time)
        return Tabulated(
            tuple(length * each for each in self.distances),
            tuple(strength * each for each in self.values),
        )

    @property
    def extent(self) -> float:
        """The last distance [m]."""
        return self.distances[-1]

    @property
    def reach(self) -> float:
        """Distance [m] from which on there is no force: the last one."""
        return self.distances[-1]

    @cached_property
    def _spline(self) -> Any:
        # Imported where it is needed: nodes would start later by a tenth of a second.
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.distances, self.values, bc_type=('not-a-knot', (1, 0.0)))

    def value(self, r: Array) -> Array:
        """P(r) [m^2/s^2]."""
        inside = self._inside(r)
        nearer = np.minimum(r - self.distances[0], 0.0)
        return self._spline(inside) + nearer * self._spline(self.distances[0], 1)

    def derivative(self, r: Array) -> Array:
        """P'(r) [m/s^2]."""
        return self._spline(self._inside(r), 1)

    def second_derivative(self, r: Array) -> Array:
        """P''(r) [1/s^2]."""
        return np.where(self._inside(r) == r, self._spline(self._inside(r), 2), 0.0)

    def _inside(self, r: Array) -> Array:
        return np.clip(r, self.distances[0], self.distances[-1])
