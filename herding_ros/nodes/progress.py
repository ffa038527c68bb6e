# SPDX-License-Identifier: Apache-2.0
"""How a herding goes: followed on /diagnostics, shown in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rich.console import Console
from rich.live import Live
from rich.text import Text

_LIVE_PERIOD, _LINE_PERIOD = 0.2, 5.0
"""Time between two lines on a terminal, where they replace each other, and elsewhere [s]."""

_OF_SIM = ('time_s', 'distance_m', 'spread_m')


def _has_numbers(values: dict[str, str], *names: str) -> bool:
    """Whether these are numbers: other programs may use the names of our statuses."""
    try:
        for name in names:
            float(values[name])
    except (KeyError, ValueError):
        return False
    return True


class Watcher(Node):
    """Follows /diagnostics."""

    def __init__(self) -> None:
        """Subscribe."""
        super().__init__('herd')
        self.sim: dict[str, str] = {}
        self.plan: dict[str, str] = {}
        self.recorder: dict[str, str] = {}
        self.page = ''
        """Where the view shows it; '' before there is one."""
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 100)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if status.name == 'sim: herd' and _has_numbers(values, *_OF_SIM):
                self.sim = values
            elif status.name == 'controller: plan' and _has_numbers(values, 'solve_ms'):
                self.plan = values
            elif status.name == 'recorder: bag':
                self.recorder = values
            elif status.name == 'view: page':
                self.page = values.get('url', '')

    @property
    def parameters_recorded(self) -> bool:
        """Whether the recorder has received the parameters of sim and controller."""
        return {'/sim', '/controller'} <= set(self.recorder.get('parameters_of', '').split())

    @property
    def finished(self) -> bool:
        """Whether the sim stands still for good."""
        return self.sim.get('finished') == 'True'

    @property
    def arrived(self) -> bool:
        """Whether it does so because the flock is home."""
        return self.sim.get('arrived') == 'True'

    @property
    def outcome(self) -> str:
        """How the run ended, in words; '' before."""
        return self.sim.get('outcome', '')

    @property
    def time(self) -> float:
        """Simulated time of the newest status [s]."""
        return float(self.sim['time_s'])


class ProgressLine:
    """One live line on a terminal; in files and pipes one at first and every few seconds."""

    def __init__(self, watcher: Watcher, console: Console) -> None:
        """Show what `watcher` has received."""
        self._watcher = watcher
        self._console = console
        self._live: Live | None = None
        self._shown = self._begun = time.monotonic()
        self._first_time = 0.0

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Keep the terminal's line within this context."""
        if not self._console.is_terminal:
            yield
            return
        with Live(console=self._console, auto_refresh=False) as self._live:
            yield

    def update(self, now: float, at_once: bool = False) -> None:
        """Show a new line at `now`, of the monotonic clock [s], if it is time to, or at once."""
        if not self._watcher.sim:
            self._begun = now
        elif not self._first_time:
            self._first_time = max(self._watcher.time, 1e-9)
            at_once = True
        if not at_once and now - self._shown <= (_LIVE_PERIOD if self._live else _LINE_PERIOD):
            return
        self._shown = now
        elapsed = now - self._begun
        if self._live:
            line = self._line(elapsed)
            if len(line) > self._console.width:
                line = self._short_line(elapsed)
            self._live.update(Text(line, no_wrap=True), refresh=True)
        else:
            self._console.print(Text(self._line(elapsed)), soft_wrap=True)

    def _line(self, elapsed: float) -> str:
        watcher = self._watcher
        if not watcher.sim:
            return self._short_line(elapsed)
        distance, spread = (float(watcher.sim[key]) for key in ('distance_m', 'spread_m'))
        solve = f'{float(watcher.plan["solve_ms"]):.0f} ms' if watcher.plan else '-'
        return (
            f't {watcher.time:5.1f} s  to go {distance:5.3f} m  spread {spread:5.3f} m  '
            f'solve {solve:>6}  {self._pace(elapsed)} x real time'
        )

    def _short_line(self, elapsed: float) -> str:
        """Return a line for a terminal of 40 columns."""
        watcher = self._watcher
        if not watcher.sim:
            return 'starting the nodes ...'
        to_go = f'{float(watcher.sim["distance_m"]):5.3f} m to go'
        return f'{watcher.time:5.1f} s  {to_go}  {self._pace(elapsed)} x'

    def _pace(self, elapsed: float) -> str:
        """Return simulated seconds per second."""
        simulated = self._watcher.time - self._first_time
        return f'{simulated / elapsed:4.1f}' if simulated > 0.0 else '   -'
