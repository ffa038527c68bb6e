"""What the controller believes of the herd: a Kalman filter on noisy observations.

Between two observations everybody is carried forward by the coarse model, with the velocities
that the dogs were told; then each is corrected by what was seen. The position and velocity of a
sheep, and in the same way x and y, are taken for a linear system of its own, with the model's
friction and random force. How sheep push each other changes the prediction, not its uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from herding_ros.model.dynamics import rollout
from herding_ros.model.parameters import Crowd, Morse
from herding_ros.model.state import Array, finite, HerdState

from .parameters import Sensor

_LEAST_NOISE = 0.005
"""Random force that is expected on sheep at least [m/s^1.5], for all that the model leaves out.

A filter that expects none stops looking.
"""

_SLIP = 0.01
"""After t seconds a dog is this times sqrt(t) from where its commands lead [m/s^0.5]."""

_SURPRISE = 6.0
"""Who is seen this many standard deviations from where it should be is not the one we knew."""

_LONGEST_GAP = 20
"""Control periods between two observations after which the past is forgotten."""

_Names = NDArray[np.integer]


@dataclass(frozen=True)
class _Belief:
    """The herd at t [s], and how well it is known.

    ids (N,), dogs (M,): names of the rows of the state; covariance: (N, 2, 2) of the errors of
    position and velocity of a sheep, in each coordinate; variance: (M,) of dogs' positions [m^2].
    """

    t: float
    ids: _Names
    dogs: _Names
    state: HerdState
    covariance: Array
    variance: Array


@dataclass
class Estimator:
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
        """Forget everything: the next observation is believed."""
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

        ids: (N,) names of the observed sheep; dogs: indices of the observed dogs in u, by default
        all; u: (all dogs, 2) velocities that dogs were told since the last update [m/s]. Sheep
        and dogs come and go: who is new is believed to be where it is seen. When t is not later
        than at the last update, or much later, everybody is new. A sensor without noise is
        believed to the bit. Raises ValueError when names, rows and velocities do not fit.
        """
        u = finite('dog velocities u', u, (None, 2))
        names = np.arange(len(u)) if dogs is None else np.asarray(dogs)
        _check(np.asarray(ids), observed.x, 'sheep')
        _check(names, observed.d, 'dogs')
        if names.min() < 0 or names.max() >= len(u):
            raise ValueError(f'dogs are {names.tolist()}, allowed is 0 to {len(u) - 1}, rows of u')
        if self.sensor == Sensor():
            return observed
        new = self._believed(t, np.asarray(ids), names, observed)
        if self._belief is not None:
            elapsed = t - self._belief.t
            if 0.0 < elapsed <= _LONGEST_GAP * self.control_period:
                new = self._corrected(self._predicted(self._belief, elapsed, u), new, observed)
        self._belief = new
        return new.state

    @property
    def _noise(self) -> float:
        return max(self.crowd.noise, _LEAST_NOISE)

    def _believed(self, t: float, ids: _Names, dogs: _Names, observed: HerdState) -> _Belief:
        """Return what is known from one observation: sheep seldom run faster than at random."""
        position, velocity = self.sensor.position_noise**2, self.sensor.velocity_noise**2
        # Random force and friction alone: variance sigma^2 / (2 alpha) of a velocity.
        share = self._noise**2 / (self._noise**2 + 2.0 * self.crowd.friction * velocity)
        covariance = np.tile(np.diag([position, share * velocity]), (len(ids), 1, 1))
        state = HerdState(observed.x, share * observed.v, observed.d)
        return _Belief(t, ids, dogs, state, covariance, np.full(len(dogs), position))

    def _predicted(self, belief: _Belief, elapsed: float, u: Array) -> _Belief:
        """Carry everybody forward by the coarse model."""
        steps = max(round(elapsed * self.substeps / self.control_period), 1)
        dt = elapsed / steps
        noise, crowd = self.sensor.position_noise, self.crowd
        crowd = replace(crowd, sheep=_wide(crowd.sheep, noise), dog=_wide(crowd.dog, noise))
        state = rollout(crowd, belief.state, u[None, belief.dogs], dt, steps).at(-1)
        step = np.array([[1.0, dt], [0.0, 1.0 - crowd.friction * dt]])
        force = np.diag([0.0, self._noise**2 * dt])
        covariance = belief.covariance
        for _ in range(steps):
            covariance = step @ covariance @ step.T + force
        variance = belief.variance + _SLIP**2 * elapsed
        return replace(belief, state=state, covariance=covariance, variance=variance)

    def _corrected(self, old: _Belief, new: _Belief, observed: HerdState) -> _Belief:
        """Return what is believed of all who are seen now, from what was expected of them."""
        position, velocity = self.sensor.position_noise**2, self.sensor.velocity_noise**2
        x, v, d = new.state.x.copy(), new.state.v.copy(), new.state.d.copy()
        covariance, variance = new.covariance.copy(), new.variance.copy()

        offset, here, there = _offsets(observed.x, new.ids, old.state.x, old.ids)
        uncertainty = old.covariance[there] + np.diag([position, velocity])
        known = _expected(offset, uncertainty[:, 0, 0])
        here, there = here[known], there[known]
        gain = old.covariance[there] @ np.linalg.inv(uncertainty[known])
        change = gain @ np.stack([offset[known], observed.v[here] - old.state.v[there]], axis=1)
        x[here] = old.state.x[there] + change[:, 0]
        v[here] = old.state.v[there] + change[:, 1]
        covariance[here] = old.covariance[there] - gain @ old.covariance[there]

        offset, here, there = _offsets(observed.d, new.dogs, old.state.d, old.dogs)
        known = _expected(offset, old.variance[there] + position)
        here, there = here[known], there[known]
        share = old.variance[there] / (old.variance[there] + position)
        d[here] = old.state.d[there] + share[:, None] * offset[known]
        variance[here] = (1.0 - share) * old.variance[there]
        return replace(new, state=HerdState(x, v, d), covariance=covariance, variance=variance)


def _check(names: _Names, points: Array, what: str) -> None:
    if names.shape != (len(points),):
        raise ValueError(
            f'names of {what} have shape {names.shape}, allowed is ({len(points)},), '
            'one for each that was observed'
        )


def _wide(force: Morse, noise: float) -> Morse:
    """Return a force without what has a shorter range than the noise [m].

    Taken from positions that uncertain it would be wrong, and throw sheep apart that only seem
    to be close.
    """
    return replace(
        force,
        repulsion=force.repulsion if force.repulsion_length > noise else 0.0,
        attraction=force.attraction if force.attraction_length > noise else 0.0,
    )


def _offsets(
    seen: Array, names: _Names, expected: Array, old_names: _Names
) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
    """Return how far the known are from where they should be, and their rows, new and old."""
    _, here, there = np.intersect1d(names, old_names, return_indices=True)
    return seen[here] - expected[there], here, there


def _expected(offset: Array, variance: Array) -> NDArray[np.bool_]:
    """Whether offsets (n, 2) [m] are such as a variance (n,) [m^2] of each coordinate explains."""
    return np.square(offset).sum(axis=1) <= _SURPRISE**2 * variance
