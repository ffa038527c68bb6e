"""Sim and controller in one loop: the node graph without ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from herding_ros.model.parameters import Crowd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, finite

from .parameters import Control
from .receding_horizon import RecedingHorizon, SolveReport


@dataclass(frozen=True)
class Run:
    """A run of T control periods, as it truly was.

    t: (T+1,) [s]; x: (T+1, N, 2) [m]; d: (T+1, M, 2) [m]; u: (T, M, 2) [m/s].
    """

    arrived: bool
    t: Array
    x: Array
    d: Array
    u: Array
    reports: tuple[SolveReport, ...]


def closed_loop(
    crowd: Crowd,
    world: World,
    control: Control,
    goal: Array,
    time_limit: float,
    progress: Callable[[Simulation], None] | None = None,
) -> Run:
    """Herd until the flock arrives, or for time_limit [s].

    Observation noise, control period and all random numbers are those of the ROS graph in
    lockstep, and so is the result, bit for bit.
    """
    simulation = Simulation(crowd, world, finite('goal', goal, (2,)))
    planner = RecedingHorizon(crowd, control, goal, world.seed)
    t, x, d, u, reports = [0.0], [simulation.state.x], [simulation.state.d], [], []
    while not simulation.arrived and t[-1] < time_limit - 0.5 * world.control_period:
        observed = simulation.observe().state
        if planner.due(t[-1]):
            reports.append(planner.solve(observed, t[-1]).report)
        assert planner.plan is not None
        simulation.advance(planner.plan.at(t[-1]))
        t.append(simulation.nanoseconds * 1e-9)
        x.append(simulation.state.x)
        d.append(simulation.state.d)
        u.append(simulation.dog_velocities)
        if progress is not None:
            progress(simulation)
    return Run(
        simulation.arrived,
        np.array(t),
        np.array(x),
        np.array(d),
        np.array(u).reshape(-1, world.dogs, 2),
        tuple(reports),
    )
