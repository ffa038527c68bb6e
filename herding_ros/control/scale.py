# SPDX-License-Identifier: Apache-2.0
"""How large and how slow a herd is: defaults are the reference scenario's, in its units.

Within a window dogs have to get behind sheep, and these have to respond. So the unit of length is
how far a dog is felt, its reach; that of time is the geometric mean of what a dog takes for that
distance, reach / u_max, and of what a sheep takes to follow a force, 1 / friction. Both are
relative to the reference scenario, and rounded to powers of two, so that a window is 20, 10 or 5 s
long, and not 11.3 s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import TypeVar

from herding_ros.model.crowd import Crowd
from herding_ros.model.parameters import Parameters

from .parameters import Control
from .reach import Reach

_P = TypeVar('_P', bound=Parameters)


@dataclass(frozen=True)
class Scale:
    """How many times as long lengths and times are as in the reference scenario."""

    length: float
    time: float

    @classmethod
    def of(cls, crowd: Crowd, max_speed: float) -> Scale:
        """Return the scale of a crowd with dogs that run at most at max_speed [m/s].

        Where no sheep notices dogs it is that of the reference scenario.
        """
        there, here = Reach.of(Crowd(), Control().max_speed), Reach.of(crowd, max_speed)
        if there is None or here is None:
            return cls(1.0, 1.0)
        length = here.reach / there.reach
        run = length * Control().max_speed / max_speed
        follow = Crowd().friction / crowd.friction if crowd.friction else run
        return cls(_power_of_two(length), _power_of_two(math.sqrt(run * follow)))

    def apply(self, defaults: _P) -> _P:
        """Return parameters of the reference scenario at this scale."""
        return defaults.rescaled(self.length, self.time)

    def __str__(self) -> str:
        """Say it in words."""
        return f'lengths x {self.length:g}, times x {self.time:g}'


def control_of(crowd: Crowd, max_speed: float, control_period: float) -> Control:
    """Return the defaults for a crowd, its dogs' speed limit [m/s] and a plant's period [s].

    The times of the window are rounded to multiples of that period, and its time steps are no
    longer than usual. Raises ValueError for a speed or a period that is not above 0, and for a
    period that is too short for such a window.
    """
    for name, value in (('max_speed', max_speed), ('control_period', control_period)):
        if not 0.0 < value < math.inf:
            raise ValueError(f'{name} must be a number above 0, got {value!r}')
    usual = Scale.of(crowd, max_speed).apply(Control())
    times = {
        name: max(round(getattr(usual.horizon, name) / control_period), 1) * control_period
        for name in ('feedback', 'accepted', 'length')
    }
    substeps = math.ceil(control_period / usual.horizon.dt - 1e-6)
    horizon = replace(usual.horizon, control_period=control_period, substeps=substeps, **times)
    return replace(usual, max_speed=max_speed, horizon=horizon)


def _power_of_two(number: float) -> float:
    return float(2.0 ** round(math.log2(number)))
