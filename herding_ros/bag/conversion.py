# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag -> numbers. What no one can use raises Refused, with what must be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from herding_ros.checks import check_finite, Refused
from herding_ros.markers import surroundings_in
from herding_ros.point_cloud import points
import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import get_typestore, Stores

from .recorded_run import Array
from .stored import Stored

CLOUD = 'sensor_msgs/msg/PointCloud2'
ODOMETRY = 'nav_msgs/msg/Odometry'
POSE = 'geometry_msgs/msg/PoseStamped'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
PATH, TRAJECTORY = 'nav_msgs/msg/Path', 'trajectory_msgs/msg/MultiDOFJointTrajectory'
MARKERS = 'visualization_msgs/msg/MarkerArray'
COMMAND, COMMAND_WITHOUT_STAMP = 'geometry_msgs/msg/TwistStamped', 'geometry_msgs/msg/Twist'

_STORE = get_typestore(Stores.ROS2_JAZZY)


class Flock(NamedTuple):
    """The sheep with a finite position: ids (n,), positions x and velocities v (n, 2).

    A velocity is NaN where it is not known. has_ids: false if the ids are their order in the
    cloud; unseen: number of sheep in the cloud without a position.
    """

    ids: NDArray[np.int64]
    x: Array
    v: Array
    has_ids: bool
    unseen: int


class Planned(NamedTuple):
    """Where somebody plans to be: points (K, M, 2) [m], of M names, at times (K,) [ns]."""

    times: NDArray[np.int64]
    points: Array
    names: tuple[str, ...]


class Content(NamedTuple):
    """What was read of a message: its stamp [ns], None without one, its frame, and the rest."""

    ns: int | None
    frame: str
    value: Any


def read_message(stored: Stored, *types: str) -> Content:
    """Return what a message says that must be of one of these types; raises Refused."""
    if stored.type not in types:
        raise Refused('wrong type', f'must be of type {" or ".join(types)}, got {stored.type}')
    try:
        message = _STORE.deserialize_cdr(stored.data, stored.type)
        header = _header(message)
        value = _READERS[stored.type](message)
    except Refused:
        raise
    except Exception as error:  # rosbags and NumPy raise many kinds on bytes from strangers
        raise Refused('malformed', f'{type(error).__name__}: {error}') from error
    if header is None:
        return Content(None, '', value)
    # The stamp of a plan is when it begins, not when it was announced.
    ns = None if isinstance(value, Planned) else _nanoseconds(header.stamp)
    return Content(ns, header.frame_id, value)


def _header(message: Any) -> Any:
    """Return the header of a message, None without one; that of markers is with the first."""
    return getattr(next(iter(getattr(message, 'markers', [])), message), 'header', None)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _flock(cloud: Any) -> Flock:
    rows: Any = points(cloud)
    names = rows.dtype.names or ()
    if not {'x', 'y'} <= set(names):
        raise Refused('wrong fields', f'sheep must have fields x and y, got {", ".join(names)}')
    if not len(rows):
        raise Refused('empty', 'sheep must be at least one point, got an empty cloud')
    values: Array = np.full((len(rows), 4), np.nan)
    for i, name in enumerate(('x', 'y', 'vx', 'vy')):
        if name in names:
            values[:, i] = rows[name]
    seen = np.isfinite(_single(values[:, :2])).all(axis=1)
    if not seen.any():
        raise Refused('not finite', 'sheep positions must be finite, got none that is')
    has_ids = 'id' in names and rows.dtype['id'].kind in 'iu'
    ids = rows['id'].astype(np.int64) if has_ids else np.arange(len(rows))
    if len(np.unique(ids)) < len(ids):
        raise Refused('duplicate ids', 'two sheep have the same id; each needs its own')
    values = values[seen]
    return Flock(ids[seen], values[:, :2], values[:, 2:], has_ids, int(np.sum(~seen)))


def _position(pose: Any, what: str) -> tuple[float, float]:
    return _pair(pose.position.x, pose.position.y, what)


def _pair(x: float, y: float, what: str) -> tuple[float, float]:
    check_finite(what, *_single(np.array([x, y])).tolist())
    return x, y


def _single(values: Array) -> NDArray[np.float32]:
    """Return numbers in single precision; infinite what is too large for a place or a speed."""
    with np.errstate(over='ignore', invalid='ignore'):
        return values.astype(np.float32)


def _velocity(message: Any) -> tuple[float, float]:
    linear = getattr(message, 'twist', message).linear
    return _pair(linear.x, linear.y, 'command')


def _statuses(message: Any) -> list[tuple[str, dict[str, str]]]:
    """Return name and values of each status."""
    return [
        (status.name, {pair.key: pair.value for pair in status.values})
        for status in message.status
    ]


def _path(message: Any) -> Planned:
    times = [_nanoseconds(pose.header.stamp) for pose in message.poses]
    points = [_position(pose.pose, 'path') for pose in message.poses]
    return _planned(times, np.reshape(points, (-1, 1, 2)), ('',))


def _trajectory(message: Any) -> Planned:
    """Return the points, and where the velocities of the last one lead from there."""
    start = _nanoseconds(message.header.stamp)
    times = [start + _nanoseconds(point.time_from_start) for point in message.points]
    points = [
        [(at.translation.x, at.translation.y) for at in point.transforms]
        for point in message.points
    ]
    if len(times) > 1:
        last = message.points[-1]
        end = 2 * times[-1] - times[-2]
        ahead = (end - times[-1]) * 1e-9
        points.append(
            [
                (x + ahead * along.linear.x, y + ahead * along.linear.y)
                for (x, y), along in zip(points[-1], last.velocities, strict=True)
            ]
        )
        times.append(end)
    names = tuple(message.joint_names)
    return _planned(times, np.reshape(points, (len(times), len(names), 2)), names)


def _planned(times: list[int], points: Array, names: tuple[str, ...]) -> Planned:
    if not times:
        raise Refused('empty', 'a plan must have at least one point, got none')
    if not np.isfinite(_single(points)).all():
        raise Refused('not finite', 'a plan must be finite, got NaN or infinite values')
    return Planned(np.array(times), points, names)


_READERS: Mapping[str, Callable[[Any], Any]] = {
    CLOUD: _flock,
    ODOMETRY: lambda message: _position(message.pose.pose, 'dog position'),
    POSE: lambda message: (message.pose.position.x, message.pose.position.y),
    COMMAND: _velocity,
    COMMAND_WITHOUT_STAMP: _velocity,
    DIAGNOSTICS: _statuses,
    PATH: _path,
    TRAJECTORY: _trajectory,
    MARKERS: lambda message: surroundings_in(message, _header(message).frame_id),
}
