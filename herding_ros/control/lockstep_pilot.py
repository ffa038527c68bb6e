# SPDX-License-Identifier: Apache-2.0
"""A pilot that replies to each observation, as a simulation in lockstep waits for it."""

from __future__ import annotations

import numpy as np

from herding_ros.model.state import HerdState

from .pilot import Announcement, Condition, Decision, Observed, Pilot, Planner
from .schedule import Request, ScheduledPlan


class LockstepPilot(Pilot):
    """Replies to each observation, and makes a plan first if one is due.

    A plan is due when the accepted part of the last one is over, when the goal has moved, or when
    time was set back. One that cannot be made is tried again at the next observation; until then
    the last plan is played to its end.
    """

    def __init__(self, planner: Planner, dogs: int) -> None:
        """Plan by `planner`, not to be used elsewhere, for so many dogs."""
        self._plan: ScheduledPlan | None = None
        super().__init__(planner, dogs)

    def _start_afresh(self) -> None:
        super()._start_afresh()
        self._plan = None

    def decide(self, observed: Observed) -> Decision:
        """Return the command for an observation of all dogs."""
        t = self._advance_to(observed.t)
        self._visible = observed.dogs
        state = self._observe(observed).state
        announcement = None
        if self._is_plan_due(observed):
            try:
                announcement = self._make_plan(observed, state)
            except Exception as error:
                self._record_failure(error)
        stand = np.zeros((self.dogs, 2))
        command = stand if self._plan is None else self._plan.velocities(t, self.dogs)
        return self._decision(command, announcement)

    def condition(self, t: float) -> Condition:
        """Return what the pilot is doing at t [s]."""
        if self._plan is None and self.plans_failed:
            return Condition('standing: no plan could be made', False)
        return Condition('replying in lockstep', True)

    def _is_plan_due(self, observed: Observed) -> bool:
        last = self._plan
        return (
            last is None
            or last.request != Request(self._goal, observed.dogs)
            or self._planner.due(self._time)
        )

    def _make_plan(self, observed: Observed, state: HerdState) -> Announcement:
        self._prepare_planner()
        window = self._planner.solve(state, self._time, lambda _: self._stopping.is_set())
        request = Request(self._goal, observed.dogs)
        self._plan = ScheduledPlan(window, request, self._control.horizon.accepted)
        return self._announce(self._plan, 0.0)
