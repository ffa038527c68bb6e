"""The trajectory that the centre of the flock is asked to follow."""

from __future__ import annotations

import numpy as np

from herding_ros.model.flock import centre, spread
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array, HerdState

from .parameters import Reference

_ENCLOSING = 3
"""Dogs that can stand around a flock; fewer have to run from side to side."""
_STEEPNESS = 4
"""How steeply the pace falls with the spread: by half when the flock is a fifth wider."""


def pace(kind: Reference, state: HerdState) -> float:
    """Return the speed [m/s] at which these dogs can drive this flock and keep it together.

    It grows with the dogs up to the three that can stand around a flock, and falls steeply
    once the flock is wide, so that gathering comes before driving. It never falls to zero.
    """
    dogs = min(len(state.d) / _ENCLOSING, 1.0)
    width = min((kind.spread / max(float(spread(state.x)), TINY)) ** _STEEPNESS, 1.0)
    return kind.speed * dogs * width


def reference(kind: Reference, state: HerdState, goal: Array, times: Array) -> Array:
    """Return where the centre is asked to be at the given times [s] of a window, (K+1, 2) [m].

    'interpolated' (paper, remark on the receding horizon) moves from the centre to the goal at
    constant speed within the window; 'attainable' moves at the `pace` of the flock, and waits.
    """
    start = centre(state.x)
    way = goal - start
    length = float(np.linalg.norm(way))
    if kind.kind == 'interpolated':
        fraction = times / times[-1]
    else:
        fraction = np.minimum(pace(kind, state) * times / max(length, TINY), 1.0)
    return start + fraction[:, None] * way
