# SPDX-License-Identifier: Apache-2.0
"""When the sim moves on: in lockstep with the commands, or in real time."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Protocol

from herding_ros.model.state import Array
from rclpy.clock import Clock, ClockType
from rclpy.timer import Timer

from .dog_commands import DogCommands
from .herding_node import HerdingNode
from .inbox import LOCKSTEP_TURN
from .simulated_run import SimulatedRun

CATCH_UP = 1.0
"""In real time a sim that was held up makes up for so much; what is more is skipped [s]."""

_NEWCOMER_PERIOD = 1.0
"""Time between two checks for controllers that have not received the state [s]."""


class Pace(Protocol):
    """Advances a run by the commands of its dogs."""

    skipped: int
    """Control periods that came too late."""

    def notice_change(self) -> None:
        """Call after the goal was moved, or a pause begun or ended."""


class Lockstep:
    """Advances as soon as every dog has the command that replies to the published state."""

    skipped = 0

    def __init__(
        self,
        node: HerdingNode,
        run: SimulatedRun,
        commands: DogCommands,
        advance: Callable[[Array], None],
        publish_state: Callable[[], None],
    ) -> None:
        """Begin; `advance` moves the run and publishes its state, `publish_state` repeats it."""
        self._run = run
        self._commands = commands
        self._advance = advance
        self._publish_state = publish_state
        self._seen, self._at_last_check = commands.publishers(), 0
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_NEWCOMER_PERIOD, self._show_newcomers, clock=wall)
        node.create_timer(0.0, self._keep_in_step, clock=wall)

    def _keep_in_step(self) -> None:
        """Advance as commands come, the last dog's last; the executor does all else in between."""
        for _ in self._commands.arrivals(LOCKSTEP_TURN):
            self.notice_change()

    def notice_change(self) -> None:
        """Advance if all commands are there and nothing prevents it."""
        self._commands.take(self._run.now)
        u = self._commands.complete()
        if u is not None and not self._run.stands:
            self._advance(u)
            if not self._run.failed:  # else they are still needed, once a step can be taken
                self._commands.forget()

    def _show_newcomers(self) -> None:
        """Repeat the state for a controller in place of a dead one, until one replies."""
        publishers, periods = self._commands.publishers(), self._run.simulation.periods
        if periods != self._at_last_check:
            self._seen, self._at_last_check = publishers, periods
        elif self._commands.missing and publishers - self._seen:
            self._publish_state()


class RealTime:
    """Advances at a multiple of real time; a dog without a recent command stands."""

    def __init__(
        self,
        node: HerdingNode,
        run: SimulatedRun,
        commands: DogCommands,
        advance: Callable[[Array], None],
        factor: float,
    ) -> None:
        """Begin at `factor` times real time; `advance` moves the run and publishes its state."""
        self.skipped = 0
        self._node = node
        self._run = run
        self._commands = commands
        self._advance = advance
        self._timer: Timer | None = None
        self._factor = 0.0
        self.set_factor(factor)

    def set_factor(self, factor: float) -> None:
        """Advance at `factor` times real time from now on."""
        if factor == self._factor:  # a timer that is made anew has its first tick to wait for
            return
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        self._factor = factor
        self._period = self._run.world.control_period / factor
        # Half-way between two ticks, so that each finds one period due.
        self._due = time.monotonic() + 0.5 * self._period
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self._node.create_timer(self._period, self._make_due_periods, clock=wall)

    def notice_change(self) -> None:
        """Do nothing: the next tick comes anyway."""

    def _make_due_periods(self) -> None:
        """Make one period, or more when the last tick came late."""
        now = time.monotonic()
        self._skip_before(now - CATCH_UP)
        while self._due <= now and time.monotonic() < now + LOCKSTEP_TURN:
            self._due += self._period
            self._commands.take(self._run.now)
            if not self._run.stands:
                self._advance(self._commands.recent(self._run.now))

    def _skip_before(self, limit: float) -> None:
        """Skip the periods that were due before a time of the wall clock."""
        periods = int((limit - self._due) / self._period)
        if periods <= 0:
            return
        self._due += periods * self._period
        self.skipped += periods
        self._node.get_logger().warning(
            f'{periods} control periods came too late and are skipped; '
            f'lower real_time_factor ({self._factor:g})',
            throttle_duration_sec=10.0,
        )
