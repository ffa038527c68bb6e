# SPDX-License-Identifier: Apache-2.0
"""A whole run: a flock is herded by some policy, and the run is put into numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import time
from typing import Any

from herding_ros.control.closed_loop import as_policy, play, Policy
from herding_ros.control.lockstep_pilot import LockstepPilot
from herding_ros.control.parameters import Control, Mapping
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.solve_report import SolveReport
from herding_ros.model.crowd import CROWDS
from herding_ros.model.flock import Arrival
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
import numpy as np

from .measures import course, measures, plans, snapshots_at
from .starts import arranged
from .strombom import Strombom
from .truths import NO_FORCE

_QUANTITIES = {'position': 'x', 'velocity': 'v', 'dog': 'd'}


class Watched:
    """A policy with its processor time [s], and the errors of what it sees and estimates.

    Time of this process on all its cores: other load on the machine does not count.
    """

    def __init__(
        self, policy: Policy, simulation: Simulation, pilot: LockstepPilot | None = None
    ) -> None:
        """Watch a policy in this world; pilot: the one that decides in it, if any."""
        self._policy, self._simulation, self._pilot = policy, simulation, pilot
        self.seconds = 0.0
        self._squares: dict[str, list[list[float]]] = {'observed': [], 'estimated': []}

    def __call__(self, observed: HerdState, t: float) -> Array:
        """Return the velocities (M, 2) [m/s] of the policy."""
        started = time.process_time()
        u = self._policy(observed, t)
        self.seconds += time.process_time() - started
        states = {'observed': observed}
        if self._pilot is not None:
            assert self._pilot.estimate is not None
            states['estimated'] = self._pilot.estimate.state
        truth = self._simulation.state
        for name, state in states.items():
            self._squares[name].append(
                [
                    float(np.square(getattr(state, a) - getattr(truth, a)).mean())
                    for a in _QUANTITIES.values()
                ]
            )
        return u

    def errors(self) -> dict[str, dict[str, float]]:
        """Return root mean squares per coordinate, over the whole run.

        Under 'observed' and 'estimated': position and dog [m], velocity [m/s]; zero without any
        observation.
        """
        return {
            name: {
                quantity: float(np.sqrt(np.mean(column)))
                for quantity, column in zip(_QUANTITIES, np.transpose(rows), strict=True)
            }
            if rows
            else dict.fromkeys(_QUANTITIES, 0.0)
            for name, rows in self._squares.items()
        }


def run(
    policy: str,
    settings: dict[str, Any],
    sheep: int,
    dogs: int,
    sigma: float,
    goal: list[float],
    seed: int,
    time_limit: float,
    paths: int = Mapping.paths,
    noise: float | None = None,
    crowd: str = 'cohesive',
    common_noise: float = 0.0,
    stop: bool = True,
    every: float = 1.0,
    snapshots: Sequence[float] = (),
    strays: int = 0,
    start: str = 'usual',
    velocities: bool = True,
) -> dict[str, Any]:
    """Herd a flock by a policy and return the run in numbers.

    policy: 'planner' (settings: differences from Control() by dotted names; paths: its number of
    Monte Carlo paths), 'strombom' (settings: those of Strombom) or 'none', a dog that no sheep
    notices.
    noise: of all observations [m and m/s], by default that of World; crowd: name of a preset;
    stop: end with the arrival; every: spacing of the stored course [s]; snapshots: instants [s];
    strays: number of sheep that may be left behind; start: one of those of `arranged`, which the
    spread at the arrival is not compared with, but with the usual one; velocities: whether a
    planner sees those of the sheep.
    The flock and its random forces depend on the seed alone.
    """
    herd = replace(CROWDS[crowd], noise=sigma, common_noise=common_noise)
    destination = np.array(goal)
    world = World(sheep=sheep, dogs=dogs, seed=seed, arrival=Arrival(strays=strays))
    if noise is not None:
        world = replace(world, position_noise=noise, velocity_noise=noise)
    reports: list[SolveReport] = []
    pilot: LockstepPilot | None = None
    decide: Policy = _stand
    if policy == 'planner':
        control = Control().with_values({'mapping.paths': paths, **settings})
        pilot = LockstepPilot(RecedingHorizon(herd, control, destination, seed), dogs)
        decide = as_policy(pilot, reports, velocities)
    elif policy == 'strombom':
        decide = Strombom(destination, np.random.default_rng([seed, 30_000]), **settings)
    elif policy == 'none':
        herd = replace(herd, dog=NO_FORCE)
    else:
        raise ValueError(f"policy must be 'planner', 'strombom' or 'none', got {policy!r}")
    simulation = Simulation(herd, world, destination)
    simulation.state = arranged(start, simulation.state, destination)
    watched = Watched(decide, simulation, pilot)
    track = play(simulation, watched, time_limit, stop)
    period = world.control_period
    result = {
        **measures(track, destination, period, strays),
        'policy_cpu': watched.seconds,
        'paths': course(track, destination, max(round(every / period), 1), strays),
        'snapshots': snapshots_at(track, snapshots, period),
    }
    if pilot is not None:
        result |= {'plans': plans(reports), 'errors': watched.errors()}
    return result


def _stand(observed: HerdState, t: float) -> Array:
    return np.zeros_like(observed.d)
