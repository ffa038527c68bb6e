from __future__ import annotations

import threading

from herding_ros.control.solution import OutOfTime
from herding_ros.nodes.background import Work


class Hours:
    """A clock that is set by hand, and work that takes so many steps of so long."""

    def __init__(self, step: float, steps: int) -> None:
        self.time = 0.0
        self.step = step
        self.left = steps

    def now(self) -> float:
        return self.time

    def work(self, out_of_time: OutOfTime) -> int:
        done = 0
        while self.left and not out_of_time():
            self.time += self.step
            self.left -= 1
            done += 1
        return done


def finished(work: Work[int]) -> Work[int]:
    work._thread.join(10.0)
    assert work.done
    return work


def test_work_that_is_quick_is_done() -> None:
    hours = Hours(step=1.0, steps=5)
    work = finished(Work(hours.work, 10.0, hours.now, 0.5))
    assert work.result == 5
    assert work.margin == 5.0
    hours.time = 9.0
    assert work.margin == 5.0


def test_slow_work_ends_before_a_step_that_would_be_late() -> None:
    hours = Hours(step=3.0, steps=100)
    work = finished(Work(hours.work, 10.0, hours.now, 0.5))
    assert work.result == 3  # the fourth would end at 12
    assert work.margin == 1.0
    assert work.longest_step == 3.0


def test_reserve_counts_from_the_first_step_on() -> None:
    hours = Hours(step=8.0, steps=100)
    assert finished(Work(hours.work, 10.0, hours.now, 0.5)).margin == 2.0
    hours.time = 4.0
    assert finished(Work(hours.work, 10.0, hours.now, 8.0)).result == 0


def test_dropped_work_ends() -> None:
    begun, dropped = threading.Event(), threading.Event()

    def endless(out_of_time: OutOfTime) -> int:
        steps = 0
        while not out_of_time():
            begun.set()
            dropped.wait(10.0)
            steps += 1
        return steps

    work = Work(endless, 1e9, lambda: 0.0, 0.0)
    assert begun.wait(10.0)
    assert not work.done
    work.drop()
    dropped.set()
    assert finished(work).result == 1


def test_error_is_a_result() -> None:
    def fail(out_of_time: OutOfTime) -> int:
        raise RuntimeError('no')

    work = finished(Work(fail, 1.0, lambda: 0.0, 0.0))
    assert work.result is None
    assert str(work.error) == 'no'
