# SPDX-License-Identifier: Apache-2.0
"""The log times of a recording: when messages came in, by the simulation's clock if any."""

from __future__ import annotations

from ..bag.writer import LAST_TIME_NS
from .refusals import Refused
from .wire import Reader


class LogClock:
    """The time of a simulation as its messages on /clock give it; it never goes back.

    A reset of the simulation sets its clock back; a bag whose times went back as well would play
    both runs at once.
    """

    def __init__(self) -> None:
        self._clock_ns: int | None = None  # the last /clock
        self._time_ns = 0

    @property
    def is_known(self) -> bool:
        """Whether there has been a /clock."""
        return self._clock_ns is not None

    def follow(self, data: bytes) -> None:
        """Take a serialised message of /clock; raises Refused when it is not a time."""
        seconds, nanoseconds = Reader(data).numbers('iI')
        if seconds < 0 or nanoseconds >= 1_000_000_000:
            raise Refused('no time', f'{seconds} s and {nanoseconds} ns are not a time')
        clock_ns = int(seconds * 1_000_000_000 + nanoseconds)
        last_ns = 0 if self._clock_ns is None else self._clock_ns
        self._time_ns = min(self._time_ns + max(clock_ns - last_ns, 0), LAST_TIME_NS)
        self._clock_ns = clock_ns

    def log_time(self, receive_ns: int) -> int:
        """Return the log time [ns] of a message that came in at this wall time [ns]."""
        return self._time_ns if self.is_known else receive_ns
