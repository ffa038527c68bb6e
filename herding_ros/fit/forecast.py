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
    """Errors of predicted positions (L,) [m] at times ahead (L,) [s], root mean square.

    error: what they are; expected: what the crowd says of most sheep, by its noise and that of the
    sensors, but not of those that another one is so near to that forces are in doubt; standing:
    what they would be if all sheep stood still.
    """

    ahead: Array
    error: Array
    expected: Array
    standing: Array


def forecast(
    recordings: Sequence[Recording], crowd: Crowd, sensor: Sensor, step: float,
    ahead: Sequence[float] = AHEAD,
) -> Forecast:  # fmt: skip
    """Return how well a crowd predicts recordings, as far ahead as one of them lasts."""
    leads = [lead for lead in ahead if any(lead < each.duration for each in recordings)]
    error, expected, standing = [], [], []
    for lead in leads:
        found = [
            _errors(each, crowd, sensor, step, lead) for each in recordings if lead < each.duration
        ]
        off, variance, stood = (np.concatenate(part) for part in zip(*found, strict=True))
        # Both coordinates together: a distance.
        error.append(np.sqrt(2.0 * np.nanmean(off**2)))
        expected.append(np.sqrt(2.0 * np.nanmedian(variance)))
        standing.append(np.sqrt(2.0 * np.nanmean(stood**2)))
    return Forecast(np.array(leads), np.array(error), np.array(expected), np.array(standing))


def _errors(
    recording: Recording, crowd: Crowd, sensor: Sensor, step: float, lead: float
) -> tuple[Array, Array, Array]:
    """Return errors of positions, their variances, and how far sheep moved; all flat."""
    filter = Filter(recording, [lead], step)
    found = filter.innovations(crowd, sensor)
    later = filter.longest_lead
    moved = recording.x[later:] - recording.x[:-later]
    return found.off[:, 0, 0].ravel(), found.variance[:, 0, 0].ravel(), moved.ravel()
