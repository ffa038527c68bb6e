# SPDX-License-Identifier: Apache-2.0
"""The crowd whose predictions are least off, seconds ahead.

Of sheep that are not of the crowd's kind the likelihood explains what is most certain, which is
how they swerve within a tenth of a second. This fit minimises what predictions are for: the
squares of their errors some seconds ahead, each lead in units of the error of constant
velocities. They begin from what a filter has found (`prediction`), and have no noise; that is
found afterwards (`with_noise`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
import os

from herding_ros.control.parameters import Sensor
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import follow
from herding_ros.model.noise import increments
from herding_ros.model.parameters import TINY
from herding_ros.model.potentials import Morse
from herding_ros.model.state import Array, HerdState
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar

from .estimate import check_names, may_change, PRIOR
from .prediction import Filter
from .recording import Recording

LEADS = (1.0, 3.0, 5.0, 10.0)
"""How far ahead predictions are judged [s]. They begin one second apart."""

_DIFFERENCE = 1e-4
"""Step of the logarithms of parameters for derivatives."""

_CLOSE = 1e-5
"""The fit ends when a step changes the sum of squares by less than this share of it."""

_MOST_EVALUATIONS = 60

_CLOSE_NOISE = 0.02
"""The logarithm of the variance of the noise is found to within this."""

_NOTHING = Morse(0.0, 1.0, 0.0, 1.0)


@dataclass(frozen=True)
class Predictions:
    """What was recorded and what was predicted for it, S times, L leads ahead.

    seen, off: (S, L, 2, N) positions, and how far they are off the predicted ones [m]; NaN where a
    recording has no sheep.
    """

    seen: Array
    off: Array

    @property
    def rms(self) -> Array:
        """Root mean square of the error of a sheep (L,) [m]."""
        return np.sqrt(2.0 * _mean(_by_lead(self.off**2)))

    @property
    def rms_of_centre(self) -> Array:
        """Root mean square of the error of the flock's centre (L,) [m]."""
        return np.sqrt(2.0 * _mean(_by_lead(_mean(self.off) ** 2)))


def _by_lead(values: Array) -> Array:
    """Return values (S, L, ...) as (L, all of a lead)."""
    return np.moveaxis(values, 1, 0).reshape(values.shape[1], -1)


def _mean(x: Array) -> Array:
    """Return the mean of the last axis over what is there; NaN if nothing is."""
    there = np.isfinite(x)
    with np.errstate(invalid='ignore'):
        return np.asarray(np.where(there, x, 0.0).sum(axis=-1) / there.sum(axis=-1))


class Predictor:
    """Recordings, prepared to be predicted by one crowd or another.

    leads: increasing, multiples of the first [s]; step: longest time step [s]. Recordings that are
    shorter than a lead are predicted as far as they go, those shorter than the first not at all;
    nothing is predicted before a velocity can be known. Raises ValueError if none is left.
    """

    def __init__(
        self, recordings: Sequence[Recording], leads: Sequence[float] = LEADS, step: float = 0.1
    ) -> None:
        """Lay the recordings out."""
        long = [each for each in recordings if each.duration > 2.0 * leads[0]]
        if not long:
            raise ValueError(
                f'a recording must be longer than {2.0 * leads[0]:g} s, the longest of '
                f'{len(recordings)} has {max((r.duration for r in recordings), default=0.0):g} s'
            )
        self.leads = tuple(leads)
        self._recordings, self._step = long, step
        self._sheep = max(each.x.shape[1] for each in long)
        self._filters = [
            Filter(each, [lead for lead in leads if lead < each.duration], step) for each in long
        ]
        self._seen = np.concatenate([self._in_place(f, f.seen_ahead) for f in self._filters])

    def _in_place(self, filter: Filter, values: Array) -> Array:
        """Return what a filter says of its starts (T, L', 2, N') at all leads, of all sheep."""
        first = filter.stride
        values = values[first::first]
        missing = ((0, 0), (0, len(self.leads) - values.shape[1]), (0, 0),
                   (0, self._sheep - values.shape[3]))  # fmt: skip
        return np.pad(values, missing, constant_values=np.nan)

    def predict(self, crowd: Crowd, sensor: Sensor) -> Predictions:
        """Return what this crowd predicts, from what these sensors have seen."""
        found = [
            self._in_place(each, each.innovations(crowd, sensor).off[:, :, 0])
            for each in self._filters
        ]
        return Predictions(self._seen, np.concatenate(found))

    def sizes(self, crowd: Crowd) -> tuple[float, float]:
        """Return the mean distance of sheep from their centre at the last lead [m].

        As recorded, and as simulated under noise from the recorded states on, of which velocities
        that were not observed are differences of positions. NaN if no recording is that long.
        """
        rng = np.random.default_rng(0)
        recorded, simulated = [], []
        lead = self.leads[-1]
        for each, filter in zip(self._recordings, self._filters, strict=True):
            for k in range(filter.stride, len(each.times), filter.stride):
                end = int(np.searchsorted(each.times, each.times[k] + lead - TINY))
                there = np.isfinite(each.x[k - 1, :, 0]) & np.isfinite(each.x[k, :, 0])
                if end == len(each.times) or not there.any():
                    continue
                x = self._simulated(each, k, end, there, crowd, rng)
                simulated.append(_size(x))
                recorded.append(_size(each.x[end, there]))
        return float(_mean(np.array(recorded))), float(_mean(np.array(simulated)))

    def _simulated(
        self, each: Recording, k: int, end: int, there: NDArray[np.bool_], crowd: Crowd,
        rng: np.random.Generator,
    ) -> Array:  # fmt: skip
        """Return where sheep (N', 2) [m] are at instant `end` if they move on from k."""
        times, x = each.times, each.x[:, there]
        v = (x[k] - x[k - 1]) / (times[k] - times[k - 1])
        v = np.where(np.isfinite(each.v[k, there]), each.v[k, there], v)
        steps = max(int(np.ceil((times[end] - times[k]) / self._step - TINY)), 1)
        instants, dt = np.linspace(times[k], times[end], steps + 1, retstep=True)
        ways = [[np.interp(instants, times, path) for path in dog.T]
                for dog in each.d.swapaxes(0, 1)]  # fmt: skip
        noise = increments(rng, crowd, len(v), dt, steps)
        state = HerdState(x[k], v, each.d[k])
        return follow(crowd, state, np.array(ways).transpose(2, 1, 0), dt, noise).x[-1]


def _size(x: Array) -> float:
    return float(np.linalg.norm(x - np.nanmean(x, axis=0), axis=1).mean())


def constant_velocity(noise: float) -> Crowd:
    """Return sheep that go straight on, but for noise [m/s^1.5]."""
    return Crowd(_NOTHING, _NOTHING, friction=0.0, noise=noise)


def fit_predictions(
    predictor: Predictor,
    start: Crowd,
    sensor: Sensor,
    hold: Collection[str] = (),
) -> Crowd:
    """Return the crowd of the kind of `start` whose predictions are least off.

    All numbers but those of the noise are fitted that `start` has above 0 and that are not held:
    names, or beginnings of names that end with a dot. A prior as that of `estimate.fit` holds what
    the recordings cannot tell. Raises ValueError for unknown names, and without anything to fit.
    """
    fixed = (*hold, 'crowd.noise')
    entries = list(start.walk('crowd.'))
    check_names(fixed, entries)
    fitted = [each for each in entries if may_change(each, fixed)]
    names = [each.name for each in fitted]
    if not names:
        raise ValueError('there must be a parameter to fit, but all are held or 0')
    values = start.flat('crowd.')
    theta0 = np.log([values[name] for name in names])
    low, high = (
        np.log([max(e.field.metadata[end], TINY) for e in fitted]) for end in ('low', 'high')
    )
    unit = predictor.predict(constant_velocity(start.noise), sensor).rms

    def crowd(theta: Array) -> Crowd:
        numbers = np.exp(theta).tolist()
        return start.with_values(dict(zip(names, numbers, strict=True)), 'crowd.')

    def residuals(theta: Array) -> Array:
        found = predictor.predict(crowd(theta), sensor)
        errors = found.off / unit[:, None, None]
        errors = errors[np.isfinite(errors)]
        return np.concatenate([errors, (theta - theta0) / PRIOR])

    def jacobian(theta: Array) -> Array:
        base = residuals(theta)
        steps = theta + _DIFFERENCE * np.eye(len(theta))
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            shifted = list(pool.map(residuals, steps))
        return (np.array(shifted) - base).T / _DIFFERENCE

    found = least_squares(
        residuals,
        theta0,
        jacobian,
        bounds=(low, high - 2.0 * _DIFFERENCE),
        x_scale='jac',
        ftol=_CLOSE,
        max_nfev=_MOST_EVALUATIONS,
    )
    return crowd(found.x)


def with_noise(crowd: Crowd, predictor: Predictor, sensor: Sensor) -> Crowd:
    """Return the crowd with noise, of all sheep in common and of each.

    Under a random force of strength s and friction a, a coordinate is off by s^2 V(t, a) after a
    time t, see `_variance`. The flock's centre, on which only friction acts from within, is to be
    off by what was found, on geometric average over the leads. What sheep may do is wider than
    its mean; the noise of each is that under which flocks are as large as recorded, at the longest
    lead.
    """
    found = predictor.predict(crowd, sensor)
    if not np.isfinite(found.off[:, -1]).any():
        raise ValueError(
            f'a recording must be longer than {predictor.leads[-1]:g} s to tell the noise'
        )
    n = found.off.shape[3]
    spread = 0.5 * found.rms_of_centre**2 / _variance(np.array(predictor.leads), crowd.friction)
    of_centre = float(np.exp(np.mean(np.log(spread))))

    def noisy(own: float) -> Crowd:
        # Of independent noise a share of 1 / N moves the centre.
        common = max(of_centre - own / n, 0.0)
        return replace(
            crowd, noise=float(np.sqrt(own + common)), common_noise=common / (own + common)
        )

    def too_large(log_own: float) -> float:
        recorded, simulated = predictor.sizes(noisy(float(np.exp(log_own))))
        return float(np.log(simulated / recorded) ** 2)

    middle = np.log(of_centre)
    least = minimize_scalar(
        too_large, bounds=(middle - 3.0, middle + 3.0), method='bounded',
        options={'xatol': _CLOSE_NOISE},
    )  # fmt: skip
    return noisy(float(np.exp(least.x)))


def _variance(t: Array, friction: float) -> Array:
    """Int_0^t ((1 - exp(-a s)) / a)^2 ds [s^3]: of a place under a random force of strength 1."""
    a = max(friction, 1e-3)  # below, the exact difference of small numbers drowns in rounding
    gone = 1.0 - np.exp(-a * t)
    return np.asarray((a * t - gone - 0.5 * gone**2) / a**3)
