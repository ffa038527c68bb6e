# SPDX-License-Identifier: Apache-2.0
"""Plans and paths -> arrays, from their bytes.

rclpy makes an object of all that is in a plan: 22 ms for 200 points of five dogs. This takes 2.
"""

from __future__ import annotations

from herding_ros.bag.recorded_run import Route
from herding_ros.checks import check_frame, Refused
from herding_ros.model.state import Array
from herding_ros.nodes.wire import Reader
import numpy as np

_TRANSFORM, _TWIST = 7, 6
"""Numbers in a transform or a pose, and in a twist."""


def plan_in(data: bytes, frame: str) -> Route:
    """Where dogs are going to be, (K, M, 2), in a MultiDOFJointTrajectory."""
    reader = Reader(data)
    start, given = reader.header()
    check_frame('plan', given, frame)
    (names,) = reader.numbers('I')
    for _ in range(names):
        reader.string()
    (count,) = reader.numbers('I')
    times: list[int] = []
    numbers: list[tuple[float, ...]] = []
    for _ in range(count):
        numbers.append(reader.sequence_of_doubles(_TRANSFORM))
        reader.sequence_of_doubles(_TWIST)  # velocities
        reader.sequence_of_doubles(_TWIST)  # accelerations
        sec, nanosec = reader.numbers('iI')
        times.append(start + sec * 1_000_000_000 + nanosec)
    reader.end_after('the points')
    size = len(numbers[0]) if numbers else 0
    if any(len(each) != size for each in numbers):
        raise Refused('malformed', 'all points of a plan must have as many transforms')
    return _route(times, np.array(numbers).reshape(count, size // _TRANSFORM, _TRANSFORM))


def path_in(data: bytes, frame: str) -> Route:
    """Where something is going to be, (K, 2), in a Path."""
    reader = Reader(data)
    _, given = reader.header()
    check_frame('path', given, frame)
    (count,) = reader.numbers('I')
    times: list[int] = []
    numbers: list[tuple[float, ...]] = []
    for _ in range(count):
        ns, _ = reader.header()
        times.append(ns)
        numbers.append(reader.some_doubles(_TRANSFORM))
    reader.end_after('the poses')
    return _route(times, np.array(numbers).reshape(count, _TRANSFORM))


def _route(times: list[int], poses: Array) -> Route:
    """Return a route at times [ns] through poses (K, ..., 7); Refused if nobody could draw it."""
    points = poses[..., :2]
    if not points.size or not np.isfinite(points).all():
        raise Refused('not finite', 'a plan must have points, all of them finite')
    return Route(np.array(times) * 1e-9, points)
