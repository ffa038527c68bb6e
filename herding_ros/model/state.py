# SPDX-License-Identifier: Apache-2.0
"""The state of the herd at an instant, and along a rollout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def finite(name: str, value: object, shape: tuple[int | None, ...]) -> Array:
    """Return value as a float64 array of the given shape (None: any length).

    Raises
    ------
    ValueError
        naming the array, what it must be and what was given.

    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{name} must be an array of numbers: {error}') from error
    if array.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, array.shape, strict=True)
    ):
        expected = ', '.join('any' if n is None else str(n) for n in shape)
        expected += ',' * (len(shape) == 1)
        raise ValueError(f'{name} must have shape ({expected}), got {array.shape}')
    if not np.isfinite(array).all():
        raise ValueError(f'{name} must be finite, got NaN or infinite values')
    return array


@dataclass(frozen=True)
class HerdState:
    """Sheep and dogs at an instant.

    x: (N, 2) positions of the sheep [m]; v: (N, 2) their velocities [m/s]; d: (M, S) states of
    the dogs, the position (x, y) [m] first, see `MotionModel`; N, M >= 1 and S >= 2. Raises
    ValueError on wrong shapes and values that are not finite.
    """

    x: Array
    v: Array
    d: Array

    def __post_init__(self) -> None:
        """Validate, and convert to float64."""
        object.__setattr__(self, 'x', finite('sheep positions x', self.x, (None, 2)))
        object.__setattr__(self, 'v', finite('sheep velocities v', self.v, self.x.shape))
        object.__setattr__(self, 'd', finite('dogs d', self.d, (None, None)))
        if self.d.shape[1] < 2:
            raise ValueError(f'dogs d must have shape (M, 2) or wider, got {self.d.shape}')
        if not len(self.x) or not len(self.d):
            raise ValueError(
                f'a herd must have at least one sheep and one dog, got {len(self.x)} sheep '
                f'and {len(self.d)} dogs'
            )

    @property
    def dogs(self) -> Array:
        """Positions of the dogs, (M, 2) [m]."""
        return self.d[:, :2]

    def of_sheep(self, which: NDArray[np.bool_]) -> HerdState:
        """Return the herd of those sheep alone, (N,) whether one counts."""
        return self if which.all() else HerdState(self.x[which], self.v[which], self.d)


@dataclass(frozen=True)
class Trajectory:
    """The herd along a rollout of K steps of length dt [s].

    Stored as the kernels want it, coordinates first and sheep padded to whole vectors:
    xs (K+1, 2, lanes) [m], vs (K+1, 2, lanes) [m/s], ds (K+1, S, M) the states of the dogs,
    the position first; n sheep are real. Read it through x, v and d, which are views.
    """

    dt: float
    n: int
    xs: Array
    vs: Array
    ds: Array

    @property
    def x(self) -> Array:
        """Positions of the sheep, (K+1, N, 2) [m]; entry 0 is the start."""
        return self.xs[:, :, : self.n].transpose(0, 2, 1)

    @property
    def v(self) -> Array:
        """Velocities of the sheep, (K+1, N, 2) [m/s]."""
        return self.vs[:, :, : self.n].transpose(0, 2, 1)

    @property
    def d(self) -> Array:
        """Positions of the dogs, (K+1, M, 2) [m]."""
        return self.ds[:, :2].transpose(0, 2, 1)

    def at(self, k: int) -> HerdState:
        """Return the state after k steps; -1 is the end."""
        # Copies: sums over a view round otherwise than those over an array of its own.
        x, v, d = map(np.ascontiguousarray, (self.x[k], self.v[k], self.ds[k].T))
        return HerdState(x, v, d)
