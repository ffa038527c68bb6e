# SPDX-License-Identifier: Apache-2.0
"""What RViz shows of the controller's decisions. No ROS."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.control.parameters import Control
from herding_ros.control.pilot import Announcement, Decision, Observed
from herding_ros.control.ways import Ways
from herding_ros.model.field import Field
from herding_ros.model.flock import centre
from herding_ros.model.state import Array
import numpy as np

_PERIODS = 5
"""Control periods from one drawing to the next."""

_AHEAD = 2.0
"""Commands are drawn as the ways that they would lead in this time [s]."""

_WIDTH = 0.1
"""Lines are as wide as a dog runs in this time [s]."""

_SAME = 0.01
"""Commands that differ by less than this part of the dogs' full speed are the same."""


@dataclass(frozen=True)
class Drawing:
    """Shapes, in metres.

    walls: (n, 2, 2) straight pieces; route: (n, 2) of the flock's centre; dogs: (M, 2), to be kept
    `separation` apart; changes: (n, 3, 2) where a command was changed: the dog, where the plan
    would have led it, and where the command does; width: of lines.
    """

    walls: Array
    route: Array
    dogs: Array
    separation: float
    changes: Array
    width: float


class Draughtsman:
    """Follows the decisions of a pilot, and draws every few control periods."""

    def __init__(self) -> None:
        self._decisions = 0
        self._route: Array = np.zeros((0, 2))
        self._changes: dict[int, Array] = {}

    def follow(
        self, decision: Decision, estimate: Observed | None, field: Field, control: Control
    ) -> Drawing | None:
        """Take in a decision, made for an estimate; return a drawing if it is time for one.

        It has the last change of each dog's command since the drawing before.
        """
        if estimate is None:
            return None
        if decision.announcement is not None:
            self._route = _route(decision.announcement, estimate, field, control)
        if decision.asked is not None and decision.command is not None:
            for m, place in zip(estimate.dogs, estimate.state.dogs, strict=True):
                asked, told = decision.asked[m], decision.command[m]
                if np.linalg.norm(told - asked) > _SAME * control.max_speed:
                    ways = _AHEAD * np.stack([np.zeros(2), asked, told])
                    self._changes[m] = place + ways
        self._decisions += 1
        if self._decisions % _PERIODS:
            return None
        changes = np.array(list(self._changes.values())).reshape(-1, 3, 2)
        self._changes = {}
        return Drawing(
            field.outline,
            self._route,
            estimate.state.dogs,
            control.bodies.separation,
            changes,
            _WIDTH * control.max_speed,
        )


def _route(
    announcement: Announcement, estimate: Observed, field: Field, control: Control
) -> Array:
    """Return the route (n, 2) [m] of a plan; without a point if no way leads to its goal."""
    goal = np.array(announcement.plan.request.goal)
    try:
        ways = Ways.of(field, control.bodies, estimate.state.x, goal)
    except ValueError:  # the walls are new: the next plan will say that it cannot be made
        return np.zeros((0, 2))
    return np.stack([centre(estimate.state.x), goal]) if ways is None else ways.route
