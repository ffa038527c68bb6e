# SPDX-License-Identifier: Apache-2.0
"""How far a dog is felt: the lengths that everything about dogs and sheep is measured in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from herding_ros.model.crowd import Crowd
from herding_ros.model.potentials import Potential
import numpy as np

_DISTANCES = 0.5 * np.geomspace(1e-4, 1e4, 1601, dtype=np.float64)
"""Where the force of a dog is looked up, in extents of its potential."""

_STRONG, _FELT = 0.8, 0.1
"""Parts of the greatest force: at the standoff, and at the reach."""


@dataclass(frozen=True)
class Reach:
    """The distances [m] at which a dog drives a sheep well, and up to which it is felt at all.

    standoff: where its force has fallen to 80 % of the greatest, so that a dog there has a firm
    hold of its sheep; reach: where it has fallen to 10 %; repels: whether it is driven away.
    """

    standoff: float
    reach: float
    repels: bool

    @classmethod
    def of(cls, crowd: Crowd) -> Reach | None:
        """Return the lengths of a crowd's dogs; None if no sheep notices them."""
        return _reach(crowd.dog)


@lru_cache(maxsize=64)  # each plan asks, and a convolution takes long
def _reach(dog: Potential) -> Reach | None:
    distances = dog.extent * _DISTANCES
    slope = dog.derivative(distances)
    force = np.abs(slope)
    greatest = float(force.max())
    if not greatest > 0.0:
        return None

    def last_at(part: float) -> float:
        return float(distances[np.flatnonzero(force >= part * greatest)[-1]])

    return Reach(last_at(_STRONG), last_at(_FELT), bool(slope[force.argmax()] < 0.0))
