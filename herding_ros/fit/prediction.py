# SPDX-License-Identifier: Apache-2.0
"""How far a recording is off what a crowd predicts, and how far it should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from herding_ros.control.parameters import Sensor
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import physics, to_lanes
from herding_ros.model.kernels import lanes
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array
import numpy as np
from numpy.typing import NDArray

from . import kernels
from .recording import Recording

_A_SECOND = 1.0
"""Time over which the speed of sheep is looked at before anything is known of them [s]."""

_MOST_NUMBERS = 200_000_000
"""Coordinates of dogs at all steps: more would take memory by the gigabyte."""


@dataclass(frozen=True)
class Innovations:
    """Differences between what was seen and what had been predicted, and their variances.

    off: (T, L, 2, 2, N), from T instants L leads ahead, of positions [m] and of velocities less
    what the positions say of them [m/s], in both coordinates; variance: (T, L, 2, N) as the crowd
    says; NaN where nothing was seen.
    """

    off: Array
    variance: Array


class Filter:
    """A recording, prepared to be predicted by one crowd or another.

    leads: times to predict ahead [s], 0 the next observation; step: longest time step of the
    prediction [s]; stride: number of observations from one start of predictions to the next.
    Raises ValueError for a lead that is longer than the recording, and for a gap that takes too
    many steps.
    """

    def __init__(self, recording: Recording, leads: Sequence[float], step: float) -> None:
        """Lay the recording out for the kernels."""
        if not step > 0.0:
            raise ValueError(f'step must be above 0, got {step:g}')
        self._leads = _in_observations(recording, leads)
        self.longest_lead = int(self._leads[-1])
        # Predictions that begin at neighbouring instants say nearly the same.
        self.stride = int(self._leads[0])
        between = np.diff(recording.times)
        x, v, d = recording.x, recording.v, recording.d
        steps = max(int(np.ceil(between.max() / step - TINY)), 1)
        if steps * max(d.size, len(d)) > _MOST_NUMBERS:
            raise ValueError(
                f'{recording.name}: times must be in s, with no gap of {between.max():.3g} s: at '
                f'a step of {step:g} s it takes too many steps, as each interval then does. Make '
                'two recordings of it, or the step longer'
            )
        self._dt = between / steps
        self.n = n = x.shape[1]
        self._seen = np.full((len(x), 2, 2, lanes(n)), np.nan)
        self._seen[:, 0, :, :n], self._seen[:, 1, :, :n] = x.swapaxes(1, 2), v.swapaxes(1, 2)
        share = np.linspace(0.0, 1.0, steps + 1)[:, None, None]
        ways = d[:-1, None] + share * (d[1:] - d[:-1])[:, None]
        self._d = np.ascontiguousarray(ways.transpose(0, 1, 3, 2))
        self._x, self._v, self._waited = _start(recording)
        self._speed2 = _mean_square_speed(recording)

    @property
    def seen_ahead(self) -> Array:
        """The positions that are predicted (T, L, 2, N) [m], as recorded; NaN beyond the end."""
        seen = self._seen[:, 0, :, : self.n]
        out = np.full((len(seen), len(self._leads), *seen.shape[1:]), np.nan)
        for q, lead in enumerate(self._leads):
            out[: -lead : self.stride, q] = seen[lead :: self.stride]
        return out

    def innovations(self, crowd: Crowd, sensor: Sensor) -> Innovations:
        """Return how far the recording is off what this crowd predicts.

        Of the sensor its noise of positions and velocities counts, above 0.
        """
        known = np.isfinite(self._v[:, 0])
        p = np.zeros((3, lanes(self.n)))
        p[0, : self.n] = sensor.position_noise**2 + self._speed2 * self._waited**2
        p[2, : self.n] = np.where(known, sensor.velocity_noise**2, self._speed2)
        seen = self._seen
        if crowd.order == 1:  # what is seen of velocities has no effect
            seen = seen.copy()
            seen[:, 1] = np.nan
        shape = len(seen), len(self._leads), 2, lanes(self.n)
        off, variance = np.empty((*shape[:3], 2, shape[3])), np.empty(shape)
        variances = np.array([sensor.position_noise, sensor.velocity_noise]) ** 2
        kernels.innovations(
            seen, self._d, self._dt, to_lanes(self._x), to_lanes(np.nan_to_num(self._v)), p,
            crowd.noise, variances, physics(crowd, self.n, 1.0), self._leads, self.stride, off,
            variance,
        )  # fmt: skip
        return Innovations(off[..., : self.n], variance[..., : self.n])


def _in_observations(recording: Recording, leads: Sequence[float]) -> NDArray[np.int64]:
    """Return leads [s] as numbers of observations, in order."""
    between = float(np.median(np.diff(recording.times)))
    good = [lead for lead in leads if 0.0 <= lead <= recording.duration]
    counts = np.unique([max(round(lead / between), 1) for lead in good])
    if not good or len(good) < len(leads) or counts[-1] >= len(recording.times):
        raise ValueError(
            f'{recording.name}: leads must be at least 0 and shorter than the recording, '
            f'{recording.duration:g} s, got {list(leads)}'
        )
    return counts.astype(np.int64)


def _start(recording: Recording) -> tuple[Array, Array, Array]:
    """Return where each sheep is first seen (N, 2), its velocity at the start, and when (N,) [s].

    The velocity (N, 2) is NaN if it was not observed at the first instant.
    """
    first = np.isfinite(recording.x[..., 0]).argmax(axis=0)
    x = recording.x[first, np.arange(len(first))]
    v = np.where((first == 0)[:, None], recording.v[0], np.nan)
    return x, v, recording.times[first] - recording.times[0]


def _mean_square_speed(recording: Recording) -> float:
    """Return the mean square of a coordinate of the sheep's velocities over a second or so."""
    times = recording.times
    later = np.minimum(np.searchsorted(times, times + _A_SECOND), len(times) - 1)
    took = times[later] - times
    moved = recording.x[later] - recording.x
    with np.errstate(invalid='ignore'):
        speeds = moved[took > 0.0] / took[took > 0.0, None, None]
    return float(np.nanmean(np.square(speeds)))
