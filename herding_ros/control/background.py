# SPDX-License-Identifier: Apache-2.0
"""One piece of work in the background, with a deadline."""

from __future__ import annotations

from collections.abc import Callable
import threading
from typing import Generic, TypeVar

from .solution import NoTimeFor

_T = TypeVar('_T')

Run = Callable[[Callable[[], None]], None]
"""Starts a function that goes on by itself."""

_FADING = 0.8
"""Factor on the duration of a step once shorter ones of its kind were seen in a later work."""

_DOUBT = 0.98
"""The same if none was: a step that was held up once must not be left out for good."""


def run_in_thread(function: Callable[[], None]) -> None:
    """Run the function in a thread, which does not keep the process from ending."""
    threading.Thread(target=function, name='planner', daemon=True).start()


WHOLE = 'whole'
"""A kind of step, for `StepTimes`: all of a work."""


class StepTimes:
    """The longest recent duration of each kind of step [s]; a guess before the first.

    A plan that was made in time may not have needed its most expensive kind of step, so
    durations are carried from work to work. None counts for more than `most` [s], however long
    the process was stopped.
    """

    def __init__(self, guess: float, most: float) -> None:
        self._guess, self._most = guess, most
        self._before: dict[str, float] = {}
        self._seen: dict[str, float] = {}  # in the present work

    def begin(self) -> None:
        """Begin another work, in which earlier durations count for less."""
        for step in {*self._before, *self._seen}:
            fading = _FADING if step in self._seen else _DOUBT
            before = fading * self._before.get(step, 0.0)
            self._before[step] = max(self._seen.get(step, 0.0), before)
        self._seen = {}

    def record(self, step: str, seconds: float) -> None:
        """Record the duration of a step."""
        self._seen[step] = max(self._seen.get(step, 0.0), min(seconds, self._most))

    def expected(self, step: str) -> float:
        """Return the time that a step of this kind may take [s]."""
        recorded = [times[step] for times in (self._before, self._seen) if step in times]
        return max(recorded, default=self._guess)


class Work(Generic[_T]):
    """Runs work(no_time_for) in the background; its result is needed at `start` [s].

    `now` returns the time [s]. no_time_for(step) is True, and the work must return its best
    result so far, once the work is dropped or when a step of this kind might end later than
    `spare` [s] before the start. There is always time for the first step, whose duration would
    otherwise never be measured.
    """

    def __init__(
        self,
        work: Callable[[NoTimeFor], _T],
        start: float,
        now: Callable[[], float],
        times: StepTimes,
        spare: float = 0.0,
        run: Run = run_in_thread,
    ) -> None:
        self.start = start
        self.result: _T | None = None
        self.error: Exception | None = None
        self._work = work
        self._now = now
        self._times = times
        self._spare = spare
        self._steps = 0
        self._step: str | None = None  # that is under way
        self._begun = 0.0  # when it was
        self._created = now()
        self._dropped = threading.Event()
        self._ended: float | None = None
        run(self._run)

    def drop(self) -> None:
        """Ask it to end early; its result is not needed any more."""
        self._dropped.set()

    @property
    def dropped(self) -> bool:
        """Whether the result is not needed any more."""
        return self._dropped.is_set()

    @property
    def done(self) -> bool:
        """Whether there is a result or an error."""
        return self._ended is not None

    @property
    def margin(self) -> float:
        """Time [s] by which it was done before the start; until then, the time that is left."""
        # Whole nanoseconds: what is done at the start, to rounding errors, is in time.
        return round(self.start - (self._now() if self._ended is None else self._ended), 9)

    def _run(self) -> None:
        self._times.begin()
        try:
            self.result = self._work(self._has_no_time_for)
        except Exception as error:
            self.error = error
        ended = self._now()
        self._end_step(ended)
        self._times.record(WHOLE, ended - self._created)
        self._ended = ended

    def _has_no_time_for(self, step: str) -> bool:
        now = self._now()
        self._end_step(now)
        late = now + self._times.expected(step) + self._spare > self.start
        if self.dropped or (late and self._steps):
            return True
        self._steps += 1
        self._step, self._begun = step, now
        return False

    def _end_step(self, now: float) -> None:
        if self._step is not None:
            self._times.record(self._step, now - self._begun)
            self._step = None
