# SPDX-License-Identifier: Apache-2.0
"""The crowd under which a recording is most probable, and how sure that is.

A Kalman filter follows the recording and predicts what will be seen. With e the differences and S
their variances, both according to the crowd, the fit minimises

    1/2 sum (e^2 / S + log S) + 1/2 |theta - theta_0|^2 / w^2

over the logarithms theta of the parameters. Predicting one observation ahead, the sum is the
negative log-likelihood (prediction error decomposition; Schweppe 1965); for longer leads it is a
composite one. The last term is a prior about the start theta_0, w wide: it holds what the
recording cannot tell, and hardly changes what it can.

e and S are differentiated along every parameter; the Hessian is the expected one (Fisher
scoring). The covariance of the result is H^-1 G H^-1 (Godambe 1960), with G the covariance of the
gradient, from its sums over pieces as long as the longest lead: it holds where errors of
different sheep go together, too. To both belongs the prior, so that what nothing is known about
stays as uncertain as it was.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
import os

from herding_ros.control.parameters import Sensor
from herding_ros.model.crowd import Crowd
from herding_ros.model.parameters import Entry, Parameters
from herding_ros.model.simulation import World
from herding_ros.model.state import Array
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtri

from .prediction import Filter, Innovations
from .recording import Recording

CONFIDENCE = 0.95
"""Of the intervals."""

_NARROWER = 0.8
"""An interval is narrower if it is less than this part of another one."""

TOLD = 3.0
"""A parameter can be told if its interval ends within this factor of its value."""

_QUANTILE = float(ndtri(0.5 + 0.5 * CONFIDENCE))

PRIOR = np.log(10.0)
"""Standard deviation w of the prior: the start is right to a factor of ten or so."""

_DIFFERENCE = 1e-5
"""Step of theta for derivatives."""

_CLOSE = 1e-2
"""The fit has converged when the objective is this near its minimum; 1/2 is one standard error."""

_MOST_ITERATIONS = 100

_BLUR = 10.0
"""Positions do not resolve what acts within this many standard deviations of their noise."""

_TINY = 1e-12
"""Information about what has no effect at all."""

_NEVER = ('crowd.common_noise', 'crowd.noise_field.', 'crowd.external.')
"""Beginnings of the names of parameters that are not fitted."""

NOISES = ('sensor.position_noise', 'sensor.velocity_noise')
"""What a recording can tell of its sensors."""

Progress = Callable[[int, float], None]
"""Is told the number of the iteration and the objective."""


_USUAL = Sensor(World.position_noise, World.velocity_noise)
"""Where the noise of the sensors begins if nothing is known of it."""


@dataclass(frozen=True)
class Estimate:
    """A parameter: value and ends of its confidence interval, in its unit.

    deviation: standard deviation of its logarithm; alone: what it would be if all others were
    known; blurred: it belongs to a force of so short a range that the noise of the positions
    hides it; like: name of the parameter whose estimate is most correlated with this one.
    """

    name: str
    unit: str
    value: float
    deviation: float
    alone: float
    blurred: bool
    like: str = ''

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return float(self.value * np.exp(-_QUANTILE * self.deviation))

    @property
    def high(self) -> float:
        """Upper end of the interval."""
        return float(self.value * np.exp(_QUANTILE * self.deviation))

    @property
    def is_told(self) -> bool:
        """Whether the recording says what it is."""
        return self.doubt is None

    @property
    def doubt(self) -> str | None:
        """Why it cannot be told, None if it can."""
        if self.blurred:
            return 'it acts within the noise of the positions'
        if _QUANTILE * self.deviation <= np.log(TOLD):
            return None
        if _QUANTILE * self.alone <= np.log(TOLD):
            return f'{self.like} can make up for it'
        return 'it has hardly any effect here'


@dataclass(frozen=True)
class Fit:
    """What a recording says of a crowd.

    estimates: of the parameters that were fitted, in this order in correlation (P, P), of their
    logarithms; held: names of the numbers that were not; converged: whether the optimiser has
    found the minimum.
    """

    crowd: Crowd
    sensor: Sensor
    estimates: tuple[Estimate, ...]
    correlation: Array
    held: tuple[str, ...]
    converged: bool
    iterations: int

    def narrower(self) -> tuple[Estimate, ...]:
        """Return estimates with the intervals that they had if what cannot be told were held.

        That is, if it were known to be as it is, and as far as it makes a difference. Where an
        attraction may be ten times as strong, less is sure of the repulsion beside it.
        """
        deviations = np.array([each.deviation for each in self.estimates])
        covariance = self.correlation * np.outer(deviations, deviations)
        told = np.array([each.is_told for each in self.estimates])
        across = covariance[np.ix_(told, ~told)]
        explained = across @ np.linalg.solve(covariance[np.ix_(~told, ~told)], across.T)
        left = np.sqrt(np.maximum(np.diag(covariance[np.ix_(told, told)] - explained), 0.0))
        those = (each for each in self.estimates if each.is_told)
        return tuple(
            replace(each, deviation=float(deviation))
            for each, deviation in zip(those, left, strict=True)
            if deviation < _NARROWER * each.deviation
        )


@dataclass(frozen=True)
class _Model(Parameters):
    """All that may be fitted, named as the parameters of a controller."""

    crowd: Crowd
    sensor: Sensor


def fit(
    recordings: Sequence[Recording],
    start: Crowd,
    position_noise: float | None = None,
    velocity_noise: float | None = None,
    leads: Sequence[float] = (0.0,),
    hold: Collection[str] = (),
    step: float = 0.05,
    progress: Progress = lambda iteration, objective: None,
) -> Fit:
    """Return the crowd that explains the recordings, of the kind of `start`.

    position_noise [m], velocity_noise [m/s]: of the sensors; None: what the recordings say, or
    else fitted. leads: how far ahead to predict [s]; 0: the next observation. hold: names of
    parameters that stay as they are, or beginnings of names that end with a dot. Those that are 0
    in the start stay 0. step: longest time step of predictions [s].
    Raises ValueError without anything to fit, for unknown names, and leads beyond a recording.
    """
    if not recordings:
        raise ValueError('there must be a recording to fit to')
    known = _known_noise(recordings, position_noise, velocity_noise)
    model = _Model(start, replace(_USUAL, **known))
    fixed = {f'sensor.{name}' for name in known}
    if not any(np.isfinite(each.v).any() for each in recordings):
        fixed.add('sensor.velocity_noise')
    entries = [e for e in model.walk() if e.name.startswith('crowd.') or e.name in NOISES]
    check_names(hold, entries)
    fitted = [e for e in entries if e.name not in fixed and may_change(e, hold)]
    if not fitted:
        raise ValueError('there must be a parameter to fit, but all are held or 0')
    likelihood = _Likelihood(recordings, model, [e.name for e in fitted], leads, step)
    # What has no effect at all, as the range of a force that is 0, is not fitted either.
    fitted = [e for e, one in zip(fitted, likelihood.have_effect, strict=True) if one]
    likelihood = _Likelihood(recordings, model, [e.name for e in fitted], leads, step)
    theta, converged, iterations = likelihood.minimise(progress)
    at = likelihood.at(theta)
    best = likelihood.model(theta)
    names = {e.name for e in fitted}
    return Fit(
        best.crowd, best.sensor, _estimates(fitted, best, at), at.correlation,
        tuple(e.name for e in entries if type(e.value) is float and e.name not in names),
        converged, iterations,
    )  # fmt: skip


def _known_noise(
    recordings: Sequence[Recording], position: float | None, velocity: float | None
) -> dict[str, float]:
    """Return what is known of the sensors by name. Raises ValueError if recordings disagree."""
    known = {}
    for name, given in (('position_noise', position), ('velocity_noise', velocity)):
        said = {getattr(each, name) for each in recordings} if given is None else {given}
        if len(said) > 1:
            raise ValueError(
                f'{name} must be the same in all recordings, got {sorted(said, key=str)}'
            )
        value = said.pop() if said else None
        if value is not None:
            if not value >= 0.0:
                raise ValueError(f'{name} must be at least 0, got {value:g}')
            known[name] = max(value, _LEAST_NOISE)
    return known


_LEAST_NOISE = 1e-6
"""Exact sensors would make exact observations contradict each other [m, m/s]."""


def check_names(hold: Collection[str], entries: Sequence[Entry]) -> None:
    """Raise ValueError for a name to hold that no parameter has, nor begins with."""
    if isinstance(hold, str):  # a collection of its letters
        raise ValueError(f'hold must be a list of names, got {hold!r}')
    for name in hold:
        if not any(_is_named(entry.name, (name,)) for entry in entries):
            raise ValueError(
                f'hold must be among {", ".join(e.name for e in entries)}, got {name}'
            )


def _is_named(name: str, names: Collection[str]) -> bool:
    """Whether a name is among these, or begins with one that ends with a dot."""
    return any(name == each or (each.endswith('.') and name.startswith(each)) for each in names)


def may_change(entry: Entry, hold: Collection[str]) -> bool:
    """Whether a parameter is fitted: a number above 0 that is not held."""
    positive = type(entry.value) is float and entry.value > 0.0
    return positive and not _is_named(entry.name, (*hold, *_NEVER))


def _blurred(model: _Model, noise: float) -> set[str]:
    """Return names of lengths that positions with this noise do not resolve, and strengths."""
    flat = model.flat()
    return {
        name
        for end in flat
        if end.endswith('_length') and flat[end] < _BLUR * noise
        for name in (end, end.removesuffix('_length'))
    }


def _estimates(fitted: Sequence[Entry], best: _Model, at: _Evaluation) -> tuple[Estimate, ...]:
    deviations = at.deviations
    alone = 1.0 / np.sqrt(np.diag(at.information + _TINY))
    like = (np.abs(at.correlation) - np.eye(len(fitted))).argmax(axis=1)
    blur = _blurred(best, best.sensor.position_noise)
    values = best.flat()
    return tuple(
        Estimate(
            e.name, e.field.metadata['unit'], values[e.name], float(deviations[j]),
            float(alone[j]), e.name in blur, fitted[like[j]].name,
        )
        for j, e in enumerate(fitted)
    )  # fmt: skip


@dataclass(frozen=True)
class _Evaluation:
    """Derivatives of the objective at theta, (P,) and (P, P).

    information: Fisher's, of the recordings alone; hessian: with the prior; scatter: covariance
    of the gradient; covariance: of theta.
    """

    gradient: Array
    information: Array
    hessian: Array
    scatter: Array

    @property
    def covariance(self) -> Array:
        """Godambe's."""
        inverse = np.linalg.inv(self.hessian)
        return inverse @ self.scatter @ inverse

    @property
    def deviations(self) -> Array:
        """Standard deviations of theta (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Array:
        """Of theta, (P, P)."""
        return self.covariance / np.outer(self.deviations, self.deviations)


class _Likelihood:
    """The objective of a fit and its derivatives."""

    def __init__(
        self,
        recordings: Sequence[Recording],
        start: _Model,
        names: Sequence[str],
        leads: Sequence[float],
        step: float,
    ) -> None:
        """Prepare the filters."""
        self._start, self._names = start, list(names)
        values = start.flat()
        self._theta0 = np.log([values[name] for name in names])
        self._prior = np.eye(len(names)) / PRIOR**2
        self._filters = [Filter(each, leads, step) for each in recordings]
        self._last: tuple[bytes, _Evaluation] | None = None

    @property
    def have_effect(self) -> NDArray[np.bool_]:
        """Whether a parameter changes anything, (P,)."""
        return np.diag(self.at(self._theta0).information) > 0.0

    def model(self, theta: Array) -> _Model:
        """Return the model with these logarithms of its parameters."""
        return self._start.with_values(dict(zip(self._names, np.exp(theta).tolist(), strict=True)))

    def minimise(self, progress: Progress) -> tuple[Array, bool, int]:
        """Return where the objective is least, whether that was found, and in how many steps."""
        count, converged = 0, False

        def count_up(theta: Array) -> None:
            nonlocal count, converged
            count += 1
            progress(count, self(theta))
            at = self.at(theta)
            above = 0.5 * at.gradient @ np.linalg.solve(at.hessian, at.gradient)
            converged = bool(above < _CLOSE)
            if converged:
                raise StopIteration

        found = minimize(
            self, self._theta0, method='trust-exact', callback=count_up,
            jac=lambda theta: self.at(theta).gradient, hess=lambda theta: self.at(theta).hessian,
            options={'gtol': 0.0, 'maxiter': _MOST_ITERATIONS,
                     'initial_trust_radius': 0.5, 'max_trust_radius': 2.0},
        )  # fmt: skip
        return found.x, converged, count

    def __call__(self, theta: Array) -> float:
        """Return the objective; infinite where a parameter would be out of its bounds."""
        off = theta - self._theta0
        try:
            model = self.model(theta)
        except ValueError:
            return np.inf
        parts = [_innovations(each, model) for each in self._filters]
        terms = (np.nansum(part.off**2 / part.variance[..., None, :])
                 + 2.0 * np.nansum(np.log(part.variance)) for part in parts)  # fmt: skip
        value = 0.5 * float(sum(terms) + off @ self._prior @ off)
        return value if np.isfinite(value) else np.inf

    def at(self, theta: Array) -> _Evaluation:
        """Return the derivatives at theta; those of the last one are kept."""
        key = theta.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._differentiate(theta)
        return self._last[1]

    def _differentiate(self, theta: Array) -> _Evaluation:
        shifted = [self.model(row) for row in theta + _DIFFERENCE * np.eye(len(theta))]
        models = [self.model(theta), *shifted]
        p = len(theta)
        gradient, information, scatter = np.zeros(p), np.zeros((p, p)), np.zeros((p, p))
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for filter in self._filters:
                runs = list(pool.map(partial(_innovations, filter), models))
                scores, fisher = _scores(runs[0], runs[1:])
                pieces = np.add.reduceat(
                    scores, np.arange(0, scores.shape[1], filter.longest_lead), axis=1
                )
                gradient += scores.sum(axis=1)
                information += fisher
                scatter += pieces @ pieces.T
        gradient += self._prior @ (theta - self._theta0)
        return _Evaluation(gradient, information, information + self._prior, scatter + self._prior)


def _innovations(filter: Filter, model: _Model) -> Innovations:
    return filter.innovations(model.crowd, model.sensor)


def _scores(base: Innovations, shifted: Sequence[Innovations]) -> tuple[Array, Array]:
    """Return the gradient of a recording by instants (P, T), and Fisher's information (P, P)."""
    scale = np.sqrt(base.variance)[..., None, :]
    residual = base.off / scale
    scores, of_means, of_variances = [], [], []
    for each in shifted:
        mean = (each.off - base.off) / (_DIFFERENCE * scale)
        variance = (each.variance / base.variance - 1.0)[..., None, :] / _DIFFERENCE
        variance = np.broadcast_to(variance, residual.shape)
        terms = mean * residual + 0.5 * variance * (1.0 - residual**2)
        scores.append(np.nansum(terms, axis=(1, 2, 3, 4)))
        of_means.append(np.nan_to_num(mean).ravel())
        of_variances.append(np.nan_to_num(variance).ravel())
    a, b = np.array(of_means), np.array(of_variances)
    return np.array(scores), a @ a.T + 0.5 * b @ b.T
