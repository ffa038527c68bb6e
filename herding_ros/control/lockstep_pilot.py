# SPDX-License-Identifier: Apache-2.0
"""A pilot that replies to each observation, as a simulation in lockstep waits for it."""

from __future__ import annotations

import numpy as np

from .parameters import check_lockstep
from .pilot import Announcement, Condition, Decision, Observed, Pilot, Planner
from .plan import SLACK
from .schedule import Request, ScheduledPlan


class LockstepPilot(Pilot):
    """Replies to each observation, and makes a plan first if one is due.

    A window is due when the accepted part of the last one is over, when the goal has moved, or
    when time was set back. In between the plan is improved every `horizon.feedback`, and at once
    on a surprise. A plan that cannot be made is tried again at the next observation; until then
    the last one is played to its end.
    """

    def __init__(self, planner: Planner, dogs: int) -> None:
        """Plan by `planner`, not to be used elsewhere, for so many dogs."""
        self._plan: ScheduledPlan | None = None
        super().__init__(planner, dogs)

    def _start_afresh(self) -> None:
        super()._start_afresh()
        self._plan = None
        self._last_stamp: int | None = None
        self._is_period_known = False

    def decide(self, observed: Observed) -> Decision:
        """Return the command for an observation of all dogs.

        Raises OutOfStepError when the second one shows that the world has another period.
        """
        t = self._advance_to(observed.t)
        self._check_period(observed.stamp)
        self._visible = observed.dogs
        estimate = self._observe(observed)
        announcement = None
        try:
            announcement = self._plan_if_due(estimate)
        except Exception as error:
            self._record_failure(error)
        stand = np.zeros((self.dogs, 2))
        if self._plan is None:
            return self._decision(stand, announcement)
        asked = self._plan.velocities(t, self.dogs)
        return self._decision(self._filtered(asked, estimate), announcement)

    def _check_period(self, stamp: int) -> None:
        """Compare the first two observations: a command holds from one to the next."""
        last, self._last_stamp = self._last_stamp, stamp
        if last is None or stamp <= last or self._is_period_known:
            return
        self._is_period_known = True
        check_lockstep(self._control.horizon.control_period, (stamp - last) * 1e-9)

    def condition(self, t: float) -> Condition:
        """Return what the pilot is doing at t [s]."""
        if self._plan is None and self.plans_failed:
            return Condition('standing: no plan could be made', False)
        return Condition('replying in lockstep', not self.disobedient_dogs)

    def _plan_if_due(self, estimate: Observed) -> Announcement | None:
        last, t = self._plan, self._time
        request = Request(self._goal, estimate.dogs)
        if last is None or last.request != request or t > last.accepted_until - SLACK:
            make, accepted_until = self._planner.solve, t + self._control.horizon.accepted
        elif self._is_feedback_due(last, estimate):
            make, accepted_until = self._planner.improve, last.accepted_until
        else:
            return None
        self._prepare_planner()
        self._planner.learn(estimate.state, t)
        window = make(estimate.state, t, lambda _: self._stopping.is_set())
        self._plan = ScheduledPlan(window, request, t, accepted_until)
        return self._announce(self._plan, 0.0)
