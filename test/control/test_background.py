# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import threading
import time

from herding_ros.control.background import StepTimes, Work
from herding_ros.control.solution import NoTimeFor
import pytest


class Hours:
    """A clock that is set by hand, and work with steps that take so long."""

    def __init__(self, *steps: float, **kinds: float) -> None:
        self.time = 0.0
        self.steps = [('step', length) for length in steps] or list(kinds.items())

    def now(self) -> float:
        return self.time

    def work(self, no_time_for: NoTimeFor) -> int:
        for done, (kind, length) in enumerate(self.steps):
            if no_time_for(kind):
                return done
            self.time += length
        return len(self.steps)


def finished(work: Work[int]) -> Work[int]:
    end = time.monotonic() + 10.0
    while not work.done:
        assert time.monotonic() < end
        time.sleep(0.001)
    return work


def no_times(guess: float = 0.5) -> StepTimes:
    """Times of nothing yet, none of which will be cut."""
    return StepTimes(guess, 1e9)


def test_work_that_is_quick_is_done() -> None:
    hours = Hours(1.0, 1.0, 1.0, 1.0, 1.0)
    work = finished(Work(hours.work, 10.0, hours.now, no_times()))
    assert work.result == 5
    assert work.margin == 5.0
    hours.time = 9.0
    assert work.margin == 5.0


def test_slow_work_ends_before_a_step_that_would_be_late() -> None:
    hours = Hours(*[3.0] * 100)
    work = finished(Work(hours.work, 10.0, hours.now, no_times()))
    assert work.result == 3  # the fourth would end at 12
    assert work.margin == 1.0


def test_what_was_never_seen_takes_as_long_as_was_guessed() -> None:
    for guess, done in [(0.5, 2), (8.0, 2), (8.1, 1)]:
        hours = Hours(first=2.0, second=1.0)
        assert finished(Work(hours.work, 10.0, hours.now, no_times(guess))).result == done


def test_there_is_time_to_spare_at_the_end() -> None:
    for spare, done in [(0.0, 4), (0.1, 3), (2.0, 3), (2.1, 2)]:
        hours = Hours(*[2.0] * 100)
        work = finished(Work(hours.work, 8.0, hours.now, no_times(), spare))
        assert work.result == done


def test_each_kind_of_step_takes_its_own_time() -> None:
    """Short steps go on until the end, though a long one would be late by far."""
    times = no_times()
    hours = Hours(short=1.0, long=8.0)
    assert finished(Work(hours.work, 10.0, hours.now, times)).result == 2
    hours.steps = [('short', 1.0), ('long', 8.0)]
    hours.time = 3.0
    assert finished(Work(hours.work, 10.0, hours.now, times)).result == 1
    hours.steps = [('short', 1.0)] * 100
    hours.time = 3.0
    work = finished(Work(hours.work, 10.0, hours.now, times))
    assert work.result == 7
    assert work.margin == 0.0


def test_last_step_of_a_work_counts_in_the_next_one() -> None:
    """As when a plan ends with its first look at the fine model, and the next one begins late."""
    times = no_times()
    hours = Hours(quick=1.0, last=6.0)
    finished(Work(hours.work, 10.0, hours.now, times))
    assert times.expected('last') == 6.0
    hours.steps = [('quick', 1.0)] * 4 + [('last', 6.0)]
    hours.time = 0.0
    work = finished(Work(hours.work, 8.0, hours.now, times))
    assert work.result == 4
    assert work.margin == 4.0


def test_step_that_was_held_up_once_is_forgotten_in_time() -> None:
    times = no_times()
    times.record('step', 100.0)
    times.record('dear', 50.0)
    expected = []
    for _ in range(30):
        times.begin()
        times.record('step', 1.0)
        expected.append(times.expected('step'))
    assert expected[:2] == pytest.approx([100.0, 80.0])
    assert expected == sorted(expected, reverse=True)
    assert expected[-1] == 1.0
    assert 25.0 < times.expected('dear') < 30.0  # nobody has seen that it takes less


def test_who_was_stopped_for_an_hour_goes_on_as_before() -> None:
    """A step that took longer than there ever is time for is not given up: it is seen again."""
    times = StepTimes(0.5, most=10.0)
    hours = Hours(3600.0)
    assert finished(Work(hours.work, 10.0, hours.now, times)).margin < -3000.0
    done = []
    for k in range(1, 20):
        start = 10_000.0 * k
        hours.time = start - 10.0
        hours.steps = [('step', 1.0)] * 8
        work = finished(Work(hours.work, start, hours.now, times))
        assert work.margin >= 0.0
        done.append(work.result)
    assert done[0] == 1
    assert done == sorted(done)
    assert done[10:] == [8] * 9


def test_done_at_the_start_is_in_time() -> None:
    """To rounding errors: 0.1 + 0.2 is more than 0.3."""
    hours = Hours(0.1, 0.2)
    work = finished(Work(hours.work, 0.3, hours.now, no_times(0.0)))
    assert work.result == 2
    assert hours.time > work.start
    assert work.margin == 0.0


def test_dropped_work_ends() -> None:
    begun, dropped = threading.Event(), threading.Event()

    def endless(no_time_for: NoTimeFor) -> int:
        steps = 0
        while not no_time_for('step'):
            begun.set()
            dropped.wait(10.0)
            steps += 1
        return steps

    work = Work(endless, 1e9, lambda: 0.0, no_times())
    assert begun.wait(10.0)
    assert not work.done
    work.drop()
    dropped.set()
    assert finished(work).result == 1


def test_error_is_a_result() -> None:
    def fail(no_time_for: NoTimeFor) -> int:
        raise RuntimeError('no')

    work = finished(Work(fail, 1.0, lambda: 0.0, no_times()))
    assert work.result is None
    assert str(work.error) == 'no'
