# SPDX-License-Identifier: Apache-2.0
"""Whether velocities that are all exactly zero are those of a flock that moves.

Trackers and simulators that do not see velocities often fill in zeros. In a crowd with inertia
each plan then begins from a flock that stands.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from herding_ros.model.flock import centre
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array, HerdState
import numpy as np
from numpy.typing import NDArray

from .parameters import Control
from .plan import SLACK

_MOVES = 0.1
"""Part of the way of a dog by which a flock that moves is told from one that stands."""


@dataclass
class ZeroVelocities:
    """Looks at the same sheep, one after another, at which all velocities were zero."""

    _ids: NDArray[np.integer] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _times: list[float] = field(default_factory=list)
    _centres: list[Array] = field(default_factory=list)

    def observe(
        self, t: float, ids: NDArray[np.integer], state: HerdState, control: Control
    ) -> tuple[float, float] | None:
        """Look at sheep with these ids (N,) at t [s].

        Return how far they have moved [m] and in which time [s] if they did, and that time is
        `accepted`; None otherwise.
        """
        if state.v.any() or not np.array_equal(ids, self._ids):
            self._ids, self._times, self._centres = ids, [], []
        if state.v.any() or (self._times and t < self._times[-1] + SLACK):
            return None
        self._times.append(t)
        self._centres.append(centre(state.x))
        elapsed = t - self._times[0]
        if elapsed < control.horizon.accepted - SLACK:
            return None
        path, steps = np.array(self._centres), np.diff(self._times)
        self._times, self._centres = self._times[-1:], self._centres[-1:]
        moved = float(np.linalg.norm(path[-1] - path[0]))
        # At most looks: a gust moves it but once, and errors of observations to and fro.
        along = np.diff(path, axis=0) @ (path[-1] - path[0]) / max(moved, TINY)
        is_moving = float(np.median(along / steps)) > _MOVES * control.max_speed
        return (moved, elapsed) if is_moving else None
