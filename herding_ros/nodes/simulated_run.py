# SPDX-License-Identifier: Apache-2.0
"""A run of the simulation: from the start until the flock is home or time is over. No ROS."""

from __future__ import annotations

from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
import numpy as np


class SimulatedRun:
    """A herd that moves on by commands, unless it is paused or the run is finished.

    It finishes when the flock has arrived, if `stop_on_arrival`, and after `time_limit` [s] unless
    that is 0. Moving the goal continues a finished run. It also finishes, where it is, when a
    step cannot be taken: when parameters take the herd beyond all numbers, or a function of the
    user's fails; then another crowd continues it, too.
    """

    def __init__(
        self,
        crowd: Crowd,
        world: World,
        goal: Array,
        stop_on_arrival: bool,
        time_limit: float,
        start: HerdState | None = None,
    ) -> None:
        """Start from a herd, by default that of `world.start`, see `Simulation`; goal (2,) [m]."""
        self.world = world
        self.paused = False
        self._crowd = crowd
        self._first_goal = self._goal = goal
        self._stop_on_arrival = stop_on_arrival
        self._time_limit = time_limit
        self._start = start
        self.restart()

    def restart(self) -> None:
        """Start again from the same state at time 0; the goal stays where it was moved to."""
        self.simulation = Simulation(self._crowd, self.world, self._first_goal, self._start)
        self.simulation.goal = self._goal
        self.outcome = ''
        """How the run ended; '' before."""
        self.failed = False
        """Whether it ended because a step could not be taken."""

    @property
    def goal(self) -> Array:
        """The destination (2,) [m]."""
        return self._goal

    def move_goal(self, goal: Array) -> None:
        """Judge by another goal (2,) [m] from now on."""
        self._goal = self.simulation.goal = goal
        self.outcome, self.failed = '', False

    def change_crowd(self, crowd: Crowd) -> None:
        """Move like another crowd from the next step on."""
        self._crowd = self.simulation.crowd = crowd
        if self.failed:
            self.outcome, self.failed = '', False

    @property
    def now(self) -> int:
        """Simulated time [ns]."""
        return self.simulation.nanoseconds

    @property
    def finished(self) -> bool:
        """Whether the run is over."""
        return bool(self.outcome)

    @property
    def stands(self) -> bool:
        """Whether nothing moves, whatever is commanded."""
        return self.paused or self.finished

    def advance(self, u: Array) -> None:
        """Move on by one control period under the dogs' velocities u (M, 2) [m/s]."""
        try:
            self.simulation.advance(np.asarray(u))
        except Exception as error:
            self.failed = True
            self.outcome = f'the herd stands, since a step could not be taken: {error}'
            return
        seconds, limit = self.now * 1e-9, self._time_limit
        if self._stop_on_arrival and self.simulation.arrived:
            self.outcome = f'the flock arrived after {seconds:.1f} s'
        elif limit and seconds > limit - 0.5 * self.world.control_period:
            self.outcome = f'the flock did not arrive within {limit:g} s'
