"""A run under noisy sensors: how well the controller knows the herd, and what comes of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from herding_ros.control.closed_loop import as_policy, play
from herding_ros.control.parameters import Control
from herding_ros.control.pilot import LockstepPilot
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.flock import spread
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState

from .herding import measures, paths
from .settings import changed

_QUANTITIES = {'position': 'x', 'velocity': 'v', 'dog': 'd'}


class Watched:
    """The controller, with how far what it sees and what it believes are from the truth."""

    def __init__(self, pilot: LockstepPilot, simulation: Simulation) -> None:
        """Watch this controller in this world."""
        self._pilot = pilot
        self._policy = as_policy(pilot, [])
        self._simulation = simulation
        self._squares: dict[str, list[list[float]]] = {'seen': [], 'believed': []}

    def __call__(self, observed: HerdState, t: float) -> Array:
        """Return the velocities that the controller wants."""
        u = self._policy(observed, t)
        estimate = self._pilot.estimate
        assert estimate is not None
        for name, state in (('seen', observed), ('believed', estimate.state)):
            self._squares[name].append(
                [
                    float(np.square(getattr(state, a) - getattr(self._simulation.state, a)).mean())
                    for a in _QUANTITIES.values()
                ]
            )
        return u

    def errors(self) -> dict[str, dict[str, float]]:
        """Return root mean squares per coordinate, over all time and everybody.

        Under 'seen' and 'believed': position and dog [m], velocity [m/s]; all zero before the
        first observation.
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
    sheep: int,
    dogs: int,
    sigma: float,
    goal: list[float],
    noise: float,
    seed: int,
    time_limit: float,
    settings: dict[str, Any],
) -> dict[str, Any]:
    """Herd a flock that is seen with noise [m and m/s], and return the run in numbers.

    settings: what differs from Control(). The flock and what moves it depend on the seed alone.
    Arrival is judged on the true state.
    """
    crowd, destination = Crowd(noise=sigma), np.array(goal)
    world = World(sheep=sheep, dogs=dogs, seed=seed, position_noise=noise, velocity_noise=noise)
    simulation = Simulation(crowd, world, destination)
    planner = RecedingHorizon(crowd, changed(Control(), settings), destination, seed)
    watched = Watched(LockstepPilot(planner, dogs), simulation)
    track = play(simulation, watched, time_limit)
    return {
        **measures(track, destination, world.control_period),
        'final_spread': float(spread(track.x[-1])),
        'errors': watched.errors(),
        'paths': paths(track, destination, round(1.0 / world.control_period)),
    }
