# SPDX-License-Identifier: Apache-2.0
"""The deterministic problem of a window, to be solved until a given objective is reached."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.costs.control_effort import ControlEffort
from herding_ros.control.objective import Objective
from herding_ros.control.parameters import Control, Mapping, Optimiser, Weights
from herding_ros.control.plan import Plan
from herding_ros.control.pqn import pqn
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.reference import reference
from herding_ros.control.solution import Budget, Problem
from herding_ros.control.spg import spg
from herding_ros.control.task import Task
from herding_ros.model.crowd import Crowd
from herding_ros.model.scenario import GOAL
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
import numpy as np

NEAR = 1e-4
"""Relative distance from the objective that SPG ends with, at which the clock stops."""

SPG_ITERATIONS, SPG_TOLERANCE = 60, 1e-2
"""Where SPG ends."""


QUADRATIC = Control(
    weights=Weights(centre=3.0, terminal=0.0, distance=0.0, beyond=0.0),
    optimiser=Optimiser(rules=False),
)
"""The default controller with a cost that every peer can state: squares along the window."""


class ReachedError(Exception):
    """The objective has reached the target."""


class Race:
    """The window of a controller (`QUADRATIC`) for 30 sheep and 5 dogs, on its finest time grid.

    played [s] of an earlier window's plan have been played, and its rest is the start; with 0
    dogs start at rest.
    """

    def __init__(self, seed: int, horizon: float, played: float = 0.0) -> None:
        control = replace(QUADRATIC, mapping=Mapping(max_iterations=0))
        shorter = replace(
            control.horizon, length=horizon, accepted=min(control.horizon.accepted, horizon / 2.0)
        )
        self.control = replace(control, horizon=shorter)
        self.goal, self.calls, self.target = np.array(GOAL), 0, -np.inf
        simulation = Simulation(Crowd(), World(seed=seed), self.goal)
        self._pose(simulation.state)
        self.start = np.zeros((shorter.intervals, len(simulation.state.d), 2))
        if played:
            u = pqn(self.problem(), self.start, Budget(SPG_ITERATIONS, NEAR)).u
            plan = Plan(0.0, shorter.control_period, u)
            for _ in range(round(played / shorter.control_period)):
                simulation.advance(plan.at(simulation.nanoseconds * 1e-9))
            self._pose(simulation.state)
            self.start = plan.shifted(played).u
        end = spg(self.problem(), self.start, Budget(SPG_ITERATIONS, SPG_TOLERANCE))
        self.target = end.value * (1.0 + NEAR)

    def _pose(self, state: HerdState) -> None:
        horizon = self.control.horizon
        self.coarse = CoarseModel(Crowd(), state, horizon.dt, horizon.substeps)
        self.objective, self.reference = self._objective(self.coarse)

    def _objective(self, coarse: CoarseModel) -> tuple[Objective, Array]:
        steps = self.control.horizon.intervals * coarse.substeps
        times = np.arange(steps + 1.0) * coarse.dt
        task = Task.of(self.control, coarse, self.goal)
        costs = [*task.costs(times), ControlEffort(self.control.weights.control)]
        target = reference('attainable', task.speed, np.stack([task.start, self.goal]), times)
        return Objective(costs), target

    def on_control_grid(self) -> tuple[CoarseModel, Objective]:
        """Return model and objective with one time step for each control."""
        coarse = self.coarse.on_grid(1)
        return coarse, self._objective(coarse)[0]

    def value_and_gradient(self, u: Array) -> tuple[float, Array]:
        """Count the call; raise ReachedError when the objective is low enough."""
        self.calls += 1
        value, gradient = self.coarse.value_and_gradient(self.objective, u)
        if value <= self.target:
            raise ReachedError
        return value, gradient

    def value(self, u: Array) -> float:
        """Return the objective, uncounted."""
        return self.objective.value_and_derivatives(self.coarse.rollout(u), u)[0]

    def project(self, u: Array) -> Array:
        """Return the nearest admissible control."""
        return self.control.motion.project(u, self.control.max_speed)

    def problem(self) -> Problem:
        """Return what an optimiser takes."""
        return Problem(
            self.value_and_gradient, self.project, self.coarse.inner, self.control.max_speed
        )

    def run(self, optimise: Callable[[], object]) -> int:
        """Run until the target is reached; return how many evaluations it took."""
        self.calls = 0
        try:
            optimise()
        except ReachedError:
            return self.calls
        raise AssertionError(f'ended above the target after {self.calls} evaluations')

    def ours(self) -> int:
        """Run the default optimiser; return the number of values and gradients that it took."""
        return self.run(lambda: pqn(self.problem(), self.start, Budget(1000)))

    def planned(self) -> Array:
        """Return the plan of the controller, made on both time grids, from rest."""
        planner = RecedingHorizon(self.coarse.crowd, self.control, self.goal)
        return planner.solve(self.coarse.state, 0.0).plan.u
