# SPDX-License-Identifier: Apache-2.0
"""What the controller decides during a run: its looks, and between which plans it chooses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from herding_ros.control.closed_loop import play, watched
from herding_ros.control.costs.control_effort import ControlEffort
from herding_ros.control.lockstep_pilot import LockstepPilot
from herding_ros.control.objective import Objective
from herding_ros.control.parameters import Control
from herding_ros.control.pilot import Decision
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.task import RULES, Task
from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.warmup import warm_up
import numpy as np

from .measures import course, rounded
from .starts import arranged


class _Herd:
    """A flock of the reference scenario, and its planner and pilot."""

    def __init__(
        self, sheep: int, dogs: int, sigma: float, goal: list[float], seed: int, start: str
    ) -> None:
        self.goal = np.array(goal)
        crowd = Crowd(noise=sigma)
        self.simulation = Simulation(crowd, World(sheep=sheep, dogs=dogs, seed=seed), self.goal)
        self.simulation.state = arranged(start, self.simulation.state, self.goal)
        self.planner = RecedingHorizon(crowd, Control(), self.goal, seed)
        self._pilot = LockstepPilot(self.planner, dogs)
        warm_up(crowd)  # kernels are loaded when they are first called

    def play(self, time_limit: float, watch: Callable[[Decision, float], None]) -> dict[str, Any]:
        """Herd for time_limit [s], showing each decision and its time [s]; return the course."""
        policy = watched(self._pilot, watch)
        return course(play(self.simulation, policy, time_limit, stop=False), self.goal, 1)


def looks(
    sheep: int,
    dogs: int,
    sigma: float,
    goal: list[float],
    seed: int,
    time_limit: float,
    gust: list[float],
    gust_at: float,
    start: str = 'usual',
) -> dict[str, Any]:
    """Herd a flock, which a gust moves by (2,) [m] at an instant [s], and return all looks.

    Each with its time and the age of the plan before [s], the time that it took [ms], its kind,
    how its solve ended, and where it expects the centre after each second.
    """
    herd = _Herd(sheep, dogs, sigma, goal, seed, start)
    found: list[dict[str, Any]] = []

    def watch(decision: Decision, t: float) -> None:
        if decision.announcement is not None:
            window = decision.announcement.plan.window
            found.append(
                {
                    't': t,
                    'age': t - found[-1]['t'] if found else None,
                    'ms': 1e3 * window.report.seconds['total'],
                    'kind': window.report.kind,
                    'status': window.report.status.value,
                    'centre': rounded(window.centre[:: round(1.0 / window.dt)]),
                }
            )
        if abs(t - gust_at) < 0.5 * herd.simulation.world.control_period:
            state = herd.simulation.state
            herd.simulation.state = replace(state, x=state.x + np.array(gust))

    return {'paths': herd.play(time_limit, watch), 'looks': found}


def candidates(
    sheep: int, dogs: int, sigma: float, goal: list[float], seed: int, at: float, start: str
) -> dict[str, Any]:
    """Herd a flock until `at` [s], and return the plans from which a window may start then.

    Each with its name, its cost, and where it takes sheep and dogs in each second; the last one
    is the plan that the window finds, before it is corrected for the noise.
    """
    herd = _Herd(sheep, dogs, sigma, goal, seed, start)
    herd.play(at, lambda *_: None)
    planner, state = herd.planner, herd.simulation.observe().state
    control, last = planner.control, planner.plan
    assert last is not None
    model = planner.coarse_model(state).on_grid(1)
    task = Task.of(control, model, herd.goal)
    times = model.dt * np.arange(control.horizon.intervals + 1, dtype=np.float64)
    objective = Objective([*task.costs(times), ControlEffort(control.weights.control)])
    plans = {'the plan in play': last.shifted(at).u, **task.rule_plans(model, tuple(RULES))}
    planner.adjust(planner.crowd, control.with_values({'mapping.max_iterations': 0}))
    plans['the plan that is found'] = planner.solve(state, at).plan.u
    second, found = round(1.0 / model.dt), []
    for name, u in plans.items():
        trajectory = model.rollout(u)
        found.append(
            {
                'name': name,
                'cost': objective.value_and_derivatives(trajectory, u)[0],
                'x': rounded(trajectory.x[::second]),
                'd': rounded(trajectory.d[::second, :, :2]),
            }
        )
    return {'plans': found}
