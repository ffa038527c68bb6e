"""One piece of work in the background, with a deadline."""

from __future__ import annotations

from collections.abc import Callable
import threading
from typing import Generic, TypeVar

from herding_ros.control.solution import NoTimeFor

_T = TypeVar('_T')

_FADING = 0.8
"""By how much less a step counts once others of its kind were seen in a later work."""

_DOUBT = 0.98
"""The same if none was: one that was held up once shall not be left out for good."""


class StepTimes:
    """How long steps of each kind take at most [s], as seen of late; what was not seen is a guess.

    A plan that is made in time says little about the next one, whose dearest steps it may not have
    needed: so this is carried from work to work. None counts for more than `most` [s], however
    long a process was stopped.
    """

    def __init__(self, guess: float, most: float) -> None:
        self._guess, self._most = guess, most
        self._before: dict[str, float] = {}
        self._seen: dict[str, float] = {}  # in the present work

    def begin(self) -> None:
        """Begin another work: let a step that was held up once be forgotten in time."""
        for step in {*self._before, *self._seen}:
            fading = _FADING if step in self._seen else _DOUBT
            before = fading * self._before.get(step, 0.0)
            self._before[step] = max(self._seen.get(step, 0.0), before)
        self._seen = {}

    def saw(self, step: str, seconds: float) -> None:
        """Take note of a step."""
        self._seen[step] = max(self._seen.get(step, 0.0), min(seconds, self._most))

    def expected(self, step: str) -> float:
        """Return the time that a step of this kind may take [s]."""
        known = [times[step] for times in (self._before, self._seen) if step in times]
        return max(known, default=self._guess)


class Work(Generic[_T]):
    """Runs work(no_time_for) in a thread, for something that begins at `start` [s].

    `now` tells the time [s]. no_time_for(step) says True, and the work shall return the best that
    it has, once it is dropped or when a step of this kind might end later than `spare` [s] before
    the start. There is always time for the first step, or nobody would see how long it takes. The
    thread does not keep the process from ending.
    """

    def __init__(
        self,
        work: Callable[[NoTimeFor], _T],
        start: float,
        now: Callable[[], float],
        times: StepTimes,
        spare: float = 0.0,
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
        self._dropped = threading.Event()
        self._ended: float | None = None
        self._thread = threading.Thread(target=self._run, name='planner', daemon=True)
        self._thread.start()

    def drop(self) -> None:
        """Ask it to end, nobody wants the result any more."""
        self._dropped.set()

    @property
    def dropped(self) -> bool:
        """Whether nobody wants the result."""
        return self._dropped.is_set()

    @property
    def done(self) -> bool:
        """Whether there is a result or an error."""
        return not self._thread.is_alive()

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
        self._ended = self._now()
        self._end_step(self._ended)

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
            self._times.saw(self._step, now - self._begun)
            self._step = None
