# SPDX-License-Identifier: Apache-2.0
"""Stamps, frames, and axes."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
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


def turned(u: Array, heading: float) -> tuple[float, float]:
    """Return u (2,) in axes that are turned by heading [rad]."""
    c, s = math.cos(heading), math.sin(heading)
    x, y = u.tolist()
    return c * x + s * y, c * y - s * x
