# SPDX-License-Identifier: Apache-2.0
"""Where the herd starts: by default the reference scenario."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .parameters import Parameters, quantity
from .state import Array, HerdState

GOAL = (0.5, 0.5)
"""The destination, unless another is given [m]."""

MOST_SHEEP, MOST_DOGS = 1_000_000, 1000
"""No herd is larger."""


@dataclass(frozen=True)
class Start(Parameters):
    """Where sheep and dogs are at the start. The paper gives no positions; these are our own."""

    centre: tuple[float, float] = quantity(
        (0.0, 0.0), 'centre of the square in which the flock starts', 'm'
    )
    half_width: float = quantity(
        0.4, 'sheep start anywhere in a square of twice this side, at rest', 'm', low=0.0
    )
    dogs: str = quantity(
        'arc',
        'where dogs start: on an arc behind the flock, as seen from the goal (in front of it, if '
        'they attract), on one in front, or anywhere in the square',
        choices=('arc', 'front', 'inside'),
    )
    dog_radius: float = quantity(
        0.9, 'radius of the arc around the centre on which dogs start', 'm', low=0.0
    )
    dog_angle: float = quantity(
        0.9, 'largest angle of a dog on the arc, seen from its middle', 'rad', low=0.0, high=np.pi
    )


def initial_herd(
    sheep: int,
    dogs: int,
    goal: Array,
    rng: np.random.Generator,
    ahead: bool = False,
    start: Start = Start(),
) -> HerdState:
    """Sheep at rest in a square, dogs on an arc on the side away from the goal (2,) [m].

    Or, if ahead or the start says so, on the side of the goal, or in the square.
    """
    if sheep < 1 or dogs < 1:
        raise ValueError(
            f'a herd must have at least one sheep and one dog, got {sheep} sheep and {dogs} dogs'
        )
    centre = np.array(start.centre)
    x = centre + rng.uniform(-start.half_width, start.half_width, (sheep, 2))
    if start.dogs == 'inside':
        d = centre + rng.uniform(-start.half_width, start.half_width, (dogs, 2))
        return HerdState(x, np.zeros_like(x), d)
    side = goal - centre if ahead or start.dogs == 'front' else centre - goal
    angles = np.arctan2(side[1], side[0]) + (
        np.linspace(-start.dog_angle, start.dog_angle, dogs) if dogs > 1 else np.zeros(1)
    )
    d = centre + start.dog_radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return HerdState(x, np.zeros_like(x), d)
