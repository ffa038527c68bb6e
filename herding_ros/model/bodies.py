# SPDX-License-Identifier: Apache-2.0
"""Dogs are discs: how near they are to each other, and when two touch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .parameters import Parameters, quantity
from .state import Array


@dataclass(frozen=True)
class Body(Parameters):
    """The body of each dog."""

    radius: float = quantity(
        0.04, 'radius of a dog; two that are nearer than twice it touch', 'm', low=0.0
    )


def distances_between(d: Array) -> Array:
    """Return the distances (..., M (M - 1) / 2) [m] between dogs at d (..., M, 2) [m]."""
    one, other = np.triu_indices(d.shape[-2], k=1)
    return np.asarray(np.linalg.norm(d[..., one, :] - d[..., other, :], axis=-1))


def closest(d: Array) -> float:
    """Return the smallest distance [m] between two dogs of d (T, M, 2) [m] at any time.

    Infinite for fewer than two dogs. Those that were not seen, at NaN, are left out.
    """
    return float(np.nanmin(distances_between(d), initial=np.inf))


def touches(d: Array, radius: float) -> int:
    """Return how often two dogs of d (T, M, 2) [m] came to touch, at the start included."""
    touching = distances_between(d) < 2.0 * radius
    before = np.zeros_like(touching)
    before[1:] = touching[:-1]
    return int((touching & ~before).sum())
