# SPDX-License-Identifier: Apache-2.0
"""The problems that are measured, and what stands for ours in every comparison."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.costs.control_effort import ControlEffort
from herding_ros.control.costs.tracking import Tracking
from herding_ros.control.objective import Objective
from herding_ros.control.parameters import Control
from herding_ros.control.reference import reference
from herding_ros.model.crowd import Crowd
from herding_ros.model.expectation import mean_centre
from herding_ros.model.flock import centre
from herding_ros.model.noise import noise_paths, NoisePaths
from herding_ros.model.sampling import FineModel
from herding_ros.model.scenario import GOAL, initial_herd
from herding_ros.model.state import Array
import numpy as np

SHEEP = (10, 30, 100, 300, 1000)
DOGS = (1, 5, 20)
STEPS = {10: 2000, 30: 2000, 100: 500, 300: 100, 1000: 20}
"""Fewer steps for many sheep: what is compared is the time per step."""
ENSEMBLE_STEPS = {10: 2000, 30: 2000, 100: 200, 300: 20, 1000: 2}
PATHS = 100
DT = 0.01
SUBSTEPS = 10
"""A control is held for so many steps, or for all if there are fewer."""


@dataclass(frozen=True)
class Problem:
    """A flock, its dogs, a cost, and the control at which value and gradient are computed.

    The starting positions are those of the package's scenario, the cost has the controller's
    weights 3 and a reference at 0.025 m/s, the control is random within the speed limit.
    """

    sheep: int
    dogs: int
    steps: int

    @cached_property
    def coarse(self) -> CoarseModel:
        """The crowd without noise."""
        state = initial_herd(self.sheep, self.dogs, np.array(GOAL), np.random.default_rng(0))
        return CoarseModel(Crowd(), state, DT, min(SUBSTEPS, self.steps))

    @cached_property
    def u(self) -> Array:
        """Control (intervals, M, 2) [m/s]."""
        speed = Control().max_speed
        shape = (self.steps // self.coarse.substeps, self.dogs, 2)
        u = np.random.default_rng(1).uniform(-speed, speed, shape)
        return Control().motion.project(u, speed)

    @cached_property
    def tracking(self) -> Tracking:
        """The cost of where the sheep are."""
        times = np.arange(self.steps + 1.0) * DT
        route = np.stack([centre(self.coarse.state.x), GOAL])
        target = reference('attainable', 0.025, route, times)
        return Tracking(3.0, 3.0, target)

    @cached_property
    def objective(self) -> Objective:
        """The cost of a window."""
        return Objective([self.tracking, ControlEffort(self.control_weight)])

    @property
    def control_weight(self) -> float:
        """Weight gamma of the control [s^2]."""
        return Control().weights.control

    def value_and_gradient(self) -> tuple[float, Array]:
        """Return our value, and our gradient in L2(0, T), (intervals, M, 2)."""
        return self.coarse.value_and_gradient(self.objective, self.u)

    def noise(self, paths: int = PATHS) -> NoisePaths:
        """Draw the noise of an ensemble."""
        rng = np.random.default_rng(2)
        return noise_paths(rng, self.coarse.crowd, self.sheep, DT, self.steps, paths)

    def mean_centre(self, noise: NoisePaths, threads: int | None = None) -> Array:
        """Return our mean of the sheep's centre (K+1, 2) [m]."""
        coarse = self.coarse
        fine = FineModel(coarse.crowd, coarse.state, coarse.dt, self.steps, coarse.substeps)
        return mean_centre(fine, self.u, noise, threads)

    def noise_array(self, noise: NoisePaths) -> Array:
        """Return the same noise (paths, K, 2, N) [m/s] as one plain array, for the peers."""
        return np.stack([noise.path(i)[:, :, : self.sheep] for i in range(noise.paths)])

    @property
    def interactions(self) -> int:
        """Number of forces of single sheep and dogs on single sheep in a step."""
        return self.sheep * (self.sheep - 1) + self.sheep * self.dogs

    @property
    def evaluations(self) -> int:
        """What has to be computed for them: a pair of sheep only once."""
        return self.sheep * (self.sheep - 1) // 2 + self.sheep * self.dogs
