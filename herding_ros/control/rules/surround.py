# SPDX-License-Identifier: Apache-2.0
"""Stand all around the flock."""

from __future__ import annotations

from herding_ros.control.errands import Errands
from herding_ros.model.flock import centre
from herding_ros.model.state import Array, HerdState
import numpy as np

from .rule import nearest_posts, on_circle


class Surround:
    """Dogs spread evenly on a circle around all sheep, the first of them behind the flock."""

    def posts(self, state: HerdState, errands: Errands, goal: Array) -> Array:
        """Return the posts (M, 2) [m]."""
        middle, dogs = centre(state.x), len(state.d)
        radius = float(np.linalg.norm(state.x - middle, axis=1).max()) + errands.standoff
        back = np.arctan2(*(middle - goal)[::-1])
        angles = back + 2.0 * np.pi * np.arange(dogs) / dogs
        return nearest_posts(state.dogs, on_circle(middle, radius, angles))
