# SPDX-License-Identifier: Apache-2.0
"""Stamps, frames, and axes."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from herding_ros.checks import Refused
from herding_ros.model.state import Array
from herding_ros.nodes.wire import seconds_and_rest


def nanoseconds(stamp: Time) -> int:
    """Return a stamp in nanoseconds."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def stamp_of(ns: int) -> Time:
    """Return nanoseconds as a stamp, or the nearest one that there is."""
    sec, nanosec = seconds_and_rest(ns)
    return Time(sec=sec, nanosec=nanosec)


def dog_frame(m: int) -> str:
    """Name of the body frame of dog m, counted from 1."""
    return f'dog_{m}/base_link'


_ROUNDING = 0.1
"""By how much the squared length of a quaternion may differ from 1."""

_LEVEL = 0.999
"""Least cosine of the angle by which what should be level is tilted."""


def yaw(x: float, y: float, z: float, w: float) -> float:
    """Return the angle about the vertical [rad] of a quaternion; Refused if it is none."""
    if not abs(x * x + y * y + z * z + w * w - 1.0) <= _ROUNDING:
        raise Refused(
            'not a rotation',
            f'the orientation must have length 1, got ({x:g}, {y:g}, {z:g}, {w:g})',
        )
    # Does not depend on the length, so that nothing has to be normalised.
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def level_yaw(what: str, x: float, y: float, z: float, w: float) -> float:
    """Return the same of what must turn about the vertical alone."""
    angle = yaw(x, y, z, w)
    if 1.0 - 2.0 * (x * x + y * y) < _LEVEL:
        raise Refused(
            'not a rotation',
            f'{what} must turn about the vertical alone, got ({x:g}, {y:g}, {z:g}, {w:g})',
        )
    return angle


def turned(u: Array, heading: float) -> tuple[float, float]:
    """Return u (2,) in axes that are turned by heading [rad]."""
    c, s = math.cos(heading), math.sin(heading)
    x, y = u.tolist()
    return c * x + s * y, c * y - s * x
