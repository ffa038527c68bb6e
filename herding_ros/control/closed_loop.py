"""Sim and controller in one loop: the node graph without ROS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, finite, HerdState

from .costs.cost import Cost
from .estimator import Estimator
from .parameters import Control
from .receding_horizon import RecedingHorizon, SolveReport

Policy = Callable[[HerdState, float], Array]
"""What decides: from the observed state and the time [s] to the dogs' velocities (M, 2) [m/s]."""


@dataclass(frozen=True)
class Run:
    """A run of T control periods, as it truly was.

    t: (T+1,) [s]; x: (T+1, N, 2) [m]; d: (T+1, M, 2) [m]; u: (T, M, 2) [m/s]; home: index of
    the first instant at which the flock had arrived, or None; reports: of the planner's solves.
    """

    t: Array
    x: Array
    d: Array
    u: Array
    home: int | None
    reports: tuple[SolveReport, ...] = ()

    @property
    def arrived(self) -> bool:
        """Whether the flock has arrived at some time."""
        return self.home is not None


class Planner:
    """Receding-horizon control as a policy; keeps its reports and what it believes."""

    def __init__(
        self, crowd: Crowd, control: Control, goal: Array, seed: int, costs: Sequence[Cost] = ()
    ) -> None:
        """Plan for this crowd and goal (2,) [m], with costs besides those of control.weights."""
        horizon = control.horizon
        self._planner = RecedingHorizon(crowd, control, goal, seed, costs)
        self._estimator = Estimator(
            crowd, control.sensor, horizon.control_period, horizon.substeps
        )
        self._told: Array | None = None  # the velocities that were returned last
        self.reports: list[SolveReport] = []
        self.believed: HerdState | None = None
        """Where everyone is, by all observations so far."""

    def __call__(self, observed: HerdState, t: float) -> Array:
        """Return the velocities at t, after a new plan if one is due."""
        told = np.zeros_like(observed.d) if self._told is None else self._told
        self.believed = self._estimator.update(t, np.arange(len(observed.x)), observed, told)
        if self._planner.due(t):
            self.reports.append(self._planner.solve(self.believed, t).report)
        assert self._planner.plan is not None
        self._told = self._planner.plan.at(t)
        return self._told


def play(simulation: Simulation, policy: Policy, time_limit: float, stop: bool = True) -> Run:
    """Herd by a policy for time_limit [s], with stop only until the flock arrives.

    All policies see the same observations of the same flock under the same noise.
    """
    world = simulation.world
    t, x, d, u = [0.0], [simulation.state.x], [simulation.state.d], []
    home = 0 if simulation.arrived else None
    while not (stop and home is not None) and t[-1] < time_limit - 0.5 * world.control_period:
        simulation.advance(policy(simulation.observe().state, t[-1]))
        t.append(simulation.nanoseconds * 1e-9)
        x.append(simulation.state.x)
        d.append(simulation.state.d)
        u.append(simulation.dog_velocities)
        if home is None and simulation.arrived:
            home = len(u)
    velocities = np.array(u).reshape(-1, world.dogs, 2)
    return Run(np.array(t), np.array(x), np.array(d), velocities, home)


def closed_loop(
    crowd: Crowd,
    world: World,
    control: Control,
    goal: Array,
    time_limit: float,
    costs: Sequence[Cost] = (),
) -> Run:
    """Herd by receding-horizon control until the flock arrives, or for time_limit [s].

    Observation noise, control period and all random numbers are those of the ROS graph in
    lockstep, and so is the result, bit for bit. The controller minimises `costs` as well as
    those that control.weights ask for.
    """
    simulation = Simulation(crowd, world, finite('goal', goal, (2,)))
    planner = Planner(crowd, control, goal, world.seed, costs)
    run = play(simulation, planner, time_limit)
    return replace(run, reports=tuple(planner.reports))
