# SPDX-License-Identifier: Apache-2.0
"""How strong and how far dogs are felt, learned from how the sheep move.

Of dogs that are felt g times as strongly and s times as far, the force on a sheep at a distance r
is g f(r / s), with f that of the model. In some time the model without dogs moves a sheep by b_i.
It has moved by b_i + r_i, and that is taken for

    r_i = g a_i(s) + w + c (x_i - x) + e_i,

with a_i(s) what the force f(r / s) makes of its path, and e_i its noise and the errors of
observation. x is the mean of all places x_i. Whatever w and c are, they play no part: w is what
moves all sheep alike, as wind, a slope or a gust, another one in each look, and c how much more
closely they keep together, or less, than the model has it, the same in all looks. For each s of
a few, g is found by linear regression with a normal prior, whose evidence tells how likely s is.

What the controller was told, g = s = 1, counts until it is a hundred times less likely than the
rest. If it is true that happens in one run of a hundred at most, however long they are (Ville's
inequality, for a ratio of likelihoods).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import follow, relative_friction
from herding_ros.model.parameters import TINY
from herding_ros.model.potentials import Potential
from herding_ros.model.state import Array, HerdState
import numpy as np
from numpy.typing import NDArray

from .parameters import Control
from .plan import SLACK
from .surprise import variance_of_a_sheep

_RANGES = 2.0 ** (0.5 * np.arange(-4, 5))
_TOLD = len(_RANGES) // 2
"""Index of the range 1."""

_PRIOR = 1.0
"""Standard deviation of the strength before anything is known, about 1."""

_CERTAIN = math.log(100.0)

_WEAKEST, _STRONGEST = 0.125, 8.0
"""Strengths that are believed."""

_STEPS = 4
"""Strengths from one power of two to the next: plans are made for few crowds."""

_PART = 0.3
"""Time between two comparisons, as a part of what is played of a window.

In a second observations are off by more than what dogs make; in many the paths of sheep part.
"""

_INSTANTS = 20
"""How often the force is evaluated in that time, at most."""


@dataclass(frozen=True)
class Felt:
    """Dogs as sheep feel them: multiples of the strength and range of what a crowd says."""

    strength: float = 1.0
    range: float = 1.0

    def crowd(self, told: Crowd) -> Crowd:
        """Return a crowd that feels its dogs so."""
        if self == Felt():
            return told
        # P'(r) becomes g P'(r / s): potentials are squares of lengths by those of times.
        time = math.sqrt(self.range / self.strength)
        return replace(told, dog=told.dog.rescaled(self.range, time))


@dataclass
class DogForce:
    """What is known of the dogs of a crowd, from looks at it.

    Nothing is known with a potential of the user's that cannot be rescaled, as its units are not.
    """

    crowd: Crowd
    control: Control
    # Sums, over all looks, of products of what dogs make (for each range), an expansion of the
    # flock, and what was found.
    _dogs: Array = field(init=False)
    _dogs_found: Array = field(init=False)
    _dogs_apart: Array = field(init=False)
    _apart: float = field(default=0.0, init=False)
    _apart_found: float = field(default=0.0, init=False)
    _can_learn: bool = field(init=False)
    _looks: list[tuple[float, HerdState]] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        """Know nothing."""
        self._dogs, self._dogs_found, self._dogs_apart = np.zeros((3, len(_RANGES)))
        self._can_learn = _has_units(self.crowd.dog)

    def learn(self, state: HerdState, t: float, herded: NDArray[np.bool_]) -> None:
        """Look at the herd at t [s]; compare it, every few seconds, with what was predicted.

        herded: (N,), the sheep that count; others may ignore dogs. Nothing is learned when sheep
        or dogs have come or gone, or of a time longer than what is played of a window.
        """
        if not self._can_learn:
            return
        if not self._goes_on(state, t):
            self._looks = []
        self._looks.append((t, state))
        if t - self._looks[0][0] >= _PART * self.control.horizon.accepted - SLACK:
            self._compare(herded)
            self._looks = self._looks[-1:]

    def felt(self) -> Felt:
        """Return how dogs are felt, as far as that is known: as told until that is unlikely."""
        # Whatever the expansion c is: what is left of dogs is what it cannot explain.
        part = self._dogs_apart / max(self._apart, TINY**2)
        precision = _PRIOR**-2.0 + self._dogs - part * self._dogs_apart
        score = _PRIOR**-2.0 + self._dogs_found - part * self._apart_found
        evidence = 0.5 * (score**2 / precision - np.log(_PRIOR**2 * precision))
        told = score[_TOLD] - 0.5 * precision[_TOLD]
        if np.logaddexp.reduce(evidence) - math.log(len(evidence)) < told + _CERTAIN:
            return Felt()
        likeliest = int(evidence.argmax())
        strength = float(score[likeliest] / precision[likeliest])
        steps = round(_STEPS * math.log2(min(max(strength, _WEAKEST), _STRONGEST)))
        return Felt(2.0 ** (steps / _STEPS), float(_RANGES[likeliest]))

    def _goes_on(self, state: HerdState, t: float) -> bool:
        if not self._looks:
            return False
        last, before = self._looks[-1]
        same = before.x.shape == state.x.shape and before.d.shape == state.d.shape
        return same and last < t <= last + self.control.horizon.accepted + SLACK

    def _compare(self, herded: NDArray[np.bool_]) -> None:
        (start, before), (end, after) = self._looks[0], self._looks[-1]
        by_dogs, told = self._predicted()
        wrong = after.x - told
        off = np.linalg.norm(wrong - wrong[herded].mean(axis=0), axis=1)
        usual = herded & (off < self.control.max_speed * (end - start))
        if np.count_nonzero(usual) < 2:
            return
        wrong, by_dogs, apart = map(_relative, (wrong[usual], by_dogs[:, usual], before.x[usual]))
        found = wrong + by_dogs[_TOLD]
        # Noise may be stronger than told.
        square = max(float(np.square(apart).sum()), TINY**2)
        rest = float(np.square(wrong).sum()) - float((wrong * apart).sum()) ** 2 / square
        seen = rest / (2 * len(wrong) - 3)
        variance = max(variance_of_a_sheep(self.crowd, self.control, before, start, end), seen)
        self._dogs = self._dogs + np.square(by_dogs).sum(axis=(1, 2)) / variance
        self._dogs_found = self._dogs_found + (by_dogs * found).sum(axis=(1, 2)) / variance
        self._dogs_apart = self._dogs_apart + (by_dogs * apart).sum(axis=(1, 2)) / variance
        self._apart += square / variance
        self._apart_found += float((apart * found).sum()) / variance

    def _predicted(self) -> tuple[Array, Array]:
        """Return a_i(s) (ranges, N, 2) [m], and where sheep would be with dogs as told (N, 2) [m].

        Dogs go straight from look to look. Sheep go as told: their true paths have noise in them.
        """
        crowd, horizon, (start, before) = self.crowd, self.control.horizon, self._looks[0]
        dt = horizon.dt
        steps = max(round((self._looks[-1][0] - start) / dt), 1)
        seen = np.array([t for t, _ in self._looks]) - start
        ways = _interpolated(seen, np.array([each.d.T for _, each in self._looks]), steps, dt)
        told = follow(crowd, before, ways, dt).x
        # Forces change little in a few steps: those in the middle of each part stand for all.
        starts = np.arange(0, steps, -(-steps // _INSTANTS))
        middle = (starts + np.append(starts[1:], steps) - 1) // 2
        away = told[middle][:, :, None] - ways[middle, :2].transpose(0, 2, 1)[:, None]
        r = np.maximum(np.linalg.norm(away, axis=-1), TINY)
        # How far a unit of force in one step has moved a sheep relative to the others at the end,
        # see `dynamics`.
        friction = relative_friction(crowd, before.x)
        left: Array = np.arange(steps - 1, -1, -1, dtype=np.float64)
        if crowd.order == 1:
            left = np.full(steps, 1.0 / friction)
        elif friction:
            left = (1.0 - (1.0 - min(friction * dt, 1.0)) ** left) / friction
        else:
            left = left * dt
        slope = crowd.dog.derivative(r / _RANGES[:, None, None, None])
        weight = -slope / r * np.add.reduceat(dt * left, starts)[:, None, None]
        return np.einsum('sknm,knmc->snc', weight, away), told[-1]


def _has_units(potential: Potential) -> bool:
    try:
        potential.rescaled(1.0, 1.0)
    except ValueError:
        return False
    return True


def _interpolated(seen: Array, ways: Array, steps: int, dt: float) -> Array:
    """Return dogs' states (steps + 1, S, M) from those at times `seen` (K,) [s], (K, S, M)."""
    times = dt * np.arange(steps + 1)
    after = np.clip(np.searchsorted(seen, times), 1, len(seen) - 1)
    part = (times - seen[after - 1]) / (seen[after] - seen[after - 1])
    return ways[after - 1] + part[:, None, None] * (ways[after] - ways[after - 1])


def _relative(moved: Array) -> Array:
    """Return how far sheep (..., N, 2) have moved, or are, relative to their mean [m]."""
    return moved - moved.mean(axis=-2, keepdims=True)
