# SPDX-License-Identifier: Apache-2.0
"""A Kalman filter on noisy observations of the herd.

Between two observations the herd is predicted by the coarse model under the commanded velocities;
then each sheep and dog is corrected by its observation. For the covariance, each coordinate of
each sheep is a linear system of its own, of position and velocity, with the friction and the
random force at the sheep's place; alignment adds to the friction. In a crowd of first order the
velocity follows from the positions, and what is observed of it is not used. The forces between
sheep, and the part of the random force that they have in common, change the prediction but not
the covariance.

Where velocities are not observed, positions and model make them. Sheep out of sight are predicted
like the others, until `Sensor.timeout`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math
from typing import Any

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import alignment_rates, rollout
from herding_ros.model.motion import Holonomic, MotionModel
from herding_ros.model.noise import strength
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array, finite, HerdState
import numpy as np
from numpy.typing import NDArray

from .parameters import Sensor

_FAR = 6.0
"""An observation this many standard deviations from its prediction is an outlier."""

_Names = NDArray[np.integer]


@dataclass(frozen=True)
class _Tracks:
    """Estimates of n sheep, with k = 2 quantities, or of n dogs, with k = 1.

    names (n,); mean (n, k, 2): position [m] and, of sheep, velocity [m/s]; covariance (n, k, k):
    of their errors, the same in both coordinates; doubted (n,): whether the last observation was
    the first or an outlier, so that another outlier replaces the estimate; seen (n,): when the
    last observation was [s].
    """

    names: _Names
    mean: Array
    covariance: Array
    doubted: NDArray[np.bool_]
    seen: Array

    @classmethod
    def new(cls, t: float, names: _Names, mean: Array, variances: list[Array | float]) -> _Tracks:
        """Start from one at t [s], whose k quantities have these variances, (n,) or one."""
        covariance = np.zeros((len(names), len(variances), len(variances)))
        for q, variance in enumerate(variances):
            covariance[:, q, q] = variance
        return cls(names, mean, covariance, np.full(len(names), True), np.full(len(names), t))

    def corrected(self, new: _Tracks, observed: Array, variances: list[float]) -> _Tracks:
        """Return `new`, except that tracks of the same names continue, corrected by `observed`.

        observed: (n, k, 2), in the order of the new tracks, NaN for what was not.
        """
        _, here, there = np.intersect1d(new.names, self.names, return_indices=True)
        error = observed[here] - self.mean[there]
        uncertainty = self.covariance[there] + np.diag(variances)
        is_seen = np.isfinite(error[..., 0])
        error[~is_seen] = 0.0
        # Of what was not observed nothing follows for the rest: no correlation, and no gain.
        pairs = is_seen[:, :, None] & is_seen[:, None]
        uncertainty = np.where(pairs, uncertainty, np.eye(len(variances)))
        near = np.square(error[:, 0]).sum(axis=1) <= _FAR**2 * uncertainty[:, 0, 0]
        # A single outlier is ignored; a second one in a row replaces the estimate.
        known = near | ~self.doubted[there]
        here, there, near = here[known], there[known], near[known]
        before = self.covariance[there]
        weights = pairs[known] * np.linalg.inv(uncertainty[known])
        gain = near[:, None, None] * (before @ weights)
        mean, covariance, doubted = new.mean.copy(), new.covariance.copy(), new.doubted.copy()
        mean[here] = self.mean[there] + gain @ error[known]
        covariance[here] = before - gain @ before
        doubted[here] = ~near
        return replace(new, mean=mean, covariance=covariance, doubted=doubted)

    def some(self, rows: NDArray[np.bool_]) -> _Tracks:
        """Return some of the tracks."""
        return _Tracks(*(each[rows] for each in self._parts()))

    def joined(self, other: _Tracks) -> _Tracks:
        """Return these tracks, then the other ones."""
        parts = zip(self._parts(), other._parts(), strict=True)
        return _Tracks(*(np.concatenate(each) for each in parts))

    def _parts(self) -> tuple[Any, ...]:
        return self.names, self.mean, self.covariance, self.doubted, self.seen


@dataclass(frozen=True)
class _Estimate:
    """Of the herd at t [s]; rest (M, S - 2): what the dogs' states hold besides positions.

    Positions of dogs are filtered, the rest is taken as it was observed last.
    """

    t: float
    sheep: _Tracks
    dogs: _Tracks
    rest: Array

    @property
    def state(self) -> HerdState:
        dogs = np.hstack([self.dogs.mean[:, 0], self.rest])
        return HerdState(self.sheep.mean[:, 0], self.sheep.mean[:, 1], dogs)


@dataclass
class StateEstimator:
    """Filters the noise out of successive observations.

    control_period: usual time between two observations [s], predicted in `substeps` steps. Crowd
    and sensor may be replaced between two observations.

    After an update, ids are the names (N,) of the sheep that the state has: those that were
    observed, and then the `carried` ones out of sight. lost: names of those that it has no more;
    is_new: whether the last observation was too long ago to go on from.
    """

    crowd: Crowd
    sensor: Sensor
    control_period: float
    substeps: int
    motion: MotionModel = Holonomic()
    ids: _Names = field(default_factory=lambda: np.empty(0, dtype=np.int_), init=False)
    carried: int = field(default=0, init=False)
    lost: tuple[int, ...] = field(default=(), init=False)
    is_new: bool = field(default=False, init=False)
    _estimate: _Estimate | None = field(default=None, init=False)

    def reset(self) -> None:
        """Start afresh with the next observation."""
        self._estimate = None

    def update(
        self,
        t: float,
        ids: _Names,
        observed: HerdState,
        u: Array,
        dogs: _Names | tuple[int, ...] | None = None,
        is_velocity_seen: NDArray[np.bool_] | None = None,
    ) -> HerdState:
        """Return the most likely state at t [s], first the rows of the observation.

        ids: (N,) names of the observed sheep; u: (all dogs, 2) mean velocities commanded since
        the last update [m/s]; dogs: indices in u of the observed dogs, by default all;
        is_velocity_seen: (N,), by default all: of the others only the position counts. Sheep and
        dogs may come and go: a new one's estimate is its observation, sheep out of sight follow
        after the observed ones until `Sensor.timeout`. When t is before the last update, or that
        much later, all are new. A single outlier is ignored. Without sensor noise the observation
        itself is returned.

        Raises ValueError if names, rows and velocities do not match, and where there are neither
        velocities nor a noise to estimate them with.
        """
        u = finite('dog velocities u', u, (None, 2))
        names = np.arange(len(u)) if dogs is None else np.asarray(dogs)
        _check_names(np.asarray(ids), observed.x, 'sheep')
        _check_names(names, observed.d, 'dogs')
        if names.min() < 0 or names.max() >= len(u):
            raise ValueError(f'dogs must be rows of u, 0 to {len(u) - 1}, got {names.tolist()}')
        v = observed.v
        if is_velocity_seen is not None:
            _check_names(is_velocity_seen, observed.v, 'sheep whose velocity is seen')
        if is_velocity_seen is not None and not is_velocity_seen.all():
            if not self.sensor.position_noise:
                raise ValueError(
                    'sensor.position_noise must be above 0 where sheep have no velocities, got 0: '
                    'these are estimated from positions and their noise'
                )
            v = np.where(np.reshape(is_velocity_seen, (-1, 1)), v, np.nan)
        self.ids, self.carried, self.lost, self.is_new = np.asarray(ids), 0, (), False
        if self.sensor.is_exact:
            return observed
        seen = np.stack([observed.x, v], axis=1)
        new = self._first(t, self.ids, names, seen, observed)
        if self._estimate is not None and self._estimate.t <= t:
            expected, elapsed = self._estimate, t - self._estimate.t
            self.is_new = elapsed > self.sensor.timeout
            if not self.is_new:
                if elapsed:
                    expected = self._predicted(expected, elapsed, u)
                new = self._corrected(expected, new, seen, observed)
            new = self._with_those_out_of_sight(expected, new)
        self._estimate = new
        return new.state

    def _with_those_out_of_sight(self, expected: _Estimate, new: _Estimate) -> _Estimate:
        """Let tracks go on that have no observation, unless it is too long ago."""
        hidden = expected.sheep.some(~np.isin(expected.sheep.names, new.sheep.names))
        is_lost = new.t - hidden.seen >= self.sensor.timeout
        carried = hidden.some(~is_lost)
        self.lost = tuple(hidden.names[is_lost].tolist())
        self.carried = len(carried.names)
        sheep = new.sheep.joined(carried)
        self.ids = sheep.names
        return replace(new, sheep=sheep)

    @property
    def deviations(self) -> tuple[float, float] | None:
        """Of the estimated positions [m] and velocities [m/s] of sheep, root mean squares.

        They are standard deviations of a coordinate. None if nothing is filtered.
        """
        if self._estimate is None:
            return None
        covariance = self._estimate.sheep.covariance.mean(axis=0)
        return math.sqrt(covariance[0, 0]), math.sqrt(covariance[1, 1])

    def _force(self, t: float, x: Array) -> Array:
        """Return the strength of the random force on sheep at x [m/s^1.5], (n,) or ()."""
        return np.maximum(strength(self.crowd, t, x), self.sensor.model_noise)

    @property
    def _variances(self) -> tuple[float, float]:
        """Of observed positions [m^2] and velocities [m^2/s^2]."""
        # Never zero: exact observations would contradict each other.
        return (
            max(self.sensor.position_noise, TINY) ** 2,
            max(self.sensor.velocity_noise, TINY) ** 2,
        )

    def _first(
        self, t: float, ids: _Names, dogs: _Names, seen: Array, observed: HerdState
    ) -> _Estimate:
        """Return the estimate from one observation, with the stationary velocities as prior."""
        position, velocity = self._variances
        # Friction and random force alone give velocities the variance sigma^2 / (2 alpha).
        force = self._force(t, observed.x)
        share = force**2 / (force**2 + 2.0 * self.crowd.friction * velocity)
        is_seen = np.isfinite(seen[:, 1, 0])
        likely = force**2 / (2.0 * max(self.crowd.friction, TINY))
        variance = np.where(is_seen, share * velocity, likely)
        mean = np.stack([seen[:, 0], share[..., None] * seen[:, 1]], axis=1)
        mean[~is_seen, 1] = 0.0
        return _Estimate(
            t,
            _Tracks.new(t, ids, mean, [position, variance]),
            _Tracks.new(t, dogs, observed.dogs[:, None], [position]),
            observed.d[:, 2:],
        )

    def _predicted(self, before: _Estimate, elapsed: float, u: Array) -> _Estimate:
        """Predict by the coarse model."""
        steps = max(round(elapsed * self.substeps / self.control_period), 1)
        dt = elapsed / steps
        # At noisy positions, a force of shorter range than the noise would be wrong and throw
        # sheep apart that only seem to be close.
        noise, crowd = self.sensor.position_noise, self.crowd
        crowd = replace(
            crowd,
            sheep=crowd.sheep.without_ranges_below(noise),
            dog=crowd.dog.without_ranges_below(noise),
        )
        commands = u[None, before.dogs.names]
        end = rollout(crowd, before.state, commands, dt, steps, motion=self.motion).at(-1)
        if crowd.order == 1:
            step, driven = np.diag([1.0, 0.0]), [dt / crowd.friction**2, 0.0]
        else:
            friction = crowd.friction + alignment_rates(crowd, before.state.x)
            step = np.tile([[1.0, dt], [0.0, 1.0]], (len(friction), 1, 1))
            step[:, 1, 1] -= dt * friction
            driven = [0.0, dt]
        force = self._force(before.t, before.state.x)[..., None, None] ** 2 * np.diag(driven)
        covariance = before.sheep.covariance
        for _ in range(steps):
            covariance = step @ covariance @ np.swapaxes(step, -1, -2) + force
        slipped = before.dogs.covariance + self.sensor.slip**2 * elapsed
        return replace(
            before,
            sheep=replace(
                before.sheep, mean=np.stack([end.x, end.v], axis=1), covariance=covariance
            ),
            dogs=replace(before.dogs, mean=end.dogs[:, None], covariance=slipped),
        )

    def _corrected(
        self, expected: _Estimate, new: _Estimate, seen: Array, observed: HerdState
    ) -> _Estimate:
        position, velocity = self._variances
        return _Estimate(
            new.t,
            expected.sheep.corrected(new.sheep, seen, [position, velocity]),
            expected.dogs.corrected(new.dogs, observed.dogs[:, None], [position]),
            new.rest,
        )


def _check_names(names: NDArray[Any], points: Array, what: str) -> None:
    if names.shape != (len(points),):
        raise ValueError(
            f'names of {what}: expected shape ({len(points)},), one for each observed, '
            f'got {names.shape}'
        )
