# SPDX-License-Identifier: Apache-2.0
"""Our own plant with another truth than the one that its controller is told."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
import math

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import arrived, spread
from herding_ros.model.potentials import Morse
from herding_ros.model.simulation import Observation, Simulation, single, World
from herding_ros.model.state import Array, HerdState
import numpy as np

NO_FORCE = Morse(0.0, 1.0, 0.0, 1.0)
"""The potential of a dog that no sheep notices, or of sheep that do not notice each other."""


@dataclass(frozen=True)
class Truth:
    """What is different in the world; by default nothing.

    force, reach: of dogs, as multiples, the force being f(r / reach); friction: of sheep, as a
    multiple; attraction: of sheep for each other, as a multiple; speed_limit: of sheep [m/s];
    diversity: standard deviation of the logarithm of a sheep's response to dogs; ignoring:
    fraction of the sheep that do not notice dogs, and that do not have to arrive; delay: age of
    observations, which nobody states [s]; loss: fraction of the commands that are lost, each to
    one dog, which stands for that control period, as after its timeout; gust: by how much it
    displaces all sheep [m] after `GUST_AT`.
    """

    force: float = 1.0
    reach: float = 1.0
    friction: float = 1.0
    attraction: float = 1.0
    speed_limit: float = math.inf
    diversity: float = 0.0
    ignoring: float = 0.0
    delay: float = 0.0
    loss: float = 0.0
    gust: float = 0.0

    def crowd(self, told: Crowd) -> Crowd:
        """Return the true crowd for one that the controller is told."""
        assert isinstance(told.sheep, Morse)
        assert isinstance(told.dog, Morse)
        strength = self.force * self.reach  # the slope of a potential C exp(-r / l) is C / l
        dog = Morse(
            strength * told.dog.repulsion,
            self.reach * told.dog.repulsion_length,
            strength * told.dog.attraction,
            self.reach * told.dog.attraction_length,
        )
        sheep = replace(told.sheep, attraction=self.attraction * told.sheep.attraction)
        return replace(told, sheep=sheep, dog=dog, friction=self.friction * told.friction)


GUST_AT = 20.0
"""Time of the gust [s]."""


class OtherWorld(Simulation):
    """A `Simulation` of another truth: the same flock under the same noise."""

    radius = 0.6
    """Of the region around the goal in which sheep are counted [m]."""

    def __init__(self, told: Crowd, world: World, goal: Array, truth: Truth) -> None:
        """Start as the simulation of the crowd that the controller is told."""
        super().__init__(truth.crowd(told), world, goal)
        self._truth = truth
        self._chance = np.random.default_rng([world.seed, 40_000])
        n = world.sheep
        self.response = np.exp(truth.diversity * self._chance.standard_normal(n))
        self.response[self._chance.permutation(n)[: round(truth.ignoring * n)]] = 0.0
        self._noticing_spread = float(spread(single(self._noticing)))
        self._seen: deque[Observation] = deque(maxlen=1 + round(truth.delay / self.control_period))

    @property
    def _noticing(self) -> Array:
        return self.state.x[self.response > 0.0]

    @property
    def arrived(self) -> bool:
        """Whether those that notice dogs have arrived."""
        return arrived(
            single(self._noticing), self.goal, self._noticing_spread, self.world.arrival
        )

    def observe(self) -> Observation:
        """Return a noisy observation of some time ago, at first that of the start."""
        self._seen.append(super().observe())
        return self._seen[0]

    def advance(self, u: Array) -> None:
        """Move on by one control period under those commands u (M, 2) [m/s] that arrive."""
        truth = self._truth
        arrives = self._chance.random(len(u)) >= truth.loss
        super().advance(arrives[:, None] * u)
        if self.periods == round(GUST_AT / self.control_period):
            angle = self._chance.uniform(0.0, 2.0 * np.pi)
            moved = truth.gust * np.array([np.cos(angle), np.sin(angle)])
            self.state = replace(self.state, x=self.state.x + moved)

    def _moved(self, u: Array, noise: Array) -> HerdState:
        if np.isinf(self._truth.speed_limit) and (self.response == 1.0).all():
            return super()._moved(u, noise)
        state = self.state
        for shock in noise:
            # A step is linear in the forces, so that a response scales what dogs change.
            with_dogs, without = (
                self._step(crowd, state, u, shock)
                for crowd in (self.crowd, replace(self.crowd, dog=NO_FORCE))
            )
            v = without.v + self.response[:, None] * (with_dogs.v - without.v)
            speed = np.linalg.norm(v, axis=1, keepdims=True)
            limit = self._truth.speed_limit
            state = replace(with_dogs, v=np.where(speed > limit, limit / speed, 1.0) * v)
        return state

    def _step(self, crowd: Crowd, state: HerdState, u: Array, shock: Array) -> HerdState:
        dt, motion = self.world.dt, self.world.motion
        return rollout(crowd, state, u[None], dt, 1, shock[None], motion=motion).at(-1)
