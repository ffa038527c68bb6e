# SPDX-License-Identifier: Apache-2.0
"""A pilot that keeps its own time: it gives commands and plans ahead in the background."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

from herding_ros.model.dynamics import rollout
from herding_ros.model.state import HerdState
import numpy as np

from .background import Run, run_in_thread, StepTimes, WHOLE, Work
from .parameters import MOST_INTERVALS, Timing
from .pilot import (
    Announcement,
    Clock,
    Condition,
    Decision,
    Observed,
    Pilot,
    Planner,
)
from .plan import SLACK
from .schedule import Request, Schedule, ScheduledPlan
from .solution import NoTimeFor
from .window import Window

_SPARE = 0.1
"""Part of the lead that a solve leaves: /clock may arrive late, and a plan be taken late."""


@dataclass(frozen=True)
class _Task:
    """What is being planned: a window or a feedback, and the time at which it is to start [s]."""

    work: Work[ScheduledPlan]
    start: float
    is_feedback: bool

    @property
    def margin(self) -> float:
        """Time [s] by which it was done before its start; until then, the time that is left."""
        return self.work.margin + (self.start - self.work.start)


class RealTimePilot(Pilot):
    """Gives a command at every control period, while the next plan is made in the background.

    A window is begun `lead` before the accepted part of the last one is over, from the state that
    is predicted for its start. If it is late, the last plan is played to its end; then the dogs
    stand.

    A moved goal, a dog that falls silent or one that returns do not touch the plans there are:
    they make the pilot begin another window, unless the last one was made for just that. So the
    plan in play is never older than the accepted part of a window or twice the lead, whichever is
    longer, as long as solves keep their deadlines, at whatever rate such events come.

    In between, the plan in play is improved: whenever the observation that it was made from is
    `horizon.feedback` old, and at once on a surprise. A feedback starts after the time that recent
    ones took, at least one control period; it is begun only if it ends before a window is due,
    and dropped if it does not. One that is late is played from where it should be.
    """

    def __init__(
        self, planner: Planner, dogs: int, timing: Timing, clock: Clock, run: Run = run_in_thread
    ) -> None:
        """Plan by `planner`, not to be used elsewhere, for so many dogs, each solve by `run`.

        Raises ValueError if the lead is longer than any window.
        """
        period = planner.control.horizon.control_period
        if timing.lead > MOST_INTERVALS * period:
            raise ValueError(
                f'lead must be at most {MOST_INTERVALS} times control_period, {period!r}, '
                f'got {timing.lead!r}'
            )
        self._timing = timing
        self._clock = clock
        self._run = run
        self._step_times = StepTimes(guess=0.25 * timing.lead, most=timing.lead)
        self._feedback_times = StepTimes(guess=0.0, most=timing.lead)
        self._task: _Task | None = None
        self._late: _Task | None = None  # the last window that missed its deadline
        self._commanding = False
        super().__init__(planner, dogs)

    def _start_afresh(self) -> None:
        super()._start_afresh()
        self._schedule = Schedule()
        self._first_observation = math.inf
        self._lost = False
        if self._task is not None:
            self._task.work.drop()

    def decide(self, t: float, observed: Observed | None) -> Decision:
        """Return the command for t [s], given the recent observation, if there is one."""
        t = self._advance_to(t)
        self._lost = observed is None
        announcement = self._take_plan(t)
        if observed is not None:
            self._plan_ahead(self._observe(observed), t)
        self._schedule.forget_before(t)
        self._commanding = self._commanding or self._schedule.playing(t) is not None
        if not self._commanding:
            return self._decision(None, announcement)
        if self._lost or self.estimate is None:
            return self._decision(np.zeros((self.dogs, 2)), announcement)
        asked = self._schedule.velocities(t, self.dogs)
        return self._decision(self._filtered(asked, self.estimate), announcement)

    def condition(self, t: float) -> Condition:
        """Return what the pilot is doing at t [s]."""
        playing = self._schedule.playing(t)
        if self._lost or self.estimate is None:
            return Condition('standing: no sheep or no dogs in sight', False)
        if playing is None:
            return Condition('standing: the first plan is not ready yet', True)
        if t >= playing.end:
            return Condition('standing: the plan is over and the next is not ready yet', False)
        if t >= playing.accepted_until:
            return Condition('playing the second half: the next plan is late', False)
        return Condition('playing a plan', not (self.silent_dogs or self.disobedient_dogs))

    # Planning ahead.

    def _plan_ahead(self, estimate: Observed, t: float) -> None:
        self._first_observation = min(self._first_observation, t)
        waited = t - self._first_observation
        if len(estimate.dogs) < self.dogs and waited <= self._timing.state_timeout:
            return  # the odometry of the others may only need a moment more
        self._notice_dogs(self._seen)
        task = self._task
        start = self._start_of_window(Request(self._goal, estimate.dogs), t)
        if start is not None:
            if task is None:
                self._begin_window(estimate, start)
            elif task.is_feedback:
                task.work.drop()  # to make room
        elif task is None:
            self._begin_feedback_if_due(estimate, t)

    def _notice_dogs(self, dogs: tuple[int, ...]) -> None:
        if dogs == self._visible:
            return
        returned = len(dogs) > len(self._visible) > 0
        self._visible = dogs
        if silent := ', '.join(self.silent_dogs):
            self._say('warning', f'no odometry from {silent}: planning without')
        elif returned:
            self._say('info', 'odometry from all dogs again')

    def _start_of_window(self, request: Request, t: float) -> float | None:
        """Return when the next window is to start, if it is time to begin it; else None."""
        lead, last = self._timing.lead, self._schedule.last
        soonest = t + self._in_periods(lead)
        if last is None or last.request != request:
            return soonest
        end = last.accepted_until
        if t < end - lead - SLACK:
            return None
        # The windows join, unless too little of the lead is left for a plan to be ready.
        return end if t + 0.5 * lead <= end else soonest

    def _in_periods(self, seconds: float) -> float:
        """Return a time [s] rounded up to whole control periods."""
        return self._period * math.ceil((seconds - SLACK) / self._period)

    def _begin_window(self, estimate: Observed, start: float) -> None:
        """Plan the window from `start` [s] on."""
        spare = max(_SPARE * self._timing.lead, self._period)
        accepted_until = start + self._control.horizon.accepted
        plan = self._planning(self._planner.solve, estimate, start, accepted_until)
        work = Work(plan, start, self._clock, self._step_times, spare, self._run)
        self._task = _Task(work, start, is_feedback=False)

    def _begin_feedback_if_due(self, estimate: Observed, t: float) -> None:
        """Improve the plan in play, if it is time and there is time before the next window."""
        times, last = self._feedback_times, self._schedule.last
        start = t + max(self._in_periods(times.expected(WHOLE)), self._period)
        playing = self._schedule.playing(start)
        if last is None or playing is None or not self._is_feedback_due(playing, estimate):
            return
        latest = last.accepted_until - self._timing.lead
        if last is not playing:
            latest = min(latest, last.start)
        if start > latest + SLACK:
            return
        end = min(max(start, t + self._control.horizon.feedback), latest)
        plan = self._planning(self._planner.improve, estimate, start, playing.accepted_until)
        work = Work(plan, end, self._clock, times, run=self._run)
        self._task = _Task(work, start, is_feedback=True)

    def _planning(
        self,
        make: Callable[[HerdState, float, NoTimeFor], Window],
        estimate: Observed,
        start: float,
        accepted_until: float,
    ) -> Callable[[NoTimeFor], ScheduledPlan]:
        """Return the work of making a plan that starts at `start` [s], from the state then."""
        periods = round((start - estimate.t) / self._period)
        times = estimate.t + self._period * np.arange(periods)
        u = np.array([self._schedule.velocities(t, self.dogs) for t in times])
        self._prepare_planner()
        request = Request(self._goal, estimate.dogs)
        crowd, horizon, motion = self._crowd, self._control.horizon, self._control.motion

        def plan(no_time_for: NoTimeFor) -> ScheduledPlan:
            state: HerdState = estimate.state
            self._planner.learn(state, estimate.t)
            if periods > 0:
                commanded = u[:, list(estimate.dogs)]
                state = rollout(
                    crowd, state, commanded, horizon.dt, horizon.substeps, motion=motion
                ).at(-1)
            window = make(state, start, lambda step: self._stopping.is_set() or no_time_for(step))
            return ScheduledPlan(window, request, estimate.t, accepted_until)

        return plan

    def _take_plan(self, t: float) -> Announcement | None:
        """Schedule the plan that has been made; count a window once when it is late."""
        task = self._task
        if task is None:
            return None
        work = task.work
        if not task.is_feedback and task.margin < 0.0 and not work.dropped:
            self._count_as_late(task)
        if not work.done:
            return None
        self._task = None
        if work.error is not None:
            self._record_failure(work.error)
        elif work.result is not None and not work.dropped:
            return self._add(work.result, task.margin, t)
        return None

    def _add(self, plan: ScheduledPlan, margin: float, t: float) -> Announcement | None:
        """Schedule a plan, unless one that starts after it is played already."""
        playing = self._schedule.playing(t)
        if playing is not None and playing.start > plan.start + SLACK:
            return None
        self._schedule.add(plan)
        return self._announce(plan, margin)

    def _count_as_late(self, task: _Task) -> None:
        if task is self._late:
            return
        self._late = task
        self.deadlines_missed += 1
        self._say(
            'warning',
            f'a plan is late, the last one is played on; raise lead ({self._timing.lead:g} s) '
            'or mapping.standard_error, or lower mapping.paths',
        )
