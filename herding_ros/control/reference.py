# SPDX-License-Identifier: Apache-2.0
"""The trajectory that the centre of the flock is asked to follow."""

from __future__ import annotations

from herding_ros.model.flock import centre
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array, HerdState
import numpy as np

from .parameters import Reference

_ENCLOSING = 3
"""Dogs that can stand around a flock; fewer have to run from side to side."""


def pace(parameters: Reference, dogs: int) -> float:
    """Return the speed [m/s] at which so many dogs can drive a flock and keep it together.

    It grows with the dogs up to the three that can stand around a flock.
    """
    return parameters.speed * min(dogs / _ENCLOSING, 1.0)


def reference(parameters: Reference, state: HerdState, goal: Array, times: Array) -> Array:
    """Return where the centre is asked to be at the given times [s] of a window, (K+1, 2) [m].

    'interpolated' (paper, remark on the receding horizon) moves from the centre to the goal at
    constant speed within the window; 'attainable' moves at the `pace` of the dogs, and waits.
    """
    start = centre(state.x)
    offset = goal - start
    length = float(np.linalg.norm(offset))
    if parameters.kind == 'interpolated':
        fraction = times / times[-1]
    else:
        speed = pace(parameters, len(state.d))
        fraction = np.minimum(speed * times / max(length, TINY), 1.0)
    return start + fraction[:, None] * offset
