# SPDX-License-Identifier: Apache-2.0
"""Whether dogs do as they are told: how they are seen to move, and how their commands would.

Over a window of time let p be the path on which the commands lead a dog from where it was seen
first, and o that on which it was seen. A line fitted to o - p has a slope, the error of its
velocity, whose standard error follows from the scatter around the line (linear regression). So
the noise of odometry need not be told.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from herding_ros.model.motion import MotionModel
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array
import numpy as np
from numpy.typing import NDArray

from .parameters import Control

_LONG = 4
"""A dog that runs slowly is judged by a window that is so many times as long, too."""

_LOOKS = 10
"""How often it is looked within a window."""

_FEWEST = 10
"""Observations that there are in a window at least."""

_STANDARD_ERRORS = 7.0
"""An error of the velocity of fewer standard errors may be chance."""

_PART = 0.5
"""A dog does not do as told if its velocity is off by more than this part of what it should be."""

_SLOW = 0.25
"""What is less than this part of the speed limit is not judged."""


@dataclass(frozen=True)
class Judgement:
    """Of a window: (M,) speeds that commands lead to, errors of velocities, their standard errors.

    All in m/s; NaN of a dog that was not seen all the time.
    """

    told: Array
    off: Array
    error: Array

    def disobedient(self, limit: float) -> NDArray[np.bool_]:
        """Return which dogs (M,) have not done as told; limit: the fastest that they run [m/s]."""
        least = _PART * np.maximum(self.told, _SLOW * limit)
        return (self.off > least) & (self.off > _STANDARD_ERRORS * self.error)

    def obedient(self, limit: float) -> NDArray[np.bool_]:
        """Return which dogs (M,) were told to run and did."""
        least = np.maximum(_SLOW * limit, 0.5 * _STANDARD_ERRORS * self.error)
        return (self.told > least) & (self.off <= _PART * self.told)


class Obedience:
    """Watches dogs and knows which of them do not do as they are told.

    Those are `disobedient` until they have done as they were told again, for as long as it takes
    to see that.
    """

    def __init__(self, dogs: int) -> None:
        """Trust so many dogs."""
        self.disobedient: dict[int, float] = {}
        """Since when [s], by their indices."""
        self._dogs = dogs
        self._seen: deque[tuple[float, Array, Array]] = deque()
        self._judged_at = -np.inf

    def observe(
        self, t: float, d: Array, dogs: tuple[int, ...], u: Array, control: Control
    ) -> dict[int, Judgement]:
        """Take in where dogs are at t [s]; return the judgement of each whose standing changes.

        d: states of the dogs that are seen, these by their indices; u: (all dogs, 2) commands that
        were in effect since the last observation [m/s].
        """
        timeout = control.dog_timeout
        if not timeout:
            self.disobedient.clear()
            return {}
        states = np.full((self._dogs, d.shape[1]), np.nan)
        states[list(dogs)] = d
        self._seen.append((t, states, u))
        while len(self._seen) > _FEWEST and self._seen[1][0] < t - _LONG * timeout:
            self._seen.popleft()
        if t < self._judged_at + timeout / _LOOKS:
            return {}
        self._judged_at = t
        changed: dict[int, Judgement] = {}
        for window in (timeout, _LONG * timeout):
            judgement = self._judged(t - window, control.motion)
            if judgement is None:
                continue
            for m in np.flatnonzero(judgement.disobedient(control.max_speed)):
                if int(m) not in self.disobedient:
                    self.disobedient[int(m)] = t
                    changed[int(m)] = judgement
            if window == timeout:
                for m in np.flatnonzero(judgement.obedient(control.max_speed)):
                    if int(m) not in changed and self.disobedient.pop(int(m), None) is not None:
                        changed[int(m)] = judgement
        return changed

    def _judged(self, start: float, motion: MotionModel) -> Judgement | None:
        """Judge the observations from `start` [s] on; None if they do not reach back so far."""
        seen = list(self._seen)
        first = max((k for k, (t, _, _) in enumerate(seen) if t <= start + TINY), default=-1)
        first = min(first, len(seen) - _FEWEST)
        if first < 0:
            return None
        seen = seen[first:]
        times = np.array([t for t, _, _ in seen])
        observed = np.array([d[:, :2] for _, d, _ in seen])
        # A motion has one time step: a command that held for longer counts as faster.
        steps = np.diff(times)
        step = float(steps.mean())
        u = np.array([u for _, _, u in seen[1:]]) * (steps / step)[:, None, None]
        path = motion.rollout(seen[0][1], u, step, 1)[:, :2].transpose(0, 2, 1)
        off, error = _slope(times, observed - path)
        told, _ = _slope(times, path)
        return Judgement(told, off, error)


def _slope(times: Array, path: Array) -> tuple[Array, Array]:
    """Return the lengths of the slopes of lines fitted to path (n, M, 2), and standard errors."""
    t = times - times.mean()
    square = float(t @ t)
    slope = np.tensordot(t, path, 1) / square
    rest = path - path.mean(axis=0) - t[:, None, None] * slope
    variance = np.square(rest).sum(axis=(0, 2)) / (2.0 * (len(t) - 2))
    return np.linalg.norm(slope, axis=1), np.sqrt(variance / square)
