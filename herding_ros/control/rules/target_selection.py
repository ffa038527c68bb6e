# SPDX-License-Identifier: Apache-2.0
"""Each dog drives one sheep to the goal (after Lama and di Bernardo 2024)."""

from __future__ import annotations

from herding_ros.control.errands import behind_each, Errands
from herding_ros.model.state import Array, HerdState
import numpy as np


class TargetSelection:
    """A dog goes behind the sheep that is farthest from the goal of those nearest to it."""

    def posts(self, state: HerdState, errands: Errands, goal: Array) -> Array:
        """Return the posts (M, 2) [m]; a dog that is nearest to no sheep stays."""
        x, d = state.x, state.dogs
        nearest = np.linalg.norm(x[:, None] - d, axis=-1).argmin(axis=1)
        off = np.linalg.norm(x - goal, axis=1)
        behind = behind_each(x, goal, errands.standoff)
        posts = np.array(d)
        for m in range(len(d)):
            mine = np.flatnonzero(nearest == m)
            if len(mine):
                posts[m] = behind[mine[off[mine].argmax()]]
        return posts
