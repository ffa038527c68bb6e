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

_HOLD = 0.5
"""Most of the reach that a standoff is: a dog at the edge of its reach loses its sheep."""

_OUTRUN = 2.0
"""A sheep that is pushed to this multiple of the dogs' speed is out of hand.

It then leaves a dog that runs after it as fast as the dog could run from it.
"""


@dataclass(frozen=True)
class Reach:
    """The distances [m] at which a dog drives a sheep well, and up to which it is felt at all.

    standoff: where its force has fallen to 80 % of the greatest, so that a dog there has a firm
    hold of its sheep, and at most half the reach; reach: where it has fallen to 10 %; repels:
    whether it is driven away.
    """

    standoff: float
    reach: float
    repels: bool

    @classmethod
    def of(cls, crowd: Crowd, max_speed: float) -> Reach | None:
        """Return the lengths of a crowd for dogs with this speed limit [m/s].

        None if no sheep notices them. The greatest force is that from a distance r [m] on from
        which no sheep leaves its dog behind,

            |P'(r)| / max(alpha, u_max / r) <= 2 u_max,

        the speed to which it pushes a sheep before friction stops that, or the dog, which takes
        r / u_max for the distance, is there (without inertia: with alpha alone). Nearer by, a
        power law would have its greatest force where it is cut off.
        """
        inertia = crowd.order == 2
        return _reach(crowd.dog, crowd.friction, inertia, max_speed)


@lru_cache(maxsize=64)  # each plan asks, and a convolution takes long
def _reach(dog: Potential, friction: float, inertia: bool, max_speed: float) -> Reach | None:
    distances = dog.extent * _DISTANCES
    slope = dog.derivative(distances)
    force = np.abs(slope)
    rate = np.maximum(friction, max_speed / distances) if inertia else friction
    outrun = np.flatnonzero(force > _OUTRUN * max_speed * rate)
    if len(outrun):
        distances, slope, force = (each[outrun[-1] :] for each in (distances, slope, force))
    greatest = float(force.max())
    if not greatest > 0.0:
        return None

    def last_at(part: float) -> float:
        return float(distances[np.flatnonzero(force >= part * greatest)[-1]])

    reach = last_at(_FELT)
    standoff = min(last_at(_STRONG), _HOLD * reach)
    return Reach(standoff, reach, bool(slope[force.argmax()] < 0.0))
