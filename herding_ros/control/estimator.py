"""What the controller believes of the herd: a Kalman filter on noisy observations.

Between two observations everybody is carried forward by the coarse model, with the velocities
that the dogs were told; then each is corrected by what was seen. For the uncertainty, each sheep
and each coordinate is a linear system of its own, of position and velocity, with the model's
friction and random force, as strong as it is where the sheep is. How sheep push each other changes
the prediction alone, and so does what their random forces have in common.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.noise import strength
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array, finite, HerdState

from .parameters import Sensor

_LEAST_NOISE = 0.005
"""Random force that is expected on sheep at least [m/s^1.5], for all that the model leaves out.

A filter that expects none stops looking.
"""

_SLIP = 0.01
"""After t seconds a dog is this times sqrt(t) from where its commands lead [m/s^0.5]."""

_FAR = 6.0
"""Standard deviations between what is seen and what is expected that noise does not explain."""

_LONGEST_GAP = 20
"""Control periods between two observations after which the past is forgotten."""

_Names = NDArray[np.integer]


@dataclass(frozen=True)
class _Tracks:
    """What is believed of n sheep, with k = 2 quantities, or of n dogs, with k = 1.

    names (n,); mean (n, k, 2): position [m] and, of sheep, velocity [m/s]; covariance (n, k, k):
    of their errors, the same in both coordinates; doubted (n,): whether the last observation
    stands alone, so that another one far from it is believed.
    """

    names: _Names
    mean: Array
    covariance: Array
    doubted: NDArray[np.bool_]

    @classmethod
    def new(cls, names: _Names, mean: Array, variances: list[Array | float]) -> _Tracks:
        """Begin with one observation, whose k quantities have these variances, (n,) or one."""
        covariance = np.zeros((len(names), len(variances), len(variances)))
        for q, variance in enumerate(variances):
            covariance[:, q, q] = variance
        return cls(names, mean, covariance, np.full(len(names), True))

    def corrected(self, new: _Tracks, observed: Array, variances: list[float]) -> _Tracks:
        """Return the new tracks, those that continue one of these corrected by what is observed.

        observed: (n, k, 2), in the order of the new tracks.
        """
        _, here, there = np.intersect1d(new.names, self.names, return_indices=True)
        error = observed[here] - self.mean[there]
        uncertainty = self.covariance[there] + np.diag(variances)
        near = np.square(error[:, 0]).sum(axis=1) <= _FAR**2 * uncertainty[:, 0, 0]
        # Far off for once, an observation is taken for a mistake. The second time it is believed.
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
class _Belief:
    """The herd at t [s]."""

    t: float
    sheep: _Tracks
    dogs: _Tracks

    @property
    def state(self) -> HerdState:
        return HerdState(self.sheep.mean[:, 0], self.sheep.mean[:, 1], self.dogs.mean[:, 0])


@dataclass
class StateEstimator:
    """Filters the noise out of observations, one after the other.

    control_period: usual time between two of them [s], predicted in `substeps` steps. Crowd and
    sensor may be replaced between two observations.
    """

    crowd: Crowd
    sensor: Sensor
    control_period: float
    substeps: int
    _belief: _Belief | None = field(default=None, init=False)

    def reset(self) -> None:
        """Forget everything: the next observation is the first."""
        self._belief = None

    def update(
        self,
        t: float,
        ids: _Names,
        observed: HerdState,
        u: Array,
        dogs: _Names | tuple[int, ...] | None = None,
    ) -> HerdState:
        """Return the most likely state at t [s], with the rows of the observation.

        ids: (N,) names of the observed sheep; u: (all dogs, 2) velocities that dogs were told
        since the last update [m/s]; dogs: indices in u of those that are observed, by default
        all. Sheep and dogs come and go: who is new is believed to be where it is seen. When t is
        before the last update, or much later, everybody is new. Where a sheep or dog suddenly is
        far from expected, the first such observation counts as none. A sensor without noise is
        believed to the bit.

        Raises ValueError when names, rows and velocities do not fit.
        """
        u = finite('dog velocities u', u, (None, 2))
        names = np.arange(len(u)) if dogs is None else np.asarray(dogs)
        _check_names(np.asarray(ids), observed.x, 'sheep')
        _check_names(names, observed.d, 'dogs')
        if names.min() < 0 or names.max() >= len(u):
            raise ValueError(f'dogs are {names.tolist()}, allowed is 0 to {len(u) - 1}, rows of u')
        if self.sensor == Sensor():
            return observed
        new = self._first(t, np.asarray(ids), names, observed)
        if self._belief is not None:
            elapsed = t - self._belief.t
            if 0.0 <= elapsed <= _LONGEST_GAP * self.control_period:
                expected = self._predicted(self._belief, elapsed, u) if elapsed else self._belief
                new = self._corrected(expected, new, observed)
        self._belief = new
        return new.state

    def _force(self, t: float, x: Array) -> Array:
        """Strength of the random force that is expected on sheep at x [m/s^1.5], (n,) or ()."""
        return np.maximum(strength(self.crowd, t, x), _LEAST_NOISE)

    @property
    def _variances(self) -> tuple[float, float]:
        """Of observed positions [m^2] and velocities [m^2/s^2]."""
        # Never zero: no two of them would fit together.
        return (
            max(self.sensor.position_noise, TINY) ** 2,
            max(self.sensor.velocity_noise, TINY) ** 2,
        )

    def _first(self, t: float, ids: _Names, dogs: _Names, observed: HerdState) -> _Belief:
        """Return what is known from one observation: sheep seldom run faster than at random."""
        position, velocity = self._variances
        # Friction and random force alone give velocities the variance sigma^2 / (2 alpha).
        force = self._force(t, observed.x)
        share = force**2 / (force**2 + 2.0 * self.crowd.friction * velocity)
        sheep = np.stack([observed.x, share[..., None] * observed.v], axis=1)
        return _Belief(
            t,
            _Tracks.new(ids, sheep, [position, share * velocity]),
            _Tracks.new(dogs, observed.d[:, None], [position]),
        )

    def _predicted(self, belief: _Belief, elapsed: float, u: Array) -> _Belief:
        """Carry everybody forward by the coarse model."""
        steps = max(round(elapsed * self.substeps / self.control_period), 1)
        dt = elapsed / steps
        # A force of shorter range than the noise would be wrong, taken from such positions, and
        # throw sheep apart that only seem to be close.
        noise, crowd = self.sensor.position_noise, self.crowd
        crowd = replace(
            crowd,
            sheep=crowd.sheep.without_ranges_below(noise),
            dog=crowd.dog.without_ranges_below(noise),
        )
        end = rollout(crowd, belief.state, u[None, belief.dogs.names], dt, steps).at(-1)
        step = np.array([[1.0, dt], [0.0, 1.0 - crowd.friction * dt]])
        force = self._force(belief.t, belief.state.x)[..., None, None] ** 2 * np.diag([0.0, dt])
        covariance = belief.sheep.covariance
        for _ in range(steps):
            covariance = step @ covariance @ step.T + force
        slipped = belief.dogs.covariance + _SLIP**2 * elapsed
        return replace(
            belief,
            sheep=replace(
                belief.sheep, mean=np.stack([end.x, end.v], axis=1), covariance=covariance
            ),
            dogs=replace(belief.dogs, mean=end.d[:, None], covariance=slipped),
        )

    def _corrected(self, expected: _Belief, new: _Belief, observed: HerdState) -> _Belief:
        position, velocity = self._variances
        sheep = np.stack([observed.x, observed.v], axis=1)
        return _Belief(
            new.t,
            expected.sheep.corrected(new.sheep, sheep, [position, velocity]),
            expected.dogs.corrected(new.dogs, observed.d[:, None], [position]),
        )


def _check_names(names: _Names, points: Array, what: str) -> None:
    if names.shape != (len(points),):
        raise ValueError(
            f'names of {what} have shape {names.shape}, allowed is ({len(points)},), '
            'one for each that was observed'
        )
