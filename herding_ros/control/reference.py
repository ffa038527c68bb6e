# SPDX-License-Identifier: Apache-2.0
"""The trajectory that the centre of the flock is asked to follow."""

from __future__ import annotations

from herding_ros.model.crowd import Crowd
from herding_ros.model.flock import centre
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array, HerdState
import numpy as np

from .reach import Reach
from .rules.collect_and_drive import drivers


def pace(
    crowd: Crowd, reach: Reach | None, state: HerdState, goal: Array, max_speed: float
) -> float:
    """Return the speed [m/s] at which the dogs can drive the flock to a goal (2,) [m].

    It is that at which friction balances their force on the centre while they stand side by side
    behind the flock (ahead of it, if they attract), and at most max_speed, their own; reach is
    that of the crowd:

        v = min(u_max, |e . 1/N sum_i sum_m -grad P_2(x_i - p_m)| / alpha)

    with e the direction to the goal and p_m the posts of `drivers`.
    """
    x, offset = state.x, goal - centre(state.x)
    length = float(np.linalg.norm(offset))
    if reach is None or not length:
        return max_speed
    target = goal if reach.repels else centre(x) - offset
    away = x[:, None] - drivers(x, target, len(state.d), reach.standoff, reach.reach)
    distance = np.maximum(np.linalg.norm(away, axis=-1), TINY)
    push = -(crowd.dog.derivative(distance) / distance)[..., None] * away
    force = abs(float(push.sum(axis=1).mean(axis=0) @ offset) / length)
    return min(max_speed, force / max(crowd.friction, TINY))


def reference(kind: str, speed: float, route: Array, times: Array) -> Array:
    """Return where the centre is asked to be at the given times [s] of a window, (K+1, 2) [m].

    It moves from the start of a route (n, 2) [m] along straight legs to its end and waits there:
    if 'attainable' at a speed [m/s], see `pace`; if 'interpolated' (paper, remark on the receding
    horizon) within the window.
    """
    legs = np.diff(route, axis=0)
    lengths = [max(float(np.linalg.norm(leg)), TINY) for leg in legs]
    total = sum(lengths)
    if kind == 'interpolated':
        fraction = times / times[-1]
    else:
        fraction = np.minimum(speed * times / total, 1.0)
    path = route[0]
    done = 0.0
    for leg, length in zip(legs, lengths, strict=True):
        part = np.clip(fraction * (total / length) - done / length, 0.0, 1.0)
        path = path + part[:, None] * leg
        done += length
    return path
