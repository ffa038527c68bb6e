# SPDX-License-Identifier: Apache-2.0
"""A pilot that keeps its own time: it gives commands and plans ahead in the background."""

from __future__ import annotations

import math

from herding_ros.model.dynamics import rollout
from herding_ros.model.state import HerdState
import numpy as np

from .background import Run, run_in_thread, StepTimes, Work
from .parameters import MOST_INTERVALS, Timing
from .pilot import (
    Announcement,
    Clock,
    Condition,
    Decision,
    Observed,
    Pilot,
    Planner,
    SLACK,
)
from .schedule import Request, Schedule, ScheduledPlan
from .solution import NoTimeFor

_SPARE = 0.1
"""Part of the lead that a solve leaves: /clock may arrive late, and a plan be taken late."""


class RealTimePilot(Pilot):
    """Gives a command at every control period, while the next plan is made in the background.

    A plan is begun `lead` before the accepted part of the last one is over, from the state that
    is predicted for its start. If it is late, the last plan is played to its end; then the dogs
    stand.

    A moved goal, a dog that falls silent or one that returns do not touch the plans there are:
    they make the pilot begin another, unless the last one was made for just that. So the plan in
    play is never older than the accepted part of a window or twice the lead, whichever is longer,
    as long as solves keep their deadlines, at whatever rate such events come.
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
        self._work: Work[ScheduledPlan] | None = None  # the plan that is being made
        self._late: Work[ScheduledPlan] | None = None  # the last one that missed its deadline
        self._commanding = False
        super().__init__(planner, dogs)

    def _start_afresh(self) -> None:
        super()._start_afresh()
        self._schedule = Schedule()
        self._first_observation = math.inf
        self._lost = False
        if self._work is not None:
            self._work.drop()

    def decide(self, t: float, observed: Observed | None) -> Decision:
        """Return the command for t [s], given the recent observation, if there is one."""
        t = self._advance_to(t)
        self._lost = observed is None
        announcement = self._take_plan()
        if observed is not None:
            self._plan_ahead(self._observe(observed), t)
        self._schedule.forget_before(t)
        self._commanding = self._commanding or self._schedule.playing(t) is not None
        if not self._commanding:
            return self._decision(None, announcement)
        command = self._schedule.velocities(t, self.dogs)
        return self._decision(np.zeros_like(command) if self._lost else command, announcement)

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
        return Condition('playing a plan', not self.silent_dogs)

    # Planning ahead.

    def _plan_ahead(self, estimate: Observed, t: float) -> None:
        self._first_observation = min(self._first_observation, t)
        waited = t - self._first_observation
        if len(estimate.dogs) < self.dogs and waited <= self._timing.state_timeout:
            return  # the odometry of the others may only need a moment more
        self._notice_dogs(estimate.dogs)
        start = self._start_of_next(Request(self._goal, estimate.dogs), t)
        if start is not None:
            self._begin(Request(self._goal, estimate.dogs), estimate, start)

    def _notice_dogs(self, dogs: tuple[int, ...]) -> None:
        if dogs == self._visible:
            return
        returned = len(dogs) > len(self._visible) > 0
        self._visible = dogs
        if silent := ', '.join(self.silent_dogs):
            self._say('warning', f'no odometry from {silent}: planning without')
        elif returned:
            self._say('info', 'odometry from all dogs again')

    def _start_of_next(self, request: Request, t: float) -> float | None:
        """Return when the next plan is to start, if it is time to begin it; else None.

        A plan that starts within the window of another takes over from there. So a pilot that
        improves its plan between two windows needs to ask for one here, and nothing else.
        """
        if self._work is not None:
            return None
        lead, last = self._timing.lead, self._schedule.last
        soonest = t + self._period * math.ceil((lead - SLACK) / self._period)
        if last is None or last.request != request:
            return soonest
        end = last.accepted_until
        if t < end - lead - SLACK:
            return None
        # The windows join, unless too little of the lead is left for a plan to be ready.
        return end if t + 0.5 * lead <= end else soonest

    def _begin(self, request: Request, estimate: Observed, start: float) -> None:
        """Plan the window from `start` [s] on in the background."""
        periods = round((start - estimate.t) / self._period)
        times = estimate.t + self._period * np.arange(periods)
        u = np.array([self._schedule.velocities(t, self.dogs) for t in times])
        self._prepare_planner()
        planner, crowd = self._planner, self._crowd
        horizon, motion = self._control.horizon, self._control.motion

        def plan(no_time_for: NoTimeFor) -> ScheduledPlan:
            state: HerdState = estimate.state
            if periods > 0:
                commanded = u[:, list(estimate.dogs)]
                state = rollout(
                    crowd, state, commanded, horizon.dt, horizon.substeps, motion=motion
                ).at(-1)
            window = planner.solve(
                state, start, lambda step: self._stopping.is_set() or no_time_for(step)
            )
            return ScheduledPlan(window, request, estimate.t, start + horizon.accepted)

        spare = max(_SPARE * self._timing.lead, self._period)
        self._work = Work(plan, start, self._clock, self._step_times, spare, self._run)

    def _take_plan(self) -> Announcement | None:
        """Schedule the plan that has been made; count it once when it is late."""
        work = self._work
        if work is None:
            return None
        if work.margin < 0.0 and not work.dropped and work is not self._late:
            self._late = work
            self.deadlines_missed += 1
            self._say(
                'warning',
                f'a plan is late, the last one is played on; raise lead ({self._timing.lead:g} s) '
                'or mapping.standard_error, or lower mapping.paths',
            )
        if not work.done:
            return None
        self._work = None
        if work.error is not None:
            self._record_failure(work.error)
        elif work.result is not None and not work.dropped:
            self._schedule.add(work.result)
            return self._announce(work.result, work.margin)
        return None
