# SPDX-License-Identifier: Apache-2.0
"""Collect strays, else drive from behind (after Strömbom et al. 2014)."""

from __future__ import annotations

from herding_ros.control.errands import behind_each, Errands
from herding_ros.model.flock import centre, spread
from herding_ros.model.state import Array, HerdState
import numpy as np

from .rule import behind, nearest_posts


class CollectAndDrive:
    """Dogs with an errand go behind their strays; the others drive the flock from behind."""

    def posts(self, state: HerdState, errands: Errands, goal: Array) -> Array:
        """Return the posts (M, 2) [m]."""
        posts = np.array(state.dogs)
        places = errands.places(state.x)
        posts[errands.dogs] = behind_each(state.x[errands.sheep], places, errands.standoff)
        idle = errands.idle
        if len(idle):
            driving = drivers(
                state.x[errands.together], goal, len(idle), errands.standoff, errands.reach
            )
            posts[idle] = nearest_posts(state.dogs[idle], driving)
        return posts


def drivers(x: Array, goal: Array, dogs: int, standoff: float, reach: float) -> Array:
    """Return posts (dogs, 2) [m] side by side behind sheep at x (N, 2) on the way to a goal.

    They are at the standoff from a disc that holds as many sheep as the flock's spread tells, but
    near enough for the middle of the flock to be within reach [m], at the edge of the disc at
    nearest: where a push ends sharply, few sheep would feel it from farther off.
    """
    if not len(x):
        return np.tile(goal, (dogs, 1))
    middle, edge = centre(x), np.sqrt(2.0) * float(spread(x))
    return behind(middle, min(edge + standoff, max(edge, reach)), goal, dogs)
