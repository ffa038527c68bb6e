# SPDX-License-Identifier: Apache-2.0
"""Sim and controller in one loop: the node graph without ROS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, finite, HerdState
import numpy as np

from .costs.cost import Cost
from .lockstep_pilot import LockstepPilot
from .parameters import check_lockstep, Control
from .pilot import Observed
from .receding_horizon import RecedingHorizon
from .solve_report import SolveReport

Policy = Callable[[HerdState, float], Array]
"""From the observed state and the time [s] to the dogs' velocities (M, 2) [m/s]."""


@dataclass(frozen=True)
class ClosedLoopRun:
    """The true course of a run of T control periods.

    t: (T+1,) [s]; x: (T+1, N, 2) [m]; d: (T+1, M, S) states of the dogs, the position [m] first;
    u: (T, M, 2) [m/s]; home: index of the first instant at which the flock had arrived, or None;
    reports: of the planner's solves.
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


def as_policy(pilot: LockstepPilot, reports: list[SolveReport]) -> Policy:
    """Return a pilot as a policy that appends the report of each plan to `reports`.

    Where the pilot of a node counts a plan that could not be made and goes on, this raises the
    error.
    """

    def policy(observed: HerdState, t: float) -> Array:
        decision = pilot.decide(Observed.complete(t, observed))
        if decision.error is not None:
            raise decision.error
        if decision.announcement is not None:
            reports.append(decision.announcement.plan.window.report)
        assert decision.command is not None  # in lockstep there always is one
        return decision.command

    return policy


def play(
    simulation: Simulation, policy: Policy, time_limit: float, stop: bool = True
) -> ClosedLoopRun:
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
    return ClosedLoopRun(np.array(t), np.array(x), np.array(d), velocities, home)


def closed_loop(
    crowd: Crowd,
    world: World,
    control: Control,
    goal: Array,
    time_limit: float,
    costs: Sequence[Cost] = (),
) -> ClosedLoopRun:
    """Herd by receding-horizon control until the flock arrives, or for time_limit [s].

    Observation noise, control period and all random numbers are those of the ROS graph in
    lockstep, and so is the result, bit for bit. The controller minimises `costs` as well as
    those that control.weights ask for. Raises ValueError if it counts on commands of another
    length than those of the world.
    """
    check_lockstep(control.horizon.control_period, world.control_period)
    simulation = Simulation(crowd, world, finite('goal', goal, (2,)))
    planner = RecedingHorizon(crowd, control, simulation.goal, world.seed, costs)
    reports: list[SolveReport] = []
    policy = as_policy(LockstepPilot(planner, world.dogs), reports)
    run = play(simulation, policy, time_limit)
    return replace(run, reports=tuple(reports))
