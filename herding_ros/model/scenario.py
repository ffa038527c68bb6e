# SPDX-License-Identifier: Apache-2.0
"""Where the herd starts: the reference scenario."""

from __future__ import annotations

import numpy as np

from .state import Array, HerdState

GOAL = (0.5, 0.5)
"""The destination, unless another is given [m]."""

MOST_SHEEP, MOST_DOGS = 1_000_000, 1000
"""No herd is larger."""

PASTURE = 0.4
"""Sheep start uniformly in a square of twice this side around the origin [m]."""
DOG_RADIUS = 0.9
_DOG_ARC = 0.9
"""Dogs start on an arc of this radius [m], within plus or minus this angle [rad]."""


def initial_herd(
    sheep: int, dogs: int, goal: Array, rng: np.random.Generator, ahead: bool = False
) -> HerdState:
    """Sheep at rest around the origin, dogs on an arc on the side away from the goal (2,) [m].

    Or, if ahead, on the side of the goal. The paper gives no positions; these are our own.
    """
    if sheep < 1 or dogs < 1:
        raise ValueError(
            f'a herd must have at least one sheep and one dog, got {sheep} sheep and {dogs} dogs'
        )
    x = rng.uniform(-PASTURE, PASTURE, (sheep, 2))
    side = goal if ahead else -goal
    angles = np.arctan2(side[1], side[0]) + (
        np.linspace(-_DOG_ARC, _DOG_ARC, dogs) if dogs > 1 else np.zeros(1)
    )
    d = DOG_RADIUS * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return HerdState(x, np.zeros_like(x), d)
