# SPDX-License-Identifier: Apache-2.0
"""Whether a flock is farther from its prediction than noise explains.

A sheep with friction alpha that only the random force sigma moves is after a time T at a place
whose coordinates have the variance

    q(T) = sigma^2 / alpha^2 (T - 2 (1 - e^-aT) / alpha + (1 - e^-2aT) / (2 alpha)),    a = alpha,

the integral of an Ornstein-Uhlenbeck velocity that starts at a known value. In a crowd of first
order it diffuses, q(T) = sigma^2 / alpha^2 T. Forces between sheep do not move their centre, whose
coordinates have the variance q (c + (1 - c) / N) for N sheep that have the share c of the noise in
common. The spread, the root mean square of N distances from the centre, then varies by about
q / N, and its mean square grows by 2 q (1 - c) (1 - 1 / N), where alignment adds to the friction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import relative_friction
from herding_ros.model.flock import centre, flock, spread
from herding_ros.model.noise import strength
from herding_ros.model.state import HerdState
import numpy as np

from .parameters import Control
from .window import Window

_DEVIATIONS = 4.0
"""Standard deviations that are chance: of 10,000 plans, noise surprises in 4."""

_UNTOLD = 0.1
"""Standard deviation of what observations and predictions are off by besides, as a part of the way
that a dog runs until the next feedback.

Otherwise each error of a model would be a surprise where there is little noise.
"""


@dataclass(frozen=True)
class Surprise:
    """By how much the centre and the spread of a flock are off their prediction [m]."""

    centre: float
    spread: float


def surprise(
    crowd: Crowd, control: Control, window: Window, elapsed: float, state: HerdState, t: float
) -> Surprise | None:
    """Return by how much the flock at t [s] is off where a window predicts it; None: by chance.

    It is chance if the random force and the errors of two observations explain centre and spread;
    the first of these is that of the window, elapsed [s] ago.
    """
    which = window.sheep
    if which is None or len(which) != len(state.x):
        which = flock(state.x, control.arrival.strays)
    state = state.of_sheep(which)
    n = len(state.x)
    sigma = math.sqrt(np.square(strength(crowd, t, state.x)).mean())
    moved = sigma**2 * displacement_variance(crowd, elapsed)
    aligned = replace(crowd, friction=relative_friction(crowd, state.x))
    apart = sigma**2 * displacement_variance(aligned, elapsed)
    seen = _seen(control, elapsed)
    untold = _untold(control, control.horizon.feedback)
    common = crowd.common_noise
    k = window.index(t)
    own = (1.0 - common) * moved + seen
    single = (1.0 - common) * apart + seen
    wider = math.sqrt(window.spread[k] ** 2 + 2.0 * single * (1.0 - 1.0 / n))
    off = Surprise(
        float(np.linalg.norm(centre(state.x) - window.centre[k])),
        abs(float(spread(state.x)) - wider),
    )
    if off.centre > _DEVIATIONS * math.sqrt(common * moved + own / n + untold):
        return off
    return off if off.spread > _DEVIATIONS * math.sqrt(single / n + untold) else None


def _seen(control: Control, elapsed: float) -> float:
    """Return the variance of what two observations are off by [m^2]."""
    sensor = control.sensor
    return 2.0 * sensor.position_noise**2 + (sensor.velocity_noise * elapsed) ** 2


def _untold(control: Control, elapsed: float) -> float:
    return (_UNTOLD * control.max_speed * elapsed) ** 2


def variance_of_a_sheep(
    crowd: Crowd, control: Control, state: HerdState, before: float, t: float
) -> float:
    """Return by how much a coordinate of a sheep is off the model's prediction at t [s], [m^2].

    It was predicted from an observation at the time `before` [s]. By the random force, the errors
    of two observations, and what is wrong besides.
    """
    elapsed = t - before
    moved = np.square(strength(crowd, t, state.x)).mean() * displacement_variance(crowd, elapsed)
    return float(moved) + _seen(control, elapsed) + _untold(control, elapsed)


def displacement_variance(crowd: Crowd, elapsed: float) -> float:
    """Return q / sigma^2 [s^3], see above: of a coordinate of a sheep, after a time [s]."""
    friction = crowd.friction
    if crowd.order == 1:
        return elapsed / friction**2
    a = friction * elapsed
    if a < 1e-2:  # where the terms cancel: its series
        return elapsed**3 / 3.0 * (1.0 - 0.75 * a)
    # 1 - e^-a = -expm1(-a)
    sum_of_terms = a + 2.0 * math.expm1(-a) - 0.5 * math.expm1(-2.0 * a)
    return sum_of_terms / friction**3
