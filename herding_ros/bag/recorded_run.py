# SPDX-License-Identifier: Apache-2.0
"""What was recorded of a run, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

from herding_ros.markers import NOTHING, Surroundings
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_T = TypeVar('_T')


@dataclass(frozen=True)
class Topic:
    """One topic of the bag: its type, its messages and their rate [Hz] in the bag's time."""

    name: str
    type: str
    count: int
    rate: float


@dataclass(frozen=True)
class Replan:
    """What the controller said of one replan; a number that it did not say is NaN.

    time: when [s] from the first state; number: the running number; solve_ms: [ms];
    mapping_error_before, mapping_error_after: distance of the expected centre's path from the
    planned one; deadline_margin_s: [s], negative when the plan came late; kind: 'window', or
    'feedback' in between.
    """

    time: float
    number: int
    status: str
    solve_ms: float
    objective: float
    gradient_norm: float
    optimiser_iterations: float
    optimiser_calls: float
    mapping_iterations: float
    mapping_error_before: float
    mapping_error_after: float
    deadline_margin_s: float
    kind: str = 'window'


@dataclass(frozen=True)
class Route:
    """Where something is planned, or expected, to be: points (K, ..., 2) [m] at times (K,) [s]."""

    times: Array
    points: Array

    def ahead(self, time: float) -> Array:
        """Return the points (n, ..., 2) [m] that are still to come."""
        return self.points[np.searchsorted(self.times, time) :]


def in_play(routes: Sequence[Route], time: float) -> Route | None:
    """Return the last to begin of those that have begun by a time [s]; None without any.

    routes: as they were announced, which is before they begin; of two that begin together the
    later counts.
    """
    begun = [route for route in routes if route.times[0] <= time]
    return max(reversed(begun), key=lambda route: route.times[0], default=None)


def _begun(dated: Sequence[tuple[float, _T]], time: float) -> list[_T]:
    """Return what has begun by a time [s], of things with the times at which they begin."""
    return [each for since, each in dated if since <= time]


@dataclass(frozen=True)
class RecordedRun:
    """A recorded run: T states of N sheep and M dogs, K commands.

    times: (T,) [s] from the first state; x: (T, N, 2) positions of the sheep [m], NaN where one
    was not seen, at least one in each state; v: (T, N, 2) their velocities [m/s], NaN where they
    are not known; d: (T, M, 2) positions of the dogs [m], NaN where one was silent;
    dogs: (M,) their numbers; command_times: (K,) [s]; commands: (K, M, 2) the commands to the
    dogs [m/s], each until the next; goal: (2,) the last destination [m], None if there is none;
    replans: those that are in the bag; replans_made: their number by the controller's own count;
    namespace: of sim and controller, '' for the root; parameters: of each node by its full name;
    version: of the package that recorded, or ''; wall_s: wall time from the first to the last
    state [s]; notes: what is not in these arrays, and why, or was not as it should be.
    """

    times: Array
    x: Array
    v: Array
    d: Array
    dogs: tuple[int, ...]
    command_times: Array
    commands: Array
    goal: Array | None
    replans: tuple[Replan, ...]
    replans_made: int
    namespace: str
    parameters: dict[str, dict[str, Any]]
    version: str
    wall_s: float
    topics: tuple[Topic, ...]
    notes: tuple[str, ...]
    messages_lost: int | None = None
    """How many messages the recorder knew to be lost; None where it has not said."""
    plans: tuple[Route, ...] = ()
    """Where plans take the dogs (K, M, 2), in the order of `dogs`, NaN for one without."""
    expected: tuple[Route, ...] = ()
    """Where the flock's centre (K, 2) is expected to go under these plans."""
    goals: tuple[tuple[float, Array], ...] = ()
    """Destinations (2,) [m] and since when [s] each was in force, where that is known."""

    surroundings: tuple[tuple[float, Surroundings], ...] = ()
    """What the controller knew of walls, and its route, since when [s] each."""

    def surroundings_at(self, time: float) -> Surroundings:
        """Return what the controller knew at a time [s]."""
        known = _begun(self.surroundings, time)
        return known[-1] if known else NOTHING

    def goal_at(self, time: float) -> Array | None:
        """Return the destination (2,) [m] in force at a time [s], None if there is none."""
        begun = _begun(self.goals, time)
        return begun[-1] if begun else self.goals[0][1] if self.goals else self.goal

    @cached_property
    def headings(self) -> Array:
        """Where each dog went when it last moved (T, M) [rad]; 0 as long as it has not.

        Many dogs have no front, so that what they say of their heading means nothing.
        """
        steps = np.diff(self.d, axis=0, prepend=self.d[:1])
        moved = np.isfinite(steps).all(axis=2) & steps.any(axis=2)
        states = np.arange(len(steps))[:, None]
        last = np.maximum.accumulate(np.where(moved, states, -1), axis=0)  # (T, M)
        dx, dy = np.moveaxis(np.take_along_axis(steps, np.maximum(last, 0)[..., None], 0), -1, 0)
        return np.where(last >= 0, np.arctan2(dy, dx), 0.0)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Whether each sheep was seen in each state (T, N)."""
        return np.isfinite(self.x[..., 0])

    @property
    def largest_gap_s(self) -> float:
        """The longest time between two states [s]; 0 if there is only one."""
        return round(float(np.diff(self.times).max(initial=0.0)), 9)
