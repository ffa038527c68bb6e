"""Messages <-> arrays: the only place that knows what a message looks like.

Everything is in SI units. Conversions from messages raise ValueError on anything that must
not move a dog: wrong frames and fields, NaN, infinities.
"""

from __future__ import annotations

import array
from collections.abc import Mapping

from builtin_interfaces.msg import Duration, Time
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

_COORDINATES = ('x', 'y', 'z', 'vx', 'vy', 'vz')
_CLOUD = np.dtype([('id', '<u4'), *((name, '<f4') for name in _COORDINATES)])
_FIELDS = [
    PointField(name='id', offset=0, datatype=PointField.UINT32, count=1),
    *(
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate(_COORDINATES, start=1)
    ),
]


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


def cloud(x: Array, v: Array, ns: int, frame: str) -> PointCloud2:
    """Sheep at x (N, 2) [m] with velocities v (N, 2) [m/s] as a point cloud."""
    sheep = np.zeros(len(x), _CLOUD)
    sheep['id'] = np.arange(len(x))
    sheep['x'], sheep['y'] = x.T
    sheep['vx'], sheep['vy'] = v.T
    return PointCloud2(
        header=Header(stamp=stamp_of(ns), frame_id=frame),
        height=1,
        width=len(x),
        fields=_FIELDS,
        is_bigendian=False,
        point_step=_CLOUD.itemsize,
        row_step=_CLOUD.itemsize * len(x),
        data=array.array('B', sheep.tobytes()),
        is_dense=True,
    )


def sheep_in(message: PointCloud2, frame: str) -> tuple[Array, Array]:
    """Positions (N, 2) [m] and velocities (N, 2) [m/s] of the sheep in a point cloud.

    Fields x, y, vx, vy must be there as floats, in any order and with any others.
    """
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
    x = np.stack([sheep['x'], sheep['y']], axis=1)
    v = np.stack([sheep['vx'], sheep['vy']], axis=1)
    return finite('sheep positions', x, (None, 2)), finite('sheep velocities', v, (None, 2))


def odometry(d: Array, u: Array, m: int, ns: int, frame: str) -> Odometry:
    """Dog m at d (2,) [m] with velocity u (2,) [m/s]; its body axes are those of the frame."""
    message = Odometry(header=Header(stamp=stamp_of(ns), frame_id=frame))
    message.child_frame_id = dog_frame(m)
    message.pose.pose.position.x, message.pose.pose.position.y = float(d[0]), float(d[1])
    message.twist.twist.linear.x, message.twist.twist.linear.y = float(u[0]), float(u[1])
    return message


def dog_in(message: Odometry, frame: str) -> tuple[Array, float]:
    """Position (2,) [m] and heading [rad] of a dog."""
    check_frame('odometry', message.header.frame_id, frame)
    pose = message.pose.pose
    q = pose.orientation
    heading = np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    finite('dog heading', [heading], (1,))
    return finite('dog position', [pose.position.x, pose.position.y], (2,)), float(heading)


def command(u: Array, heading: float, m: int, ns: int) -> TwistStamped:
    """Velocity u (2,) [m/s] in the map as a command in the body frame of dog m."""
    message = TwistStamped(header=Header(stamp=stamp_of(ns), frame_id=dog_frame(m)))
    c, s = np.cos(heading), np.sin(heading)
    message.twist.linear.x = float(c * u[0] + s * u[1])
    message.twist.linear.y = float(c * u[1] - s * u[0])
    return message


def velocity_in(message: Twist) -> Array:
    """Velocity (2,) [m/s] of a command."""
    return finite('command', [message.linear.x, message.linear.y], (2,))


def goal_in(message: PoseStamped, frame: str) -> Array:
    """Destination (2,) [m]."""
    check_frame('goal', message.header.frame_id, frame)
    position = message.pose.position
    return finite('goal', [position.x, position.y], (2,))


def _duration(t: float) -> Duration:
    ns = round(t * 1e9)
    return Duration(sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)


def trajectory(plan: Plan, dogs: Array, ns: int, frame: str) -> MultiDOFJointTrajectory:
    """Plan with the dogs' planned positions (intervals, M, 2) [m] at the intervals' starts."""
    message = MultiDOFJointTrajectory(header=Header(stamp=stamp_of(ns), frame_id=frame))
    count = plan.u.shape[1]
    message.joint_names = [f'dog_{m + 1}' for m in range(count)]
    upright = Quaternion(w=1.0)
    for k, (u, d) in enumerate(zip(plan.u.tolist(), dogs.tolist(), strict=True)):
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[
                    Transform(translation=Vector3(x=x, y=y), rotation=upright) for x, y in d
                ],
                velocities=[Twist(linear=Vector3(x=x, y=y)) for x, y in u],
                time_from_start=_duration(k * plan.dt),
            )
        )
    return message


def path(route: Array, dt: float, ns: int, frame: str) -> Path:
    """Route (K, 2) [m], its points dt [s] apart, the first at the stamp."""
    message = Path(header=Header(stamp=stamp_of(ns), frame_id=frame))
    for k, (x, y) in enumerate(route.tolist()):
        header = Header(stamp=stamp_of(ns + round(k * dt * 1e9)), frame_id=frame)
        pose = Pose(position=Point(x=x, y=y))
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
