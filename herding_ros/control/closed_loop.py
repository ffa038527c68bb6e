# SPDX-License-Identifier: Apache-2.0
"""A plant and what controls it in one loop: with `Simulation`, the node graph without ROS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import logging
from typing import Protocol

from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import Observation, Simulation, World
from herding_ros.model.state import Array, finite, HerdState
import numpy as np

from .costs.cost import Cost
from .lockstep_pilot import LockstepPilot
from .parameters import check_lockstep, Control
from .pilot import Decision, Observed, Planner
from .receding_horizon import RecedingHorizon
from .solve_report import SolveReport

_log = logging.getLogger(__name__)

_LEVELS = {'info': logging.INFO, 'warning': logging.WARNING, 'error': logging.ERROR}

Policy = Callable[[HerdState, float], Array]
"""From the observed state and the time [s] to the dogs' velocities (M, 2) [m/s]."""


class Plant(Protocol):
    """A herd that moves: `Simulation`, or anyone's simulator.

    control_period: time for which a command holds [s]; state: the truth; dog_velocities: (M, 2)
    [m/s] in the last control period.
    """

    state: HerdState
    dog_velocities: Array

    @property
    def control_period(self) -> float:
        """Time between two observations [s]."""

    @property
    def arrived(self) -> bool:
        """Whether the herd is where it should be."""

    def observe(self) -> Observation:
        """Return what the sensors see."""

    def advance(self, u: Array) -> None:
        """Move on by one control period under the commands u (M, 2) [m/s]."""


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


def as_policy(pilot: LockstepPilot, reports: list[SolveReport], velocities: bool = True) -> Policy:
    """Return a pilot as a policy that appends the report of each plan to `reports`.

    Without velocities the pilot sees only the positions of sheep.
    """

    def keep(decision: Decision, t: float) -> None:
        if decision.announcement is not None:
            reports.append(decision.announcement.plan.window.report)

    return watched(pilot, keep, velocities)


def watched(
    pilot: LockstepPilot, watch: Callable[[Decision, float], None], velocities: bool = True
) -> Policy:
    """Return a pilot as a policy that shows each decision and its time [s] to `watch`.

    Without velocities the pilot sees only the positions of sheep. Where the pilot of a node counts
    a plan that could not be made and goes on, this raises the error. What the pilot has to say is
    logged (`logging`).
    """

    def policy(observed: HerdState, t: float) -> Array:
        decision = pilot.decide(Observed.complete(t, observed, velocities))
        for event in decision.events:
            _log.log(_LEVELS[event.level], '%.1f s: %s', t, event.text)
        if decision.error is not None:
            raise decision.error
        watch(decision, t)
        assert decision.command is not None  # in lockstep there always is one
        return decision.command

    return policy


def play(plant: Plant, policy: Policy, time_limit: float, stop: bool = True) -> ClosedLoopRun:
    """Herd by a policy for time_limit [s], with stop only until the flock arrives.

    All policies see the same observations of the same flock under the same noise.
    """
    period = round(plant.control_period * 1e9)
    t, x, d, u = [0.0], [plant.state.x], [plant.state.d], []
    home = 0 if plant.arrived else None
    while not (stop and home is not None) and t[-1] < time_limit - 0.5e-9 * period:
        plant.advance(policy(plant.observe().state, t[-1]))
        u.append(plant.dog_velocities)
        t.append(len(u) * period * 1e-9)
        x.append(plant.state.x)
        d.append(plant.state.d)
        if home is None and plant.arrived:
            home = len(u)
    velocities = np.array(u).reshape(-1, *plant.dog_velocities.shape)
    return ClosedLoopRun(np.array(t), np.array(x), np.array(d), velocities, home)


def steer(plant: Plant, planner: Planner, time_limit: float) -> ClosedLoopRun:
    """Herd by a planner, such as RecedingHorizon, until the flock arrives or for time_limit [s].

    Raises OutOfStepError if the planner counts on commands of another length than the plant's.
    """
    check_lockstep(planner.control.horizon.control_period, plant.control_period)
    reports: list[SolveReport] = []
    pilot = LockstepPilot(planner, len(plant.dog_velocities))
    run = play(plant, as_policy(pilot, reports), time_limit)
    return replace(run, reports=tuple(reports))


def closed_loop(
    crowd: Crowd,
    world: World,
    control: Control,
    goal: Array,
    time_limit: float,
    costs: Sequence[Cost] = (),
) -> ClosedLoopRun:
    """Herd our own crowd by receding-horizon control until it arrives, or for time_limit [s].

    Observation noise, control period and all random numbers are those of the ROS graph in
    lockstep, and so is the result, bit for bit. The controller minimises `costs` as well as
    those that control.weights ask for. Raises ValueError if it counts on commands of another
    length than those of the world.
    """
    simulation = Simulation(crowd, world, finite('goal', goal, (2,)))
    planner = RecedingHorizon(crowd, control, simulation.goal, world.seed, costs)
    return steer(simulation, planner, time_limit)
