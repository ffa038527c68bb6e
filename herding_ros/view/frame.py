# SPDX-License-Identifier: Apache-2.0
"""What a page shows of a herd at one instant, and what leads there: routes, trails, curves."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from herding_ros.markers import NOTHING, Surroundings
from herding_ros.model.field import Field
from herding_ros.model.flock import centre
from herding_ros.model.state import Array
import numpy as np

TRAIL = 20.0
"""Time for which one sees where dogs and flock came from [s]."""

MOST_TRAIL = 60
"""Positions of a trail that are drawn."""

_MOST_SAMPLES = 1000
"""Values of a curve that are kept: then every second one."""


@dataclass(frozen=True)
class Frame:
    """A herd at a time [s]; positions in metres.

    x: (N, 2) sheep; d: (M, 2) dogs; headings: (M,) [rad]; numbers: (M,) of the dogs; goal: (2,)
    the destination, None if there is none; plans: (n, M', 2) where dogs are planned to go;
    expected: (n, 2) where the flock's centre is expected to go; dog_trails: (L, M, 2) and
    centre_trail: (L, 2) where they come from; field: what stands there; surroundings: what the
    controller knows of it, and its route.
    """

    time: float
    x: Array
    d: Array
    headings: Array
    numbers: tuple[int, ...]
    goal: Array | None
    plans: Array
    expected: Array
    dog_trails: Array
    centre_trail: Array
    field: Field
    surroundings: Surroundings = NOTHING


class Trails:
    """Where dogs and flock have been in the last `TRAIL` seconds."""

    def __init__(self) -> None:
        self._places: deque[tuple[float, Array]] = deque()

    def add(self, time: float, x: Array, d: Array) -> None:
        """Remember sheep x (N, 2) and dogs d (M, 2) [m] at a time [s], not too many of them.

        All is forgotten when time goes back, or when there are other dogs.
        """
        place = np.vstack([centre(x), d])
        last = self._places[-1] if self._places else None
        if last and (time < last[0] or place.shape != last[1].shape):
            self._places.clear()
        elif last and time - last[0] < TRAIL / MOST_TRAIL:
            return
        self._places.append((time, place))
        while self._places[0][0] < time - TRAIL:
            self._places.popleft()

    @property
    def dogs(self) -> Array:
        """The trails of the dogs (L, M, 2) [m]."""
        return self._stacked[:, 1:]

    @property
    def centre(self) -> Array:
        """The trail of the flock's centre (L, 2) [m]."""
        return self._stacked[:, 0]

    @property
    def _stacked(self) -> Array:
        return np.array([place for _, place in self._places]).reshape(len(self._places), -1, 2)


@dataclass
class Curve:
    """A value over time: its name and unit, and samples, the fewer the longer it grows."""

    label: str
    times: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    _spacing: float = 0.0

    def add(self, time: float, value: float) -> None:
        """Add a value at a time [s]; all is forgotten when time goes back."""
        if self.times and time < self.times[-1]:
            self.times, self.values, self._spacing = [], [], 0.0
        if self.times and time < self.times[-1] + self._spacing:
            return
        self.times.append(time)
        self.values.append(value)
        if len(self.times) > _MOST_SAMPLES:
            del self.times[1::2], self.values[1::2]
            self._spacing = (self.times[-1] - self.times[0]) / len(self.times)
