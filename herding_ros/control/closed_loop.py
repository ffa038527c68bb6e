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

_SHORTEST = 1e-9
"""Time is counted in nanoseconds [s]."""

Policy = Callable[[HerdState, float], Array]
"""From the observed state and the time [s] to the dogs' velocities (M, 2) [m/s]."""


class Plant(Protocol):
    """A herd that moves: `Simulation`, or anyone's simulator.

    control_period: time for which a command holds [s]; state: the truth; dog_velocities: (M, 2)
    [m/s] in the last control period. Sheep and dogs stay as many as they are, in one order.
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
        """Return what the sensors see of all sheep and dogs."""

    def advance(self, u: Array) -> None:
        """Move on by one control period under the commands u (M, 2) [m/s]."""


@dataclass(frozen=True)
class ClosedLoopRun:
    """The true course of a run of T control periods.

    t: (T+1,) [s]; x: (T+1, N, 2) [m]; d: (T+1, M, S) states of the dogs, the position [m] first;
    u: (T, M, 2) [m/s] the `dog_velocities` of the plant, of a `Simulation` the commands in effect;
    home: index of the first instant at which the flock had arrived, or None; reports: of the
    planner's solves.
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

    All policies see the same observations of the same flock under the same noise. What is kept,
    and what the policy sees, are copies. Raises ValueError for a plant that is none, see `Plant`,
    and for a time limit below 0.
    """
    if not time_limit >= 0.0:
        raise ValueError(f'time_limit must be at least 0 s, got {time_limit!r}')
    if not plant.control_period >= _SHORTEST:
        raise ValueError(
            f'Plant.control_period must be a time above 0 s, got {plant.control_period!r}'
        )
    period = round(plant.control_period * 1e9)
    t, states, u = [0.0], [_copied('Plant.state', plant.state, plant.state)], [_velocities(plant)]
    home = 0 if _has_arrived(plant) else None
    while not (stop and home is not None) and t[-1] < time_limit - 0.5e-9 * period:
        observed = _copied('Plant.observe().state', plant.observe().state, states[0])
        plant.advance(policy(observed, t[-1]))
        states.append(_copied('Plant.state', plant.state, states[0]))
        u.append(_velocities(plant))
        t.append(len(t) * period * 1e-9)
        if home is None and _has_arrived(plant):
            home = len(t) - 1
    x, d = np.array([state.x for state in states]), np.array([state.d for state in states])
    return ClosedLoopRun(np.array(t), x, d, np.array(u)[1:], home)


def _copied(name: str, state: HerdState, first: HerdState) -> HerdState:
    """Return a copy of a plant's herd: a simulator may write into its arrays again."""
    if (len(state.x), len(state.d)) != (len(first.x), len(first.d)):
        raise ValueError(
            f'{name} must have as many sheep and dogs as at the start, {len(first.x)} and '
            f'{len(first.d)}, got {len(state.x)} and {len(state.d)}'
        )
    return replace(state)


def _velocities(plant: Plant) -> Array:
    """Return a copy of the velocities of a plant's dogs."""
    return finite('Plant.dog_velocities', plant.dog_velocities, (len(plant.state.d), 2))


def _has_arrived(plant: Plant) -> bool:
    """Return what a plant says: a method that is no property would be taken for a yes."""
    arrived = plant.arrived
    if not isinstance(arrived, bool | np.bool_):
        raise ValueError(f'Plant.arrived must be True or False, got {arrived!r}')
    return bool(arrived)


def steer(
    plant: Plant, planner: Planner, time_limit: float, velocities: bool = True
) -> ClosedLoopRun:
    """Herd by a planner, such as RecedingHorizon, until the flock arrives or for time_limit [s].

    Without velocities the planner sees only the positions of sheep, and needs a
    `sensor.position_noise` above 0 to make velocities from them. What its pilot has to say is
    logged (`logging`). Raises OutOfStepError, a ValueError, if the planner counts on commands of
    another length than the plant's, what `play` raises, and whatever keeps the planner from a
    plan.
    """
    check_lockstep(planner.control.horizon.control_period, plant.control_period)
    reports: list[SolveReport] = []
    pilot = LockstepPilot(planner, len(plant.state.d))
    run = play(plant, as_policy(pilot, reports, velocities), time_limit)
    return replace(run, reports=tuple(reports))


def closed_loop(
    crowd: Crowd,
    world: World,
    control: Control,
    goal: Array,
    time_limit: float,
    costs: Sequence[Cost] = (),
) -> ClosedLoopRun:
    """Herd our own crowd to the goal (2,) [m], until it arrives or for time_limit [s].

    This is receding-horizon control. Observation noise, control period and all random numbers are
    those of the ROS graph in lockstep, and so is the result, bit for bit. The controller minimises
    `costs` as well as those that control.weights ask for. Raises ValueError if it counts on
    commands of another length, or dogs of another motion, than those of the world, and for a goal,
    a time limit or costs that are none.
    """
    simulation = Simulation(crowd, world, goal)
    planner = RecedingHorizon(crowd, control, simulation.goal, world.seed, costs)
    return steer(simulation, planner, time_limit)
