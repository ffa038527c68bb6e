# SPDX-License-Identifier: Apache-2.0
"""How well a crowd predicts a recording that it may not have seen, some time ahead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from herding_ros.control.parameters import Sensor
from herding_ros.model.crowd import Crowd
from herding_ros.model.state import Array
import numpy as np

from .prediction import Filter
from .recording import Recording

AHEAD = (0.0, 1.0, 3.0, 10.0)
"""Times ahead at which predictions are judged [s]; 0: the next observation."""


@dataclass(frozen=True)
class Forecast:
    """K recorded positions, coordinate by coordinate, and what was predicted for them.

    ahead: how long before [s], 0: from one observation to the next; t: (K,) when they were
    recorded [s]; moved: (K,) how far the sheep had come since the prediction began [m]; off: (K,)
    recorded less predicted position [m]; deviation: (K,) what the standard deviation of that is
    according to the crowd, its noise and that of the sensors [m].
    """

    ahead: float
    t: Array
    moved: Array
    off: Array
    deviation: Array

    @property
    def predicted(self) -> Array:
        """How far sheep should have come (K,) [m]."""
        return self.moved - self.off

    @property
    def standardised(self) -> Array:
        """Errors in units of what is expected of them (K,): standard normal if the crowd is right.

        That is, but where another sheep is so near that forces are in doubt.
        """
        return self.off / self.deviation

    @property
    def error(self) -> float:
        """By how much a sheep is off [m], root mean square."""
        return _distance(np.mean(self.off**2))

    @property
    def expected(self) -> float:
        """What the crowd says of that error [m], for most sheep.

        Not for those that another one is so near to that forces are in doubt.
        """
        return _distance(np.median(self.deviation**2))

    @property
    def standing(self) -> float:
        """What the error would be if all sheep stood still [m]."""
        return _distance(np.mean(self.moved**2))


def _distance(variance: float | np.floating) -> float:
    """Return the root mean square of a distance, of whose coordinates this is the variance."""
    return float(np.sqrt(2.0 * variance))


def forecast(
    recordings: Sequence[Recording], crowd: Crowd, sensor: Sensor, step: float,
    ahead: Sequence[float] = AHEAD,
) -> tuple[Forecast, ...]:  # fmt: skip
    """Return what a crowd predicts of recordings, as far ahead as one of them lasts."""
    found = []
    for lead in ahead:
        parts = [
            _compared(each, crowd, sensor, step, lead)
            for each in recordings
            if lead < each.duration
        ]
        if parts:
            found.append(Forecast(lead, *np.concatenate(parts, axis=1)))
    return tuple(found)


def _compared(
    recording: Recording, crowd: Crowd, sensor: Sensor, step: float, lead: float
) -> Array:
    """Return t, moved, off and deviation of a recording (4, K)."""
    filter = Filter(recording, [lead], step)
    found = filter.innovations(crowd, sensor)
    later = filter.longest_lead
    off = found.off[:-later, 0, 0]
    t = np.broadcast_to(recording.times[later:, None, None], off.shape)
    moved = (recording.x[later:] - recording.x[:-later]).swapaxes(1, 2)
    deviation = np.broadcast_to(np.sqrt(found.variance[:-later, 0, :1]), off.shape)
    there = np.isfinite(off) & np.isfinite(moved)
    return np.array([each[there] for each in (t, moved, off, deviation)])
