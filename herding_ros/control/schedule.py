# SPDX-License-Identifier: Apache-2.0
"""The plans that have been made, in the order in which they are played."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array
import numpy as np

from .plan import SLACK
from .window import Window


@dataclass(frozen=True)
class Request:
    """What a plan is made for: a goal (x, y) [m] and some dogs, by their indices from 0."""

    goal: tuple[float, float]
    dogs: tuple[int, ...]


@dataclass(frozen=True)
class ScheduledPlan:
    """A plan, what it was made for, and when.

    observed: time of the observation that it was made from [s]; accepted_until: time at which the
    next window ought to take over [s].
    """

    window: Window
    request: Request
    observed: float
    accepted_until: float

    @property
    def start(self) -> float:
        """Time from which it is played [s]."""
        return self.window.plan.t0

    @property
    def end(self) -> float:
        """Time at which it has been played to its end [s]."""
        return self.window.plan.end

    def velocities(self, t: float, dogs: int) -> Array:
        """Return velocities (dogs, 2) [m/s] at t [s]; dogs that it was not made for stand."""
        u = np.zeros((dogs, 2))
        u[list(self.request.dogs)] = self.window.plan.at(t)
        return u


class Schedule:
    """Plays the plan that began last.

    A plan is only ever superseded by another that has begun. Nothing takes away the plan that is
    played, nor one that waits for its start: so dogs always have a plan once they have had one,
    until its end.
    """

    def __init__(self) -> None:
        self._plans: list[ScheduledPlan] = []  # by their starts

    def add(self, plan: ScheduledPlan) -> None:
        """Play a plan from its start on; of two with the same start, the one added last."""
        k = sum(each.start <= plan.start + SLACK for each in self._plans)
        self._plans.insert(k, plan)

    @property
    def last(self) -> ScheduledPlan | None:
        """The plan that begins last."""
        return self._plans[-1] if self._plans else None

    def playing(self, t: float) -> ScheduledPlan | None:
        """Return the plan that is played at t [s]; None before the first."""
        begun = [plan for plan in self._plans if plan.start <= t + SLACK]
        return begun[-1] if begun else None

    def forget_before(self, t: float) -> None:
        """Forget the plans that were superseded by t [s]."""
        playing = self.playing(t)
        self._plans = [plan for plan in self._plans if plan is playing or plan.start > t]

    def velocities(self, t: float, dogs: int) -> Array:
        """Return the velocities (dogs, 2) [m/s] of all dogs at t [s]; zero without a plan."""
        playing = self.playing(t)
        return np.zeros((dogs, 2)) if playing is None else playing.velocities(t, dogs)
