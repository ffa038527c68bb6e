# SPDX-License-Identifier: Apache-2.0
"""The coarse problem of the first window: our SPG and SciPy's L-BFGS-B, with our gradient."""

from __future__ import annotations

from collections.abc import Callable

from benchmark.peers import scipy_lbfgsb
from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.costs.control_effort import ControlEffort
from herding_ros.control.objective import Objective, weighted_costs
from herding_ros.control.parameters import Control
from herding_ros.control.reference import reference
from herding_ros.control.solution import Budget, Problem
from herding_ros.control.spg import spg
from herding_ros.model.crowd import Crowd
from herding_ros.model.scenario import GOAL
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array
import numpy as np
import pytest

NEAR = 1e-4
"""Relative distance from the objective that SPG ends with, at which the clock stops."""


class _ReachedError(Exception):
    """The objective has reached the target."""


class Race:
    """The coarse problem of the default controller, run until a given objective is reached."""

    def __init__(self, seed: int, horizon: float) -> None:
        control = Control()
        goal = np.array(GOAL)
        state = Simulation(Crowd(), World(seed=seed), goal).state
        self.control, self.calls = control, 0
        self.coarse = CoarseModel(Crowd(), state, control.horizon.dt, control.horizon.substeps)
        intervals = round(horizon / control.horizon.control_period)
        self.start = np.zeros((intervals, len(state.d), 2))
        times = np.arange(intervals * control.horizon.substeps + 1.0) * control.horizon.dt
        target = reference(control.reference, state, goal, times)
        self.objective = Objective(
            [*weighted_costs(control.weights, target), ControlEffort(control.weights.control)]
        )
        self.target = -np.inf
        optimiser = control.optimiser
        budget = Budget(optimiser.max_iterations, optimiser.tolerance)
        best = spg(self._problem(), self.start, budget)
        self.target = best.value * (1.0 + NEAR)

    def value_and_gradient(self, u: Array) -> tuple[float, Array]:
        """Count the call; raise _ReachedError when the objective is low enough."""
        self.calls += 1
        value, gradient = self.coarse.value_and_gradient(self.objective, u)
        if value <= self.target:
            raise _ReachedError
        return value, gradient

    def _problem(self) -> Problem:
        return Problem(self.value_and_gradient, self._admissible, self.coarse.inner)

    def _admissible(self, u: Array) -> Array:
        return self.control.motion.project(u, self.control.max_speed)

    def ours(self) -> int:
        """Run SPG; return the number of values and gradients that it took."""
        return self._run(lambda: spg(self._problem(), self.start, Budget(1000)))

    def scipy(self) -> int:
        """Run L-BFGS-B; return the number of values and gradients that it took."""
        return self._run(
            lambda: scipy_lbfgsb.minimise(
                self.value_and_gradient, self.start, self.control.max_speed, self.coarse.interval
            )
        )

    def _run(self, optimise: Callable[[], object]) -> int:
        self.calls = 0
        with pytest.raises(_ReachedError):
            optimise()
        return self.calls


@pytest.mark.parametrize('seed', range(5), ids='seed{}'.format)
def test_scipy(compare: Callable[..., None], quick: bool, seed: int) -> None:
    """Time SciPy against SPG until both have reached what SPG ends with."""
    race = Race(seed, 2.0 if quick else Control().horizon.length)
    compare(
        'optimiser',
        race.ours,
        race.scipy,
        peer='SciPy',
        seed=seed,
        calls=race.ours(),
        peer_calls=race.scipy(),
    )
