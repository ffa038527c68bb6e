# SPDX-License-Identifier: Apache-2.0
"""One window of Table 1: a flock, its dogs, and the noise that a plan has to cope with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.parameters import Control, Mapping
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.window import Window
from herding_ros.model.crowd import Crowd
from herding_ros.model.expectation import mean_centre
from herding_ros.model.noise import noise_paths, NoisePaths
from herding_ros.model.sampling import FineModel
from herding_ros.model.scenario import GOAL, initial_herd
from herding_ros.model.state import Array, HerdState
import numpy as np

_AT_ONCE = 100
"""Number of paths whose noise is in memory at a time."""


@dataclass(frozen=True)
class Case:
    """The first window of the reference scenario, for a noise and a seed.

    The seed determines the flock and two independent sets of noise paths: those that a method
    sees (seen), and those on which it is judged.
    """

    sheep: int
    dogs: int
    sigma: float
    seed: int
    control: Control
    common_noise: float = 0.0

    @classmethod
    def experiment(cls, run: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
        """Return `run`, a function of a case and more, as one of values that JSON can hold.

        The case is given by its fields: control as differences from Control() by dotted names,
        and paths, the number of Monte Carlo paths of its mapping.
        """

        def of_values(
            sheep: int,
            dogs: int,
            sigma: float,
            seed: int,
            control: dict[str, Any],
            paths: int = Mapping.paths,
            common_noise: float = 0.0,
            **more: Any,
        ) -> dict[str, Any]:
            settings = Control().with_values({'mapping.paths': paths, **control})
            return run(cls(sheep, dogs, sigma, seed, settings, common_noise), **more)

        return of_values

    @cached_property
    def crowd(self) -> Crowd:
        """The sheep."""
        return Crowd(noise=self.sigma, common_noise=self.common_noise)

    @cached_property
    def state(self) -> HerdState:
        """The herd at the start."""
        rng = np.random.default_rng(self.seed)
        return initial_herd(self.sheep, self.dogs, np.array(GOAL), rng)

    @property
    def seen(self) -> int:
        """Seed of the noise paths that a method sees: that of RecedingHorizon's generator."""
        return 10_000 + self.seed

    @cached_property
    def coarse(self) -> CoarseModel:
        """The model without noise."""
        horizon = self.control.horizon
        return CoarseModel(self.crowd, self.state, horizon.dt, horizon.substeps)

    @cached_property
    def deterministic(self) -> Window:
        """The plan without noise, u_c."""
        mapping = replace(self.control.mapping, max_iterations=0)
        return self.plan(replace(self.control, mapping=mapping))

    def admissible(self, u: Array) -> Array:
        """Return the nearest control within the speed limit."""
        return self.control.motion.project(u, self.control.max_speed)

    def plan(self, control: Control) -> Window:
        """Return what the controller plans, with the noise that is seen."""
        return RecedingHorizon(self.crowd, control, np.array(GOAL), self.seen).solve(
            self.state, 0.0
        )

    def error(self, centres: Array) -> float:
        """|X - x_c| in L2(0, T) [m s^0.5] of expected centres (K+1, 2) [m]."""
        difference = centres - self.deterministic.centre
        return float(np.sqrt(self.coarse.dt * np.square(difference).sum()))

    def draw(self, rng: np.random.Generator, paths: int) -> NoisePaths:
        """Draw the noise of so many paths over the window."""
        horizon = self.control.horizon
        steps = horizon.intervals * horizon.substeps
        return noise_paths(rng, self.crowd, self.sheep, horizon.dt, steps, paths)

    def expected_centre(self, u: Array, noise: NoisePaths) -> Array:
        """Return the mean centre (K+1, 2) [m] under u over the paths of the noise."""
        coarse = self.coarse
        steps = len(u) * coarse.substeps
        fine = FineModel(
            self.crowd, self.state, coarse.dt, steps, coarse.substeps, motion=coarse.motion
        )
        return mean_centre(fine, u, noise)

    def judge(self, u: Array, paths: int, mirrored: bool = False) -> tuple[Array, float]:
        """Return expected centres (K+1, 2) [m] under u on noise that no method has seen.

        And their standard error in the norm of `error`, from groups of 100 paths. When mirrored,
        each path is taken a second time with its noise reversed, so that all that is linear in
        the noise cancels.
        """
        rng = np.random.default_rng([self.seed, 20_000])
        groups = []
        for _ in range(max(paths // _AT_ONCE, 2)):
            noise = self.draw(rng, min(_AT_ONCE, paths))
            centres = self.expected_centre(u, noise)
            if mirrored:
                reverse = self.expected_centre(u, NoisePaths(noise.paths, -noise.blocks))
                centres = 0.5 * (centres + reverse)
            groups.append(centres)
        variance = np.var(groups, axis=0, ddof=1) / len(groups)
        return np.mean(groups, axis=0), float(np.sqrt(self.coarse.dt * variance.sum()))

    def judged(self, u: Array, paths: int) -> dict[str, float]:
        """Return the error on unseen noise, and the error of that error, under JSON names."""
        centres, uncertainty = self.judge(u, paths)
        return {'error': self.error(centres), 'uncertainty': uncertainty}

    def trace(self, centres: Array) -> list[list[float]]:
        """Return centres every 0.5 s, rounded, for a figure."""
        every = max(round(0.5 / self.coarse.dt), 1)
        return [[round(float(value), 5) for value in point] for point in centres[::every]]
