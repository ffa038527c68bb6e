"""Messages <-> arrays: the only place that knows what a message looks like.

Everything is in SI units. Conversions from messages take their bytes, and raise Refused on
anything that must not move a dog; what is not read (a height, a covariance) may be anything, but
for commands. What goes out at every control period is made as bytes too (see `wire`).
"""

from __future__ import annotations

import array
from collections.abc import Mapping
from functools import lru_cache
import math
from typing import NamedTuple

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
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from herding_ros.control.plan import Plan
from herding_ros.model.state import Array
from herding_ros.point_cloud import points

from .refusals import Refused
from .wire import Reader, seconds_and_rest, Template

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

_LARGEST = 1e6
"""No coordinate [m] or velocity [m/s] is larger: single precision would not see a sheep move."""

_ROUNDING = 0.1
"""By how much the squared length of a quaternion may differ from 1."""

_MOST_FIELDS = 64
"""Fields of a point cloud: each takes room and time, before the points are looked at."""


def nanoseconds(stamp: Time) -> int:
    """Return a stamp in nanoseconds."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def stamp_of(ns: int) -> Time:
    """Return nanoseconds as a stamp, or the nearest one that there is."""
    sec, nanosec = seconds_and_rest(ns)
    return Time(sec=sec, nanosec=nanosec)


def check_frame(what: str, given: str, *allowed: str) -> None:
    """Raise Refused unless a message is in one of the allowed frames."""
    if given not in allowed:
        names = ' or '.join(f"'{name}'" for name in allowed)
        raise Refused('wrong frame', f'{what} is in frame {given!r}, allowed is {names}')


def check_stamp(ns: int, now: int, oldest: float, ahead: float) -> None:
    """Raise Refused when a stamp [ns] is more than `oldest` [s] before now or `ahead` after it."""
    age = (now - ns) * 1e-9
    if age > oldest:
        raise Refused(
            'stamp too old',
            f'it is stamped {age:g} s ago, allowed are {oldest:g} s; '
            'has everybody the same clock (use_sim_time)?',
        )
    if age < -ahead:
        raise Refused(
            'stamp in the future',
            f'it is stamped {-age:g} s ahead, allowed are {ahead:g} s; '
            'has everybody the same clock (use_sim_time)?',
        )


def _check_size(what: str, *values: float) -> None:
    """Raise Refused unless values are such as something in a pasture may have."""
    size = math.hypot(*values)
    if not size <= _LARGEST:
        _check_finite(what, *values)
        raise Refused('too large', f'{what} are {size:g}, allowed are {_LARGEST:g} [m, m/s]')


def _check_finite(what: str, *values: float) -> None:
    if not all(map(math.isfinite, values)):
        raise Refused('not finite', f'{what} hold NaN or infinite values; all must be finite')


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


class Sheep(NamedTuple):
    """The flock at ns: ids (N,), increasing, positions x (N, 2) [m], velocities v [m/s]."""

    ns: int
    ids: NDArray[np.uint32]
    x: Array
    v: Array


def sheep_in(data: bytes, frame: str, most: int) -> Sheep:
    """Sheep in a PointCloud2, sorted by id; more than `most` are refused unseen.

    Fields x, y, vx, vy must be there as floats, in any order and with any others. An integer
    field id tells who is who; without it the order does.
    """
    reader = Reader(data)
    ns, given = reader.header()
    check_frame('sheep', given, frame)
    cloud = _point_cloud_in(reader, most)
    try:
        sheep = points(cloud)
    except ValueError as error:
        raise Refused('malformed', str(error)) from None
    values: Array = np.empty((len(sheep), 4))
    with np.errstate(invalid='ignore'):  # converting some NaN warns on stderr
        for i, name in enumerate(('x', 'y', 'vx', 'vy')):
            values[:, i] = _column(sheep, name, 'f', 'FLOAT32 or FLOAT64')
    _check_size('sheep positions and velocities', float(values.min()), float(values.max()))
    if not any(field.name == 'id' for field in cloud.fields):
        return Sheep(ns, np.arange(len(sheep), dtype=np.uint32), values[:, :2], values[:, 2:])
    ids = _column(sheep, 'id', 'iu', 'integer').astype(np.uint32)
    if not (ids[1:] > ids[:-1]).all():
        order = np.argsort(ids)
        ids, values = ids[order], values[order]
        if (ids[1:] == ids[:-1]).any():
            raise Refused('duplicate ids', 'two sheep have the same id; each needs its own')
    return Sheep(ns, ids, values[:, :2], values[:, 2:])


def _column(sheep: NDArray[np.void], name: str, kinds: str, allowed: str) -> NDArray[np.generic]:
    if name not in (sheep.dtype.names or ()) or sheep.dtype[name].kind not in kinds:
        raise Refused('wrong fields', f'sheep have no field {name} of type {allowed}')
    column: NDArray[np.generic] = sheep[name]
    return column


class _Field(NamedTuple):
    name: str
    offset: int
    datatype: int
    count: int  # type: ignore[assignment]


class _PointCloud(NamedTuple):
    height: int
    width: int
    fields: tuple[_Field, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: memoryview


def _point_cloud_in(reader: Reader, most: int) -> _PointCloud:
    """Read what comes after the header of a PointCloud2 with one to `most` points."""
    height, width, field_count = reader.numbers('III')
    if width * height > most:
        raise Refused('too many sheep', f'there are {width * height} sheep, allowed are {most}')
    if not width * height:
        raise Refused('empty', 'sheep are an empty cloud, allowed is at least one point')
    if field_count > _MOST_FIELDS:
        raise Refused(
            'wrong fields', f'sheep have {field_count} fields, allowed are {_MOST_FIELDS}'
        )
    fields = tuple(_Field(reader.text(), *reader.numbers('IBxxxI')) for _ in range(field_count))
    is_bigendian, point_step, row_step = reader.numbers('?xxxII')
    points_data = reader.sequence()
    # One byte, is_dense, and what fills up the message to a multiple of four.
    if not 1 <= reader.left <= 4:
        raise Refused('malformed', f'{reader.left} bytes follow the points, allowed are 1 to 4')
    return _PointCloud(height, width, fields, is_bigendian, point_step, row_step, points_data)


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
    reader = Reader(data)
    ns, given = reader.header()
    check_frame('odometry', given, frame)
    reader.text()  # the child frame
    d_x, d_y, _, x, y, z, w = reader.doubles(_ODOMETRY.itemsize // 8, 7)
    _check_size('dog position and orientation', d_x, d_y, x, y, z, w)
    if not abs(x * x + y * y + z * z + w * w - 1.0) <= _ROUNDING:
        raise Refused(
            'not a rotation', f'the orientation ({x:g}, {y:g}, {z:g}, {w:g}) has not the length 1'
        )
    # Does not depend on the length, so that nothing has to be normalised.
    heading = math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return ns, np.array([d_x, d_y]), heading


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


def command_in(data: bytes, m: int, frame: str, max_speed: float) -> tuple[int, Array]:
    """Time [ns] and velocity (2,) [m/s], of at most max_speed, of a TwistStamped for dog m."""
    reader = Reader(data)
    ns, given = reader.header()
    check_frame('command', given, dog_frame(m), frame)
    return ns, _velocity_in(reader, max_speed)


def twist_in(data: bytes, max_speed: float) -> Array:
    """Velocity (2,) [m/s], of at most max_speed [m/s], of a Twist."""
    return _velocity_in(Reader(data), max_speed)


def _velocity_in(reader: Reader, max_speed: float) -> Array:
    """Read the linear and angular velocity at the end of a message; x and y count.

    Who sends NaN in any of them does not know what he wants.
    """
    values = reader.doubles(6, 6)
    _check_finite('command', *values)
    x, y = values[:2]
    if math.hypot(x, y) > max_speed * (1 + 1e-6):  # rounded, and turned into the dog's frame
        raise Refused('too fast', f'{math.hypot(x, y):g} m/s, allowed are {max_speed:g} m/s')
    return np.array([x, y])


def goal_in(data: bytes, frame: str) -> Array:
    """Destination (2,) [m] in a PoseStamped."""
    reader = Reader(data)
    _, given = reader.header()
    check_frame('goal', given, frame)
    x, y = reader.doubles(7, 2)
    _check_size('goal', x, y)
    return np.array([x, y])


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
