# SPDX-License-Identifier: Apache-2.0
"""Where and when the random force on sheep is strong: a factor of sigma, by time and place."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Protocol, runtime_checkable

import numpy as np

from .parameters import Parameters, quantity, TINY
from .state import Array


@runtime_checkable
class NoiseFunction(Protocol):
    """A factor f of sigma, by time t [s] and place x [m]; any Python function will do.

    It is finite and not negative, and depends on each place alone. The crowd's equations have a
    solution if f(t, x) <= C (1 + |x|) and |f(t, x) - f(t, y)| <= D |x - y| for some C and D
    (paper, remark in section 2.2).
    """

    def __call__(self, t: float, x: Array, /) -> Array | float:
        """Return the factor (N,) at t and places x (N, 2), or one number for all."""


@dataclass(frozen=True)
class NoiseField(Parameters):
    """A factor of sigma that grows along a slope, swings in time and differs in a patch.

    f(t, x) = max(1 + g.x, 0) (1 + a sin(2 pi t / T)) (1 + p exp(-|x - c|^2 / (2 l^2)))

    with slope g, gust a, period T, and a patch p at c of radius l; 1 by default. It keeps the
    conditions of `NoiseFunction` with

    C = (1 + a) (1 + max(p, 0)) max(1, |g|),
    D = (1 + a) (|g| (1 + max(p, 0)) + |p| ((1 + |g| |c|) e^(-1/2) / l + 2 |g| / e)).
    """

    slope: tuple[float, float] = quantity(
        (0.0, 0.0), 'relative growth of sigma per metre in x and in y', '1/m', live=True
    )
    gust: float = quantity(
        0.0, 'relative amplitude of the swings of sigma', low=0.0, high=1.0, live=True
    )
    period: float = quantity(10.0, 'time from one gust to the next', 's', low=TINY, live=True)
    patch: float = quantity(
        0.0,
        'relative increase of sigma in the middle of the patch',
        low=-1.0,
        live=True,
    )
    patch_centre: tuple[float, float] = quantity((0.0, 0.0), 'where the patch is', 'm', live=True)
    patch_radius: float = quantity(
        0.2, 'standard deviation of the patch', 'm', low=TINY, live=True
    )

    @property
    def is_uniform(self) -> bool:
        """Whether the factor is 1 everywhere and always."""
        return not (any(self.slope) or self.gust or self.patch)

    def __call__(self, t: float, x: Array) -> Array:
        """Return the factor (...) at t and places x (..., 2)."""
        slope = np.maximum(1.0 + self.slope[0] * x[..., 0] + self.slope[1] * x[..., 1], 0.0)
        gust = 1.0 + self.gust * math.sin(2.0 * math.pi * t / self.period)
        from_patch = np.square((x - self.patch_centre) / self.patch_radius).sum(axis=-1)
        return np.asarray(slope * gust * (1.0 + self.patch * np.exp(-0.5 * from_patch)))
