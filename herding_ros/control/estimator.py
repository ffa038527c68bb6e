# SPDX-License-Identifier: Apache-2.0
"""A Kalman filter on noisy observations of the herd.

Between two observations the herd is predicted by the coarse model under the commanded velocities;
then each sheep and dog is corrected by its observation. For the covariance, each coordinate of
each sheep is a linear system of its own, of position and velocity, with the friction and the
random force at the sheep's place; alignment adds to the friction. In a crowd of first order the
velocity follows from the positions, and what is observed of it is not used. The forces between
sheep, and the part of the random force that they have in common, change the prediction but not
the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

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

_LONGEST_GAP = 20
"""After so many control periods without an observation the filter starts afresh."""

_Names = NDArray[np.integer]


@dataclass(frozen=True)
class _Tracks:
    """Estimates of n sheep, with k = 2 quantities, or of n dogs, with k = 1.

    names (n,); mean (n, k, 2): position [m] and, of sheep, velocity [m/s]; covariance (n, k, k):
    of their errors, the same in both coordinates; doubted (n,): whether the last observation was
    the first or an outlier, so that another outlier replaces the estimate.
    """

    names: _Names
    mean: Array
    covariance: Array
    doubted: NDArray[np.bool_]

    @classmethod
    def new(cls, names: _Names, mean: Array, variances: list[Array | float]) -> _Tracks:
        """Start from one observation, whose k quantities have these variances, (n,) or one."""
        covariance = np.zeros((len(names), len(variances), len(variances)))
        for q, variance in enumerate(variances):
            covariance[:, q, q] = variance
        return cls(names, mean, covariance, np.full(len(names), True))

    def corrected(self, new: _Tracks, observed: Array, variances: list[float]) -> _Tracks:
        """Return `new`, except that tracks of the same names continue, corrected by `observed`.

        observed: (n, k, 2), in the order of the new tracks.
        """
        _, here, there = np.intersect1d(new.names, self.names, return_indices=True)
        error = observed[here] - self.mean[there]
        uncertainty = self.covariance[there] + np.diag(variances)
        near = np.square(error[:, 0]).sum(axis=1) <= _FAR**2 * uncertainty[:, 0, 0]
        # A single outlier is ignored; a second one in a row replaces the estimate.
        known = near | ~self.doubted[there]
        here, there, near = here[known], there[known], near[known]
        before = self.covariance[there]
        gain = near[:, None, None] * (before @ np.linalg.inv(uncertainty[known]))
        mean, covariance, doubted = new.mean.copy(), new.covariance.copy(), new.doubted.copy()
        mean[here] = self.mean[there] + gain @ error[known]
        covariance[here] = before - gain @ before
        doubted[here] = ~near
        return _Tracks(new.names, mean, covariance, doubted)


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
    """

    crowd: Crowd
    sensor: Sensor
    control_period: float
    substeps: int
    motion: MotionModel = Holonomic()
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
    ) -> HerdState:
        """Return the most likely state at t [s], with the rows of the observation.

        ids: (N,) names of the observed sheep; u: (all dogs, 2) velocities commanded since the
        last update [m/s]; dogs: indices in u of the observed dogs, by default all. Sheep and dogs
        may come and go: a new one's estimate is its observation. When t is before the last
        update, or much later, all are new. A single outlier is ignored. Without sensor noise the
        observation itself is returned.

        Raises ValueError if names, rows and velocities do not match.
        """
        u = finite('dog velocities u', u, (None, 2))
        names = np.arange(len(u)) if dogs is None else np.asarray(dogs)
        _check_names(np.asarray(ids), observed.x, 'sheep')
        _check_names(names, observed.d, 'dogs')
        if names.min() < 0 or names.max() >= len(u):
            raise ValueError(f'dogs must be rows of u, 0 to {len(u) - 1}, got {names.tolist()}')
        if not (self.sensor.position_noise or self.sensor.velocity_noise):
            return observed
        new = self._first(t, np.asarray(ids), names, observed)
        if self._estimate is not None:
            elapsed = t - self._estimate.t
            if 0.0 <= elapsed <= _LONGEST_GAP * self.control_period:
                expected = self._estimate
                if elapsed:
                    expected = self._predicted(expected, elapsed, u)
                new = self._corrected(expected, new, observed)
        self._estimate = new
        return new.state

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

    def _first(self, t: float, ids: _Names, dogs: _Names, observed: HerdState) -> _Estimate:
        """Return the estimate from one observation, with the stationary velocities as prior."""
        position, velocity = self._variances
        # Friction and random force alone give velocities the variance sigma^2 / (2 alpha).
        force = self._force(t, observed.x)
        share = force**2 / (force**2 + 2.0 * self.crowd.friction * velocity)
        sheep = np.stack([observed.x, share[..., None] * observed.v], axis=1)
        return _Estimate(
            t,
            _Tracks.new(ids, sheep, [position, share * velocity]),
            _Tracks.new(dogs, observed.dogs[:, None], [position]),
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

    def _corrected(self, expected: _Estimate, new: _Estimate, observed: HerdState) -> _Estimate:
        position, velocity = self._variances
        sheep = np.stack([observed.x, observed.v], axis=1)
        return _Estimate(
            new.t,
            expected.sheep.corrected(new.sheep, sheep, [position, velocity]),
            expected.dogs.corrected(new.dogs, observed.dogs[:, None], [position]),
            new.rest,
        )


def _check_names(names: _Names, points: Array, what: str) -> None:
    if names.shape != (len(points),):
        raise ValueError(
            f'names of {what}: expected shape ({len(points)},), one for each observed, '
            f'got {names.shape}'
        )
