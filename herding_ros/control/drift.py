# SPDX-License-Identifier: Apache-2.0
"""What moves the flock besides all that the model has, learned from how predictions fail.

A model that is wrong by a constant, as on a slope, in a wind or beside dogs that are feared less
than it believes, leaves a controller hovering short of the goal: at each look the plan seems to
bring the flock there. So the error is taken for a constant acceleration of the whole flock, and
plans make up for it (offset-free model predictive control, Pannocchia and Rawlings 2003).
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math

from herding_ros.model.crowd import Crowd
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array
import numpy as np

_MOST = 0.2
"""Part of the way of a dog that an error may be to be taken for a drift."""


@dataclass
class Drift:
    """A constant acceleration (2,) [m/s^2] of the flock that the model does not have."""

    acceleration: Array = field(default_factory=lambda: np.zeros(2))

    def path(self, crowd: Crowd, times: Array) -> Array:
        """Return how far it takes the centre in these times (K,) [s], (K, 2) [m]."""
        return displacement(crowd, times)[:, None] * self.acceleration

    def learn(
        self, crowd: Crowd, error: Array, elapsed: float, memory: float, max_speed: float
    ) -> None:
        """Learn from how far the centre is off its prediction (2,) [m], made `elapsed` [s] ago.

        The acceleration is the mean of what explains the errors, older ones fading over `memory`
        [s]. An error of more than a fifth of the way that a dog runs meanwhile at max_speed [m/s]
        is no drift: it does not last, as a gust, or comes and goes with what the dogs do.
        """
        if float(np.linalg.norm(error)) > _MOST * max_speed * elapsed:
            return
        gain = -math.expm1(-elapsed / memory)
        unit = float(displacement(crowd, np.array([elapsed]))[0])
        self.acceleration = self.acceleration + gain / unit * error


def displacement(crowd: Crowd, times: Array) -> Array:
    """Return how far a unit of acceleration takes free sheep, at rest before, in times [s]; [s^2].

    (a t + e^-at - 1) / a^2 with a = friction; t / a in a crowd of first order.
    """
    friction = crowd.friction
    if crowd.order == 1:
        return times / friction
    a = friction * times
    series = times**2 * (0.5 - a / 6.0)  # where the terms of the formula cancel
    return np.where(a < 1e-4, series, (a + np.expm1(-a)) / max(friction, TINY) ** 2)
