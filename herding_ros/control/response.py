# SPDX-License-Identifier: Apache-2.0
"""How much each sheep makes of dogs, learned from how it moves.

From one look to the next, the model moves a sheep by b without dogs and by b + a with them. If it
has moved by b + r, and noise and errors of observations have the variance s in each coordinate,

    r = g a + e,    Var e = s,

where the response g is 1 of a sheep of the model and 0 of one that ignores dogs. With a normal
prior the posterior is normal: its precision grows by |a|^2 / s at each look (recursive least
squares). A sheep that no dog has come near stays what the model has it for.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import follow
from herding_ros.model.flock import flock
from herding_ros.model.state import Array, HerdState
import numpy as np
from numpy.typing import NDArray

from .parameters import Control
from .surprise import variance_of_a_sheep

_PRIOR = 1.0
"""Standard deviation of the response of a sheep of which nothing is known."""

_IGNORES = 0.5
"""A sheep ignores dogs whose response, and a standard deviation, is below this part of the median.

Of the median, since all do where the model's dogs are too strong.
"""

_FAR = 1e6
"""Dogs that are so many times as far away as any sheep from the origin are not felt [1]."""


@dataclass
class Response:
    """The responses of the sheep of a flock, in the order of its states."""

    _weight: Array = field(default_factory=lambda: np.zeros(0))  # |a|^2 / s, summed
    _sum: Array = field(default_factory=lambda: np.zeros(0))  # a . r / s, summed
    _last: tuple[float, HerdState] | None = None

    @property
    def mean(self) -> Array:
        """The responses (N,)."""
        return (1.0 / _PRIOR**2 + self._sum) / (1.0 / _PRIOR**2 + self._weight)

    @property
    def deviation(self) -> Array:
        """Their standard deviations (N,)."""
        return 1.0 / np.sqrt(1.0 / _PRIOR**2 + self._weight)

    def learn(self, crowd: Crowd, control: Control, state: HerdState, t: float) -> None:
        """Compare the herd at t [s] with the last one; forget all if that was another flock.

        Nothing is learned of a time longer than the horizon: it may be hours.
        """
        last, self._last = self._last, (t, state)
        if last is None or last[1].x.shape != state.x.shape:
            self._weight, self._sum = np.zeros(len(state.x)), np.zeros(len(state.x))
            return
        period, horizon = control.horizon.control_period, control.horizon.length
        steps = round((t - last[0]) / period)
        if not 1 <= steps <= horizon / period or last[1].d.shape != state.d.shape:
            return
        moved, alone = self._moved(crowd, last[1], state, steps, period)
        variance = variance_of_a_sheep(crowd, control, state, last[0], t)
        by_dogs, found = moved - alone, state.x - alone
        self._weight = self._weight + np.square(by_dogs).sum(axis=1) / variance
        self._sum = self._sum + (by_dogs * found).sum(axis=1) / variance

    @staticmethod
    def _moved(
        crowd: Crowd, before: HerdState, after: HerdState, steps: int, dt: float
    ) -> tuple[Array, Array]:
        """Return where the model takes sheep (N, 2) [m] with the dogs and without them.

        Dogs have gone straight.
        """
        part = np.linspace(0.0, 1.0, steps + 1)[:, None, None]
        ways = before.d.T + part * (after.d - before.d).T
        far = ways + _FAR * (1.0 + np.abs(before.x).max() + np.abs(ways).max())
        with_dogs, alone = (follow(crowd, before, each, dt).x[-1] for each in (ways, far))
        return with_dogs, alone

    def herded(self, x: Array, strays: int) -> NDArray[np.bool_]:
        """Return which (N,) of sheep at x (N, 2) [m] are herded: all but so many strays.

        Those are left that ignore dogs, then those that are farthest away.
        """
        left = np.ones(len(x), dtype=np.bool_)
        if strays and len(self._weight) == len(x):
            mean, certain = self.mean, self.mean + self.deviation
            ignoring = np.flatnonzero(certain < _IGNORES * float(np.median(mean)))
            left[ignoring[np.argsort(mean[ignoring])][: min(strays, len(x) - 1)]] = False
        rest = strays - int(np.count_nonzero(~left))
        left[left] = flock(x[left], rest)
        return left
