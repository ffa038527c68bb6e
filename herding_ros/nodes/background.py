"""One piece of work in the background, with a deadline."""

from __future__ import annotations

from collections.abc import Callable
import threading
from typing import Generic, TypeVar

from herding_ros.control.solution import OutOfTime

_T = TypeVar('_T')


class Work(Generic[_T]):
    """Runs work(out_of_time) in a thread, for something that begins at `start` [s].

    `now` tells the time [s]. out_of_time says True, and the work shall return the best that it
    has, once it is dropped or when another step might end after the start: one as long as the
    longest so far, between two questions, or `reserve` [s] if that is more. The thread does not
    keep the process from ending.
    """

    def __init__(
        self,
        work: Callable[[OutOfTime], _T],
        start: float,
        now: Callable[[], float],
        reserve: float,
    ) -> None:
        self.start = start
        self.result: _T | None = None
        self.error: Exception | None = None
        self._work = work
        self._now = now
        self._asked = now()
        self._reserve = reserve
        self.longest_step = 0.0
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
        return self.start - (self._now() if self._ended is None else self._ended)

    def _run(self) -> None:
        try:
            self.result = self._work(self._is_out_of_time)
        except Exception as error:
            self.error = error
        self._ended = self._now()

    def _is_out_of_time(self) -> bool:
        now = self._now()
        self.longest_step = max(self.longest_step, now - self._asked)
        self._asked = now
        return self.dropped or now + max(self.longest_step, self._reserve) >= self.start
