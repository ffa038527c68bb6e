# SPDX-License-Identifier: Apache-2.0
"""Arrays -> messages, as bytes: what is published at every control period, and the plan."""

from __future__ import annotations

import array
from functools import lru_cache
import math

from geometry_msgs.msg import Quaternion, Transform, Twist, TwistStamped, Vector3
from herding_ros.control.plan import Plan
from herding_ros.model.state import Array
from herding_ros.nodes.wire import Template
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from .stamps import dog_frame, turned

_COORDINATES = ('x', 'y', 'z', 'vx', 'vy', 'vz')
_CLOUD = np.dtype([('id', '<u4'), *((name, '<f4') for name in _COORDINATES)])
_FIELDS = [
    PointField(name='id', offset=0, datatype=PointField.UINT32, count=1),
    *(
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate(_COORDINATES, start=1)
    ),
]
_POSE = [('position', 'f8', 3), ('orientation', 'f8', 4)]
_TWIST = [('linear', 'f8', 3), ('angular', 'f8', 3)]
_ODOMETRY = np.dtype(
    [*_POSE, ('pose_covariance', 'f8', 36), *_TWIST, ('twist_covariance', 'f8', 36)]
)
_COMMAND = np.dtype(_TWIST)


def cloud(x: Array, v: Array, ns: int, frame: str, first: int = 0) -> bytes:
    """Sheep or dogs at x (N, 2) [m] with velocities v (N, 2) [m/s] as a PointCloud2.

    Their ids count from `first`, for dogs from 1.
    """
    template = _cloud(len(x), frame, first)
    points = template.numbers['points']
    points['x'], points['y'] = x.T
    points['vx'], points['vy'] = v.T
    return template.stamped(ns)


@lru_cache(maxsize=16)
def _cloud(count: int, frame: str, first: int) -> Template:
    points = np.zeros(count, _CLOUD)
    points['id'] = first + np.arange(count)
    message = PointCloud2(
        header=Header(frame_id=frame),
        height=1,
        width=count,
        fields=_FIELDS,
        is_bigendian=False,
        point_step=_CLOUD.itemsize,
        row_step=_CLOUD.itemsize * count,
        data=array.array('B', points.tobytes()),
        is_dense=True,
    )
    return Template(message, [('points', _CLOUD, count), ('is_dense', '?')])


def odometry(d: Array, u: Array, m: int, ns: int, frame: str, heading: float = 0.0) -> bytes:
    """Odometry of dog m at d (2,) [m] with velocity u (2,) [m/s] in the map, and heading [rad]."""
    template = _odometry(m, frame)
    template.numbers['position'][:2] = d
    template.numbers['orientation'][2:] = math.sin(0.5 * heading), math.cos(0.5 * heading)
    template.numbers['linear'][:2] = turned(u, heading)
    return template.stamped(ns)


@lru_cache(maxsize=1000)
def _odometry(m: int, frame: str) -> Template:
    message = Odometry(header=Header(frame_id=frame), child_frame_id=dog_frame(m))
    return Template(message, _ODOMETRY)


def command(u: Array, heading: float, m: int, ns: int, ahead: float | None = None) -> bytes:
    """Velocity u (2,) [m/s] in the map as a TwistStamped in the body frame of dog m.

    ahead: of a dog that has to turn, how far ahead of it [m] the velocity is; None: it need not.
    """
    template = _command(m)
    template.numbers['linear'][:2], template.numbers['angular'][2] = _body(u, heading, ahead)
    return template.stamped(ns)


@lru_cache(maxsize=1000)
def _command(m: int) -> Template:
    return Template(TwistStamped(header=Header(frame_id=dog_frame(m))), _COMMAND)


def twist(u: Array, heading: float, ahead: float | None = None) -> Twist:
    """Velocity u (2,) [m/s] in the map as a command in the body frame of a dog; see `command`."""
    (x, y), turn = _body(u, heading, ahead)
    return Twist(linear=Vector3(x=x, y=y), angular=Vector3(z=turn))


def _body(u: Array, heading: float, ahead: float | None) -> tuple[tuple[float, float], float]:
    """Return the linear velocity (x, y) [m/s] and the turn rate [rad/s] that a dog is told."""
    x, y = turned(u, heading)
    return ((x, y), 0.0) if ahead is None else ((x, 0.0), y / ahead)


def trajectory(plan: Plan, dogs: Array, names: tuple[str, ...], ns: int, frame: str) -> bytes:
    """Plan with the dogs' planned positions (intervals, M, 2) [m] at the intervals' starts.

    A MultiDOFJointTrajectory.
    """
    template = _trajectory(len(plan.u), names, frame)
    points = template.numbers['points']
    points['transforms']['translation'][..., :2] = dogs
    points['velocities']['linear'][..., :2] = plan.u
    times = np.rint(np.arange(len(dogs)) * plan.dt * 1e9).astype(int)
    points['sec'], points['nanosec'] = np.divmod(times, 1_000_000_000)
    return template.stamped(ns)


@lru_cache(maxsize=16)
def _trajectory(intervals: int, names: tuple[str, ...], frame: str) -> Template:
    count = len(names)
    point = MultiDOFJointTrajectoryPoint(
        transforms=[Transform(rotation=Quaternion(w=1.0))] * count, velocities=[Twist()] * count
    )
    message = MultiDOFJointTrajectory(
        header=Header(frame_id=frame),
        joint_names=list(names),
        points=[point] * intervals,
    )
    transform = [('translation', 'f8', 3), ('rotation', 'f8', 4)]
    # Between the arrays are their lengths, the second one filled up to 8 bytes.
    on_the_wire = [
        ('transform_count', 'u4'),
        ('transforms', transform, count),
        ('velocity_count', 'u4', 2),
        ('velocities', _TWIST, count),
        ('acceleration_count', 'u4'),
        ('sec', 'i4'),
        ('nanosec', 'u4'),
    ]
    return Template(message, [('points', on_the_wire, intervals)])
