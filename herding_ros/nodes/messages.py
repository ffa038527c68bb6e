"""Messages <-> arrays: the only place that knows what a message looks like.

Everything is in SI units. Conversions from messages raise ValueError on anything that must
not move a dog: wrong frames and fields, NaN, infinities. What comes at every control period is
written and read as bytes (see `wire`).
"""

from __future__ import annotations

import array
from collections.abc import Mapping
from functools import lru_cache
import math

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Transform,
    Twist,
    TwistStamped,
    Vector3,
)
from nav_msgs.msg import Odometry, Path
import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from herding_ros.bag.point_cloud import points
from herding_ros.control.plan import Plan
from herding_ros.control.receding_horizon import SolveReport
from herding_ros.model.state import Array, finite

from .wire import decoded, read, Template

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


def nanoseconds(stamp: Time) -> int:
    """Return a stamp in nanoseconds."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def stamp_of(ns: int) -> Time:
    """Return nanoseconds as a stamp."""
    return Time(sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)


def check_frame(what: str, given: str, *allowed: str) -> None:
    """Raise ValueError unless a message is in one of the allowed frames."""
    if given not in allowed:
        names = ' or '.join(f"'{name}'" for name in allowed)
        raise ValueError(f"{what} is in frame '{given}', allowed is {names}")


def dog_frame(m: int) -> str:
    """Name of the body frame of dog m, counted from 1."""
    return f'dog_{m}/base_link'


def cloud(x: Array, v: Array, ns: int, frame: str) -> bytes:
    """Sheep at x (N, 2) [m] with velocities v (N, 2) [m/s] as a PointCloud2."""
    template = _cloud(len(x), frame)
    sheep = template.numbers['sheep']
    sheep['x'], sheep['y'] = x.T
    sheep['vx'], sheep['vy'] = v.T
    return template.stamped(ns)


@lru_cache(maxsize=16)
def _cloud(count: int, frame: str) -> Template:
    sheep = np.zeros(count, _CLOUD)
    sheep['id'] = np.arange(count)
    message = PointCloud2(
        header=Header(frame_id=frame),
        height=1,
        width=count,
        fields=_FIELDS,
        is_bigendian=False,
        point_step=_CLOUD.itemsize,
        row_step=_CLOUD.itemsize * count,
        data=array.array('B', sheep.tobytes()),
        is_dense=True,
    )
    return Template(message, [('sheep', _CLOUD, count), ('is_dense', '?')])


def sheep_in(data: bytes, frame: str) -> tuple[int, Array, Array]:
    """Time [ns], positions (N, 2) [m] and velocities (N, 2) [m/s] of sheep in a PointCloud2.

    Fields x, y, vx, vy must be there as floats, in any order and with any others.
    """
    message = decoded(data, PointCloud2)
    check_frame('sheep', message.header.frame_id, frame)
    if not message.width * message.height:
        raise ValueError('sheep are an empty cloud, allowed is at least one point')
    sheep = points(message)
    missing = [
        name
        for name in ('x', 'y', 'vx', 'vy')
        if name not in (sheep.dtype.names or ()) or sheep.dtype[name].kind != 'f'
    ]
    if missing:
        raise ValueError(f'sheep have no field {", ".join(missing)} of type FLOAT32 or FLOAT64')
    values = np.stack([sheep[name] for name in ('x', 'y', 'vx', 'vy')], axis=1)
    values = finite('sheep positions and velocities', values, (None, 4))
    return nanoseconds(message.header.stamp), values[:, :2], values[:, 2:]


def odometry(d: Array, u: Array, m: int, ns: int, frame: str) -> bytes:
    """Odometry of dog m at d (2,) [m] with velocity u (2,) [m/s]; it looks along x."""
    template = _odometry(m, frame)
    template.numbers['position'][:2] = d
    template.numbers['linear'][:2] = u
    return template.stamped(ns)


@lru_cache(maxsize=1000)
def _odometry(m: int, frame: str) -> Template:
    message = Odometry(header=Header(frame_id=frame), child_frame_id=dog_frame(m))
    return Template(message, _ODOMETRY)


def dog_in(data: bytes, frame: str) -> tuple[int, Array, float]:
    """Time [ns], position (2,) [m] and heading [rad] of a dog in an Odometry."""
    ns, given, numbers = read(data, Odometry, _ODOMETRY)
    check_frame('odometry', given, frame)
    x, y, z, w = numbers['orientation'].tolist()
    heading = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    values = finite('dog position and heading', [*numbers['position'][:2], heading], (3,))
    return ns, values[:2], heading


def command(u: Array, heading: float, m: int, ns: int) -> bytes:
    """Velocity u (2,) [m/s] in the map as a TwistStamped in the body frame of dog m."""
    template = _command(m)
    template.numbers['linear'][:2] = _turned(u, heading)
    return template.stamped(ns)


@lru_cache(maxsize=1000)
def _command(m: int) -> Template:
    return Template(TwistStamped(header=Header(frame_id=dog_frame(m))), _COMMAND)


def twist(u: Array, heading: float) -> Twist:
    """Velocity u (2,) [m/s] in the map as a command in the body frame of a dog."""
    x, y = _turned(u, heading)
    return Twist(linear=Vector3(x=x, y=y))


def _turned(u: Array, heading: float) -> tuple[float, float]:
    """Return u (2,) in axes that are turned by heading [rad]."""
    c, s = math.cos(heading), math.sin(heading)
    x, y = u.tolist()
    return c * x + s * y, c * y - s * x


def command_in(data: bytes, m: int, frame: str) -> tuple[int, Array]:
    """Time [ns] and velocity (2,) [m/s] of a TwistStamped for dog m."""
    ns, given, numbers = read(data, TwistStamped, _COMMAND)
    check_frame('command', given, dog_frame(m), frame)
    return ns, finite('command', numbers['linear'][:2], (2,))


def twist_in(data: bytes) -> Array:
    """Velocity (2,) [m/s] of a Twist."""
    linear = decoded(data, Twist).linear
    return finite('command', [linear.x, linear.y], (2,))


def goal_in(message: PoseStamped, frame: str) -> Array:
    """Destination (2,) [m]."""
    check_frame('goal', message.header.frame_id, frame)
    position = message.pose.position
    return finite('goal', [position.x, position.y], (2,))


def trajectory(plan: Plan, dogs: Array, ns: int, frame: str) -> bytes:
    """Plan with the dogs' planned positions (intervals, M, 2) [m] at the intervals' starts.

    A MultiDOFJointTrajectory.
    """
    template = _trajectory(*plan.u.shape[:2], frame)
    points = template.numbers['points']
    points['transforms']['translation'][..., :2] = dogs
    points['velocities']['linear'][..., :2] = plan.u
    times = np.rint(np.arange(len(dogs)) * plan.dt * 1e9).astype(int)
    points['sec'], points['nanosec'] = np.divmod(times, 1_000_000_000)
    return template.stamped(ns)


@lru_cache(maxsize=16)
def _trajectory(intervals: int, count: int, frame: str) -> Template:
    point = MultiDOFJointTrajectoryPoint(
        transforms=[Transform(rotation=Quaternion(w=1.0))] * count, velocities=[Twist()] * count
    )
    message = MultiDOFJointTrajectory(
        header=Header(frame_id=frame),
        joint_names=[f'dog_{m + 1}' for m in range(count)],
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


def path(route: Array, dt: float, ns: int, frame: str) -> Path:
    """Route (K, 2) [m], its points dt [s] apart, the first at the stamp."""
    message = Path(header=Header(stamp=stamp_of(ns), frame_id=frame))
    upright = Quaternion(w=1.0)
    for k, (x, y) in enumerate(route.tolist()):
        header = Header(stamp=stamp_of(ns + round(k * dt * 1e9)), frame_id=frame)
        pose = Pose(position=Point(x=x, y=y), orientation=upright)
        message.poses.append(PoseStamped(header=header, pose=pose))
    return message


def diagnostics(
    name: str, ns: int, level: bytes, summary: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """One status of one part of a node, name 'node: part'."""
    status = DiagnosticStatus(level=level, name=name, message=summary, hardware_id='herding_ros')
    status.values = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
    return DiagnosticArray(header=Header(stamp=stamp_of(ns)), status=[status])


def _text(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def report_values(report: SolveReport) -> dict[str, object]:
    """Return what /diagnostics says about a solve."""
    return {
        'solve_ms': 1e3 * report.seconds['total'],
        'status': report.status.value,
        'objective': report.objective,
        'gradient_norm': report.gradient_norm,
        'optimiser_iterations': report.optimiser_iterations,
        'optimiser_calls': report.optimiser_calls,
        'fine_calls': report.fine_calls,
        'extraction_calls': report.extraction_calls,
        'mapping_status': report.mapping_status.value,
        'mapping_iterations': report.mapping_iterations,
        'mapping_residuals': ' '.join(f'{r:.3g}' for r in report.mapping_residuals),
        'mapping_error_before': report.mapping_error_before,
        'mapping_error_after': report.mapping_error_after,
        **{f'{phase}_ms': 1e3 * s for phase, s in report.seconds.items() if phase != 'total'},
    }


def markers(x: Array, d: Array, goal: Array, ns: int, frame: str) -> MarkerArray:
    """Sheep as blue dots, dogs as red triangles, a cross at the destination."""
    blue, red = ColorRGBA(r=0.1, g=0.3, b=0.9, a=1.0), ColorRGBA(r=0.9, g=0.1, b=0.1, a=1.0)
    black = ColorRGBA(a=1.0)
    corners = 0.04 * np.array([[0.0, 1.0], [-0.87, -0.5], [0.87, -0.5]])
    cross = 0.05 * np.array([[-1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [1.0, -1.0]])
    shapes = (
        ('sheep', Marker.SPHERE_LIST, blue, 0.03, x),
        ('dogs', Marker.TRIANGLE_LIST, red, 1.0, (d[:, None] + corners).reshape(-1, 2)),
        ('goal', Marker.LINE_LIST, black, 0.01, goal + cross),
    )
    return MarkerArray(
        markers=[
            Marker(
                header=Header(stamp=stamp_of(ns), frame_id=frame),
                ns=name,
                type=kind,
                action=Marker.ADD,
                pose=Pose(orientation=Quaternion(w=1.0)),
                scale=Vector3(x=size, y=size, z=size),
                color=color,
                points=[Point(x=x, y=y) for x, y in vertices.tolist()],
            )
            for name, kind, color, size, vertices in shapes
        ]
    )
