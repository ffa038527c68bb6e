from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

from herding_ros.bag.writer import BagWriter

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types
PERIOD_NS = 100_000_000


def stamped(ns: int, frame: str = 'map') -> Any:
    stamp = T['builtin_interfaces/msg/Time'](sec=ns // 10**9, nanosec=ns % 10**9)
    return T['std_msgs/msg/Header'](stamp=stamp, frame_id=frame)


def vector(x: float, y: float) -> Any:
    return T['geometry_msgs/msg/Vector3'](x=float(x), y=float(y), z=0.0)


def pose(x: float, y: float) -> Any:
    return T['geometry_msgs/msg/Pose'](
        position=T['geometry_msgs/msg/Point'](x=float(x), y=float(y), z=0.0),
        orientation=T['geometry_msgs/msg/Quaternion'](x=0.0, y=0.0, z=0.0, w=1.0),
    )


def twist(x: float, y: float) -> Any:
    return T['geometry_msgs/msg/Twist'](linear=vector(x, y), angular=vector(0, 0))


def cloud(ns: int, x: np.ndarray, v: np.ndarray) -> Any:
    dtype = np.dtype(
        [('id', '<u4'), ('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('vx', '<f4'), ('vy', '<f4'),
         ('vz', '<f4')]
    )  # fmt: skip
    points = np.zeros(len(x), dtype)
    points['id'] = np.arange(len(x))
    points['x'], points['y'] = x.T
    points['vx'], points['vy'] = v.T
    kinds = {'<u4': 6, '<f4': 7}
    fields = [
        T['sensor_msgs/msg/PointField'](
            name=name, offset=offset, datatype=kinds[kind.str], count=1
        )
        for name, (kind, offset) in dtype.fields.items()
    ]
    return T['sensor_msgs/msg/PointCloud2'](
        header=stamped(ns), height=1, width=len(x), fields=fields, is_bigendian=False,
        point_step=dtype.itemsize, row_step=dtype.itemsize * len(x),
        data=np.frombuffer(points.tobytes(), np.uint8), is_dense=True,
    )  # fmt: skip


def odometry(ns: int, x: float, y: float) -> Any:
    covariance = np.zeros(36)
    return T['nav_msgs/msg/Odometry'](
        header=stamped(ns),
        child_frame_id='dog',
        pose=T['geometry_msgs/msg/PoseWithCovariance'](pose=pose(x, y), covariance=covariance),
        twist=T['geometry_msgs/msg/TwistWithCovariance'](
            twist=twist(0, 0), covariance=covariance
        ),
    )


def command(ns: int, x: float, y: float) -> Any:
    return T['geometry_msgs/msg/TwistStamped'](header=stamped(ns), twist=twist(x, y))


def plan_status(ns: int, **values: Any) -> Any:
    pair = T['diagnostic_msgs/msg/KeyValue']
    status = T['diagnostic_msgs/msg/DiagnosticStatus'](
        level=0, name='controller: plan', message='', hardware_id='',
        values=[pair(key=key, value=str(value)) for key, value in values.items()],
    )  # fmt: skip
    return T['diagnostic_msgs/msg/DiagnosticArray'](header=stamped(ns), status=[status])


@pytest.fixture(scope='session')
def messages() -> Any:
    """The makers of messages above, for tests that write bags of their own."""
    import types

    return types.SimpleNamespace(
        cloud=cloud, odometry=odometry, command=command, plan_status=plan_status, twist=twist,
        pose=pose, stamped=stamped, types=T,
    )  # fmt: skip
