# SPDX-License-Identifier: Apache-2.0
"""Estimators of the expected centre of a flock by Monte Carlo.

An estimator is a chain of models that see the same noise, the last of them the fine model. With
Y_l the centre in model l less a control variate of mean zero,

    E[Y_L] = E[Y_0] + sum_l E[Y_l - Y_(l-1)],

each mean by paths of its own (multilevel Monte Carlo; Giles 2008). A chain of one model is
plain Monte Carlo. What a model leaves out changes the cost of its paths, not the expectation.

Control variates (Glasserman 2003, section 4.1) are sums of the increments dB with weights that
do not depend on them, so their mean is exactly zero, whatever the noise on a sheep depends on.
Their coefficient is one: that of a regression is close to it, and would be biased.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from . import kernels
from .crowd import Crowd
from .dynamics import follow, march, physics, positions, to_lanes
from .kernels import PATHS
from .motion import Holonomic, MotionModel
from .noise import increments, is_uniform, noise_paths, random_force
from .state import Array, HerdState

Sampler = Callable[[Array], Array]
"""From the noise (K', 2, N * paths) [m/s] of some paths to centres (K'+1, 2, paths) [m]."""

_LARGE = 512
"""Flocks with more sheep are computed path by path, rather than PATHS paths at once."""

_STEP_PER_RELAXATION = 0.2
_LONGEST_STEP = 4
"""Time step of sheep that only dogs act on: in units of 1 / friction, and at most [commands].

Dogs and their forces hardly change meanwhile.
"""
_PAIRS_PER_SHEEP = 5.0
"""Cost of drawing noise for a sheep and moving it, in evaluations of the force of a pair."""


@dataclass(frozen=True)
class FineModel:
    """The crowd with noise over a window: from a state (N sheep, M dogs), K = steps of dt [s].

    It begins at t [s], which counts when the noise depends on time. A control u
    (K / substeps, M, 2) [m/s] is constant for `substeps` steps.
    """

    crowd: Crowd
    state: HerdState
    dt: float
    steps: int
    substeps: int = 1
    t: float = 0.0
    motion: MotionModel = Holonomic()

    @property
    def sheep(self) -> int:
        """Number of sheep N."""
        return len(self.state.x)

    @property
    def at_once(self) -> int:
        """Number of paths in a block: those computed at once, side by side in memory."""
        return PATHS if self.sheep <= _LARGE else 1

    def draw(self, rng: np.random.Generator, longer: int) -> Array:
        """Draw a block of sigma dB, (K / longer, 2, N * at_once) [m/s], in steps of longer dt."""
        dt, steps = longer * self.dt, self.steps // longer
        if self.at_once == PATHS:
            return noise_paths(rng, self.crowd, self.sheep, dt, steps, PATHS).blocks[0]
        drawn = increments(rng, self.crowd, self.sheep, dt, steps)
        return np.ascontiguousarray(drawn[:, :, : self.sheep])

    def longer(self, noise: Array) -> int:
        """Return the length of the steps of a noise, in units of dt."""
        return self.steps // len(noise)

    def dogs(self, u: Array) -> Array:
        """Return the states of the dogs under u, (K+1, S, M)."""
        return self.motion.rollout(self.state.d, u, self.dt, self.substeps)


@dataclass(frozen=True)
class Resolution:
    """How finely the crowd is resolved: in flocks that do not interact, and in time.

    group: sheep in each of these flocks, the first ones by number, then the next; None: all.
    longer: time step in units of the fine model's, a divisor of their number.

    Forces between sheep do not move their centre, and it is the same when two swap places in a
    collision. So even sheep that only dogs act on have nearly the same centre (`alone`).
    """

    group: int | None = None
    longer: int = 1

    def work(self, fine: FineModel) -> float:
        """Return the cost of a path, in paths of the fine model."""
        other = len(fine.state.d) + _PAIRS_PER_SHEEP
        group = self.group or fine.sheep
        whole = 0.5 * (fine.sheep - 1) + other
        return (0.5 * (group - 1) + other) / whole / self.longer

    def sampler(self, fine: FineModel, u: Array) -> Sampler:
        """Return the centre under the control u as a function of the noise."""
        group = self.group or fine.sheep
        constants = physics(fine.crowd, group, self.longer * fine.dt)
        x, v = (np.ascontiguousarray(each.T) for each in (fine.state.x, fine.state.v))
        states = fine.dogs(u)[:: self.longer]
        dogs = positions(states)

        def side_by_side(noise: Array) -> Array:
            out = np.empty((len(noise) + 1, 2, fine.at_once))
            if is_uniform(fine.crowd.noise_field):
                kernels.centres(x, v, dogs, noise, constants, out)
            else:
                xs = _paths_in_field(fine.crowd, fine.t, x, v, dogs, noise, constants)
                for k, here in enumerate(xs):
                    out[k] = here.reshape(2, fine.sheep, -1).mean(axis=1)
            return out

        def one_by_one(noise: Array) -> Array:
            total = np.zeros((len(noise) + 1, 2))
            for first in range(0, fine.sheep, group):
                some = slice(first, first + group)
                herd = HerdState(fine.state.x[some], fine.state.v[some], fine.state.d)
                drawn = np.stack([to_lanes(each.T) for each in noise[:, :, some]])
                path = follow(fine.crowd, herd, states, constants.dt, drawn, fine.t)
                total += path.x.sum(axis=1)
            return total[:, :, None] / fine.sheep

        return one_by_one if fine.at_once == 1 and group > 1 else side_by_side


def _paths_in_field(
    crowd: Crowd,
    t: float,
    x: Array,
    v: Array,
    d: Array,
    noise: Array,
    constants: kernels.Physics,
) -> Iterator[Array]:
    """Yield the positions in some paths at each step, where the noise depends on time and place.

    They start at t [s] from x, v (2, N), with the dogs on the path d (K+1, 2, M); noise
    (K, 2, N * paths) has the paths of a sheep side by side, and so have the positions
    (2, N * paths) [m].
    """
    xs, vs = (np.repeat(each, noise.shape[2] // x.shape[1], axis=1) for each in (x, v))
    a = np.empty_like(xs)

    def acceleration(k: int, here: Array, velocities: Array) -> Array:
        kernels.acceleration_in_paths(here, velocities, d[k], constants, a)
        return a

    def noise_at(k: int, here: Array) -> Array:
        return random_force(crowd, t + k * constants.dt, here, noise[k])

    for here, _ in march(xs, vs, len(noise), constants, acceleration, noise_at):
        yield here


def alone(fine: FineModel) -> Resolution:
    """Return sheep that only dogs act on, with a time step as long as friction and dogs allow."""
    friction = fine.crowd.friction
    relaxed = _STEP_PER_RELAXATION / friction / fine.dt if friction else np.inf
    longest = min(_LONGEST_STEP * fine.substeps, relaxed)
    most = min(max(int(longest * (1.0 + 1e-9)), 1), fine.steps)
    return Resolution(1, next(k for k in range(most, 0, -1) if fine.steps % k == 0))


Variate = Callable[[FineModel, Array], Sampler]
"""From the fine model and a control to a control variate."""


def no_variate(fine: FineModel, u: Array) -> Sampler:
    """Return zero: no control variate."""
    return lambda noise: np.zeros((1, 1, 1))


def free(fine: FineModel, u: Array) -> Sampler:
    """Return the centre of free sheep, f: f'' = -alpha f' + mean of sigma dB, f = f' = 0 at 0.

    In a crowd of first order alpha f' is that mean.
    It is the direct effect of the noise on the centre; the effect through the forces of the dogs
    remains. It costs next to nothing.
    """

    def sample(noise: Array) -> Array:
        out = np.empty((len(noise) + 1, 2, fine.at_once))
        constants = physics(fine.crowd, fine.sheep, fine.longer(noise) * fine.dt)
        kernels.free_centres(noise, fine.sheep, constants, out)
        return out

    return sample


@dataclass(frozen=True)
class MonteCarloEstimator:
    """A chain of models, the fine one last, less a control variate.

    antithetic: each path is the mean of two with opposite noise. Steps get shorter along the
    chain, by whole factors.
    """

    chain: Callable[[FineModel], tuple[Resolution, ...]] = lambda fine: (Resolution(),)
    variate: Variate = no_variate
    antithetic: bool = False

    def levels(self, fine: FineModel) -> tuple[Level, ...]:
        """Return the terms of the sum, from the coarsest model on."""
        chain = self.chain(fine)
        # The two paths that a variance needs are enough for the centre of a large flock.
        in_pairs = self.antithetic and fine.at_once == PATHS
        return tuple(
            Level(fine, each, below, self.variate, in_pairs)
            for each, below in zip(chain, (None, *chain[:-1]), strict=True)
        )


@dataclass(frozen=True)
class Level:
    """A term of the sum: the mean of a model's centre, less that of the model below if any."""

    fine: FineModel
    resolution: Resolution
    below: Resolution | None
    variate: Variate
    antithetic: bool

    @property
    def work(self) -> float:
        """Cost of a path, in paths of the fine model."""
        both = [self.resolution] if self.below is None else [self.resolution, self.below]
        return (1 + self.antithetic) * sum(each.work(self.fine) for each in both)

    def sampler(self, u: Array) -> Sampler:
        """Return this term as a function of the noise, on the time grid of its model."""
        variate = self.variate(self.fine, u)
        above = self.resolution.sampler(self.fine, u)
        below = self.below and self.below.sampler(self.fine, u)
        times = self.below.longer // self.resolution.longer if self.below else 1

        def term(noise: Array) -> Array:
            values = above(noise) - variate(noise)
            if below:
                summed = noise.reshape(-1, times, *noise.shape[1:]).sum(axis=1)
                values -= interpolate(below(summed) - variate(summed), times)
            return values

        return (lambda noise: 0.5 * (term(noise) + term(-noise))) if self.antithetic else term


def interpolate(values: Array, times: int) -> Array:
    """Return values (K+1, ...) on a time grid that is `times` as fine, linear in between."""
    share = (np.arange(times) / times).reshape(-1, *[1] * (values.ndim - 1))
    between = values[:-1, None] + share * np.diff(values, axis=0)[:, None]
    return np.concatenate((between.reshape(-1, *values.shape[1:]), values[-1:]))


ESTIMATORS = {
    'multilevel': MonteCarloEstimator(
        lambda fine: (alone(fine), Resolution()), free, antithetic=True
    ),
    'plain': MonteCarloEstimator(),
}
"""Estimators by name: the cheapest under much noise, and plain Monte Carlo."""
