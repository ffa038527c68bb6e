# SPDX-License-Identifier: Apache-2.0
"""The sheep of Strömbom et al. (2014): the plant that their heuristic (`strombom`) is made for.

Written from their equations 4.1 to 4.3 and Table 1. In a time step, here 1 s, a sheep with a dog
within r_s moves by 1 m along

    h H + c C + rho_a R_a + rho_s R_s + e E

where H, C, R_a, R_s and E are unit vectors: its last step, towards the centre of the others, away
from those within r_a (the sum of unit vectors), away from the dog, and at random. Without a dog in
reach it grazes: it stays, or, with probability p, takes a random step. A dog runs up to 1.5 m.

Ours: N = 25, and every sheep sees all others (n = N - 1). They start uniformly in the square from
L/2 to L = 150 m, the dog in the corner that is the goal, the origin. The flock has arrived when
all sheep are within f(N) = r_a N^(2/3) of it. Of several dogs R_s sums the unit vectors.
"""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.simulation import Observation
from herding_ros.model.state import Array, HerdState
import numpy as np
from numpy.typing import NDArray

from .lama import cut
from .strombom import unit

MAX_SPEED = 1.5
"""Of a dog [m/s]."""


@dataclass(frozen=True)
class Sheep:
    """Parameters of a sheep, as in their Table 1; lengths in m."""

    inertia: float = 0.5
    cohesion: float = 1.05
    repulsion: float = 2.0
    fear: float = 1.0
    noise: float = 0.3
    distance: float = 2.0
    reach: float = 65.0
    grazing: float = 0.05


class Flock:
    """The plant, a `Plant`; it is observed without errors."""

    goal = np.zeros(2)
    control_period = 1.0

    def __init__(self, seed: int, sheep: int = 25, dogs: int = 1, field: float = 150.0) -> None:
        """Start from the seed, which decides the noise as well."""
        start, self._process = np.random.default_rng(seed).spawn(2)
        self.kind, self.radius = Sheep(), Sheep.distance * sheep ** (2.0 / 3.0)
        x = start.uniform(0.5 * field, field, (sheep, 2))
        self.state = HerdState(x, np.zeros_like(x), np.zeros((dogs, 2)))
        self.dog_velocities: Array = np.zeros((dogs, 2))

    @property
    def arrived(self) -> bool:
        """Whether all sheep are within f(N) of the goal."""
        return bool((np.linalg.norm(self.state.x - self.goal, axis=1) <= self.radius).all())

    def observe(self) -> Observation:
        """Return the true state; the velocities are the last steps."""
        return Observation(self.state, self.dog_velocities)

    def advance(self, u: Array) -> None:
        """Move on by a time step under the commands u (M, 2) [m/s], cut at the dogs' speed."""
        x, d = self.state.x, self.state.d
        random = unit(self._process.standard_normal(x.shape))
        grazes = self._process.random(len(x)) < self.kind.grazing
        u = cut(u, MAX_SPEED)
        v = steps(self.kind, self.state, random, grazes)
        self.state, self.dog_velocities = HerdState(x + v, v, d + u), u


def steps(kind: Sheep, state: HerdState, random: Array, grazes: NDArray[np.bool_]) -> Array:
    """Return the next steps (N, 2) [m] of sheep.

    random: unit vectors (N, 2); grazes: (N,), which take a random step when they see no dog.
    """
    x, n = state.x, len(state.x)
    centre = (x.sum(axis=0) - x) / max(n - 1, 1)
    from_others, from_dogs = x[:, None] - x, x[:, None] - state.dogs
    near = np.linalg.norm(from_others, axis=-1) < kind.distance
    in_reach = np.linalg.norm(from_dogs, axis=-1) < kind.reach
    heading = (
        kind.inertia * unit(state.v)
        + kind.cohesion * unit(centre - x)
        + kind.repulsion * unit((near[..., None] * unit(from_others)).sum(axis=1))
        + kind.fear * unit((in_reach[..., None] * unit(from_dogs)).sum(axis=1))
        + kind.noise * random
    )
    at_ease = grazes[:, None] * random
    return np.where(in_reach.any(axis=1)[:, None], unit(heading), at_ease)
