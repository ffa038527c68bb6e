# SPDX-License-Identifier: Apache-2.0
"""Messages carry what was put in, and nothing that must not move a dog gets out.

Foreign messages are written by rosbags, in both byte orders.
"""

from __future__ import annotations

import array
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
import math
import struct
import tracemalloc
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point,
    Point32,
    Polygon,
    PolygonStamped,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    Transform,
    Twist,
    TwistStamped,
    Vector3,
)
from herding_ros.checks import check_goal, Refused
from herding_ros.control.plan import Plan
from herding_ros.markers import surroundings_in
from herding_ros.model.field import Field
from herding_ros.nodes import messages
from herding_ros.nodes import refusals as refusals_module
from herding_ros.nodes.drawing import Drawing
from herding_ros.nodes.refusals import Refusals
from herding_ros.nodes.wire import serialized
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from nav_msgs.msg import MapMetaData, OccupancyGrid, Odometry, Path
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import get_typestore, Stores
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

STORE = get_typestore(Stores.ROS2_JAZZY)
MOST = 1000
SPEED = 0.05

READERS: dict[str, Callable[[bytes], Any]] = {
    'sheep': lambda data: messages.sheep_in(data, 'map', MOST),
    'odometry': lambda data: messages.dog_in(data, 'map'),
    'command': lambda data: messages.command_in(data, 1, 'map', SPEED),
    'twist': lambda data: messages.twist_in(data, SPEED),
    'goal': lambda data: messages.goal_in(data, 'map'),
    'grid': lambda data: messages.grid_in(data, 'map'),
    'outline': lambda data: messages.outline_in(data, 'map'),
    'plan': lambda data: messages.plan_in(data, 'map'),
    'path': lambda data: messages.path_in(data, 'map'),
}

CELLS = (0, -1, 100, 65, 64, 1)
"""Of a map: free, unknown, occupied, just occupied, not quite, free."""

coordinates = st.floats(-1e3, 1e3, width=32)
points = st.integers(1, 40).flatmap(lambda n: arrays(np.float64, (n, 2), elements=coordinates))


@given(points, st.integers(0, 2**31 * 10**9 - 1))
def test_sheep_come_out_as_they_went_in(x: np.ndarray, ns: int) -> None:
    data = messages.cloud(x, x[::-1], ns, 'map')
    sheep = messages.sheep_in(data, 'map', len(x))
    assert sheep.ns == ns
    assert np.array_equal(sheep.ids, np.arange(len(x)))
    assert np.array_equal(sheep.x, x)
    assert np.array_equal(sheep.v, x[::-1])
    message = deserialize_message(data, PointCloud2)
    assert messages.nanoseconds(message.header.stamp) == ns
    assert (message.width, message.height, message.is_dense) == (len(x), 1, True)


def test_cloud_is_what_rviz_expects() -> None:
    data = messages.cloud(np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]]), 0, 'map')
    message = deserialize_message(data, PointCloud2)
    raw = np.frombuffer(message.data, np.uint8)
    values = {}
    for field in message.fields:
        kind = {PointField.FLOAT32: '<f4', PointField.UINT32: '<u4'}[field.datatype]
        values[field.name] = raw[field.offset : field.offset + 4].view(kind)[0]
    assert values == {'id': 0, 'x': 1, 'y': 2, 'z': 0, 'vx': 3, 'vy': 4, 'vz': 0}
    assert message.row_step == message.point_step == len(message.data)


@st.composite
def foreign_clouds(draw: Any) -> tuple[bytes, np.ndarray, np.ndarray | None]:
    """A PointCloud2 in any layout that is allowed: its bytes, (x, y, vx, vy) (N, 4) and ids.

    Whatever its other fields say of themselves.
    """
    height, width = draw(st.integers(1, 3)), draw(st.integers(1, 6))
    order = draw(st.sampled_from('<>'))
    read = {name: draw(st.sampled_from(['f4', 'f8'])) for name in ('x', 'y', 'vx', 'vy')}
    if draw(st.booleans()):
        read['id'] = draw(st.sampled_from(['i1', 'u1', 'i2', 'u2', 'i4', 'u4']))
    names = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=20)
    others = draw(st.lists(names.filter(lambda name: name not in (*read, 'id')), max_size=4))
    fields, offset = [], 0
    for name in draw(st.permutations([*read, *others, *others[:1]])):
        if name not in read:
            anywhere = st.integers(0, 2**32 - 1)
            fields.append((name, draw(anywhere), draw(st.integers(0, 255)), draw(anywhere)))
            continue
        offset += draw(st.integers(0, 9))
        fields.append((name, offset, DATATYPES[read[name]], draw(st.integers(0, 1))))
        offset += np.dtype(read[name]).itemsize
    step = offset + draw(st.integers(0, 9))
    gap = draw(st.integers(0, 9))
    row_step = width * step + gap

    data = bytearray(draw(st.binary(min_size=height * row_step, max_size=height * row_step)))
    values = np.empty((height * width, 4))
    ids = None
    if 'id' in read:
        limits = np.iinfo(read['id'])
        whole = st.integers(int(limits.min), int(limits.max))
        ids = np.array(
            draw(st.lists(whole, min_size=len(values), max_size=len(values), unique=True))
        )
    offsets = {name: offset for name, offset, *_ in fields}
    for i in range(len(values)):
        at = i // width * row_step + i % width * step
        for column, name in enumerate(('x', 'y', 'vx', 'vy')):
            values[i, column] = draw(st.floats(-1e3, 1e3, width=8 * int(read[name][1])))
            kind = {'f4': 'f', 'f8': 'd'}[read[name]]
            struct.pack_into(order + kind, data, at + offsets[name], values[i, column])
        if ids is not None:
            one = np.array([ids[i]]).astype(order + read['id']).tobytes()
            data[at + offsets['id'] : at + offsets['id'] + len(one)] = one
    message = PointCloud2(
        header=Header(stamp=Time(sec=1, nanosec=2), frame_id='map'),
        height=height,
        width=width,
        fields=[
            PointField(name=name, offset=offset, datatype=datatype, count=count)
            for name, offset, datatype, count in fields
        ],
        is_bigendian=order == '>',
        point_step=step,
        row_step=row_step if gap else draw(st.sampled_from([0, row_step])),
        data=array.array('B', bytes(data)),
        is_dense=draw(st.booleans()),
    )
    return (
        in_either_order(serialize_message(message), PointCloud2, draw(st.booleans())),
        values,
        ids,
    )


DATATYPES = {'i1': 1, 'u1': 2, 'i2': 3, 'u2': 4, 'i4': 5, 'u4': 6, 'f4': 7, 'f8': 8}


def in_either_order(data: bytes, kind: Any, big: bool) -> bytes:
    """The message in data, with its numbers in big-endian byte order if so wished."""
    if not big:
        return data
    name = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
    message = STORE.deserialize_cdr(data, name)
    return bytes(STORE.serialize_cdr(message, name, little_endian=False))


@given(foreign_clouds(), st.integers(0, 3))
@settings(max_examples=100)
def test_any_layout_of_a_cloud_is_understood(
    cloud: tuple[bytes, np.ndarray, np.ndarray | None], padding: int
) -> None:
    """Padded too at its end, as some send it: to a multiple of four bytes."""
    data, values, ids = cloud
    sheep = messages.sheep_in(data + bytes(min(padding, -len(data) % 4)), 'map', len(values))
    assert sheep.ns == 1_000_000_002
    order = np.arange(len(values)) if ids is None else np.argsort(ids.astype(np.uint32))
    assert np.array_equal(sheep.ids, order if ids is None else ids.astype(np.uint32)[order])
    assert np.array_equal(sheep.x, values[order, :2])
    assert np.array_equal(sheep.v, values[order, 2:])


def cloud_with(**changes: Any) -> bytes:
    """A cloud of ours of three sheep, but for the given attributes."""
    data = messages.cloud(np.eye(3)[:, :2], np.zeros((3, 2)), 0, 'map')
    message = deserialize_message(data, PointCloud2)
    for name, value in changes.items():
        setattr(message, name, value)
    return serialize_message(message)


def fields_with(index: int, **changes: Any) -> bytes:
    """The same, but for attributes of one of its fields id, x, y, z, vx, vy, vz."""
    fields = deserialize_message(cloud_with(), PointCloud2).fields
    for name, value in changes.items():
        setattr(fields[index], name, value)
    return cloud_with(fields=fields)


def points_with(at: int, number: bytes) -> bytes:
    """The same, but for some bytes of its points, which take 28 each."""
    points = deserialize_message(cloud_with(), PointCloud2).data
    points[at : at + len(number)] = array.array('B', number)
    return cloud_with(data=points)


def test_what_is_sent_has_zeros_between_its_fields() -> None:
    """The bytes are those of rosbags, which writes the message that rclpy has written."""
    plan = Plan(4.0, 0.4, np.ones((3, 2, 2)))
    for length in range(8):
        frame = 'map_of_a'[:length]
        sent = [
            messages.path(np.ones((length, 2)), 0.5, 7, frame),
            messages.marker_array(
                np.ones((length, 2)), np.ones((2, 2)), np.ones(2), 0.05, 7, frame
            ),
            messages.diagnostics(frame, 7, b'\2', frame, {frame: 1.5, 'a': 'ü'}),
            messages.twist(np.ones(2), 0.3),
            Clock(clock=messages.stamp_of(7)),
            PointCloud2(fields=[PointField(name=frame)], data=array.array('B', b'12345')),
            Odometry(header=Header(frame_id=frame), child_frame_id='dog'),
        ]
        for message in sent:
            data, kind = serialized(message), type(message)
            assert data == as_rosbags_writes_it(serialize_message(message), kind)
            read = deserialize_message(serialize_message(message), kind)
            assert deserialize_message(data, kind) == read
        x, names = np.ones((length, 2)), ('a', 'b')[: max(length % 3, 1)]
        data = messages.cloud(x, x, 7, frame)
        assert data == as_rosbags_writes_it(data, PointCloud2)
        routes = np.ones((3, len(names), 2))
        data = messages.trajectory(replace(plan, u=routes), routes, names, 7, frame)
        assert data == as_rosbags_writes_it(data, MultiDOFJointTrajectory)
        data = messages.odometry(np.ones(2), np.ones(2), 10**length, 7, frame)
        assert data == as_rosbags_writes_it(data, Odometry)
        data = messages.command(np.ones(2), 0.1, 10**length, 7)
        assert data == as_rosbags_writes_it(data, TwistStamped)


def as_rosbags_writes_it(data: bytes, kind: Any) -> bytes:
    """The message in data once more, with zeros between the fields, and up to four bytes."""
    name = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
    written = bytes(STORE.serialize_cdr(STORE.deserialize_cdr(data, name), name))
    return written + bytes(-len(written) % 4)


def number(value: float) -> bytes:
    return struct.pack('<f', value)


def refusal(what: str, data: bytes) -> str:
    """The kind as which a message is refused; '' if it is read."""
    try:
        READERS[what](data)
    except Refused as refused:
        return refused.kind
    return ''


ONE_ROW = array.array('B', bytes(84))
BAD_CLOUDS = {
    'no field': (cloud_with(fields=[]), 'wrong fields'),
    'no vy': (fields_with(5, name='speed'), 'wrong fields'),
    'integer x': (fields_with(1, datatype=PointField.INT32), 'wrong fields'),
    'float id': (fields_with(0, datatype=PointField.FLOAT32), 'wrong fields'),
    'many fields': (
        cloud_with(fields=[PointField(name=f'{k}', datatype=2, count=1) for k in range(65)]),
        'wrong fields',
    ),
    'two numbers in x': (fields_with(1, count=2), 'malformed'),
    'two numbers in id': (fields_with(0, count=2), 'malformed'),
    'unknown type': (fields_with(4, datatype=99), 'malformed'),
    'two fields x': (fields_with(2, name='x'), 'malformed'),
    'field beyond the point': (fields_with(5, offset=25), 'malformed'),
    'field far beyond the point': (fields_with(5, offset=2**32 - 1), 'malformed'),
    'field where NumPy looks for it beyond its memory': (
        fields_with(5, offset=2**31 - 1),
        'malformed',
    ),
    'long name': (fields_with(3, name='z' * 256), 'malformed'),
    'too few bytes': (cloud_with(data=ONE_ROW[:-1]), 'malformed'),
    'too many bytes': (cloud_with(data=ONE_ROW + ONE_ROW[:1]), 'malformed'),
    'too many bytes without row step': (cloud_with(row_step=0, data=ONE_ROW * 2), 'malformed'),
    'row shorter than its points': (cloud_with(row_step=83, data=ONE_ROW[:-1]), 'malformed'),
    'no point step': (cloud_with(point_step=0), 'malformed'),
    'points of no size': (
        cloud_with(point_step=0, row_step=0, data=ONE_ROW[:0]),
        'malformed',
    ),
    'nothing of no size': (
        cloud_with(fields=[], point_step=0, row_step=0, data=ONE_ROW[:0]),
        'malformed',
    ),
    'steps beyond all': (cloud_with(point_step=2**32 - 1, row_step=2**32 - 1), 'malformed'),
    'stamp of more than a second': (
        cloud_with(header=Header(stamp=Time(nanosec=10**9), frame_id='map')),
        'malformed',
    ),
    'empty': (cloud_with(width=0, row_step=0, data=ONE_ROW[:0]), 'empty'),
    'no rows': (cloud_with(height=0, data=ONE_ROW[:0]), 'empty'),
    'no sheep in sight': (
        cloud_with(is_dense=False, data=array.array('B', number(math.nan) * 21)),
        'empty',
    ),
    'one too many': (
        messages.cloud(np.zeros((MOST + 1, 2)), np.zeros((MOST + 1, 2)), 0, 'map'),
        'too many sheep',
    ),
    'far too many': (cloud_with(width=2**32 - 1, height=2**32 - 1), 'too many sheep'),
    'same id': (points_with(28, bytes(4)), 'duplicate ids'),
    'NaN in x': (points_with(4, number(math.nan)), 'not finite'),
    'signalling NaN in vx': (points_with(44, b'\1\0\x80\x7f'), 'not finite'),
    'infinity': (points_with(36, number(math.inf)), 'not finite'),
    'minus infinity': (points_with(64, number(-math.inf)), 'not finite'),
    'x beyond single precision': (points_with(4, number(1.1e6)), 'too large'),
    'vy beyond single precision': (points_with(48, number(1.1e6)), 'too large'),
    'huge vy': (points_with(48, number(-3e38)), 'too large'),
    'other frame': (cloud_with(header=Header(frame_id='odom')), 'wrong frame'),
    'no frame': (cloud_with(header=Header()), 'wrong frame'),
    'frame of two names': (cloud_with(header=Header(frame_id='map ')), 'wrong frame'),
}


@pytest.mark.filterwarnings('error')
def test_bad_clouds_are_refused() -> None:
    found = {name: refusal('sheep', cloud) for name, (cloud, _) in BAD_CLOUDS.items()}
    assert found == {name: kind for name, (_, kind) in BAD_CLOUDS.items()}


@pytest.mark.parametrize(
    ('changes', 'cause'),
    [
        ({'count': 2}, "'x' of the point cloud must be one number, got a count of 2"),
        ({'datatype': 0}, "'x' of the point cloud must have a datatype from 1 to 8, got 0"),
        ({'name': 'y'}, "'y' of the point cloud must be there once, got it 2 times"),
        ({'name': 'X'}, 'sheep must have a field x of type FLOAT32 or FLOAT64'),
    ],
)
def test_refused_field_is_told_with_its_cause(changes: dict[str, Any], cause: str) -> None:
    with pytest.raises(Refused, match=cause):
        messages.sheep_in(fields_with(1, **changes), 'map', MOST)


def test_sheep_out_of_sight_are_left_out_of_a_cloud_that_is_not_dense() -> None:
    """The other ones keep their ids, whether these are a field or their order."""
    points = deserialize_message(cloud_with(), PointCloud2).data
    points[28:32] = array.array('B', bytes(4))  # the id of nobody
    points[32:36] = array.array('B', number(math.nan))
    fields = deserialize_message(cloud_with(), PointCloud2).fields
    for fields_there in (fields, fields[1:]):
        cloud = cloud_with(is_dense=False, data=points, fields=fields_there)
        sheep = messages.sheep_in(cloud, 'map', 3)
        assert sheep.ids.tolist() == [0, 2]
        assert sheep.x.tolist() == [[1.0, 0.0], [0.0, 0.0]]


def test_who_can_do_without_velocities_reads_clouds_that_have_none() -> None:
    fields = deserialize_message(cloud_with(), PointCloud2).fields
    bare = cloud_with(fields=[field for field in fields if field.name not in ('vx', 'vy')])
    sheep = messages.sheep_in(bare, 'map', 3, needs_velocities=False)
    assert np.array_equal(sheep.x, np.eye(3)[:, :2])
    assert not sheep.v.any()
    assert not sheep.is_velocity_seen.any()
    with pytest.raises(Refused, match=r'a field vx of .* or sensor\.position_noise be set'):
        messages.sheep_in(bare, 'map', 3)
    half = cloud_with(fields=[field for field in fields if field.name != 'vx'])
    with pytest.raises(Refused, match='a field vx'):
        messages.sheep_in(half, 'map', 3, needs_velocities=False)


def test_a_sheep_whose_velocity_is_not_known_is_seen_by_who_can_do_without() -> None:
    points = deserialize_message(cloud_with(), PointCloud2).data
    points[28 + 16 : 28 + 20] = array.array('B', number(math.nan))  # vx of the second
    points[56 + 4 : 56 + 8] = array.array('B', number(math.nan))  # x of the third
    cloud = cloud_with(is_dense=False, data=points)
    sheep = messages.sheep_in(cloud, 'map', 3, needs_velocities=False)
    assert sheep.ids.tolist() == [0, 1]
    assert sheep.is_velocity_seen.tolist() == [True, False]
    assert not sheep.v.any()
    assert messages.sheep_in(cloud, 'map', 3).ids.tolist() == [0]
    for needs_velocities in (True, False):
        with pytest.raises(Refused, match='is_dense: true'):
            messages.sheep_in(cloud_with(data=points), 'map', 3, needs_velocities)


def test_far_from_the_origin_sheep_need_double_precision() -> None:
    """UTM has coordinates of 5,500 km, which single precision resolves to half a metre."""
    x = np.array([[412_345.678, 5_500_123.456], [412_346.789, 5_500_124.321]])
    kinds = [(name, '<f8') for name in ('x', 'y', 'vx', 'vy')]
    sheep = np.zeros(2, kinds)
    sheep['x'], sheep['y'] = x.T
    fields = [
        PointField(name=name, offset=8 * i, datatype=PointField.FLOAT64, count=1)
        for i, (name, _) in enumerate(kinds)
    ]
    cloud = cloud_with(
        fields=fields, width=2, point_step=32, row_step=64,
        data=array.array('B', sheep.tobytes()),
    )  # fmt: skip
    assert np.array_equal(messages.sheep_in(cloud, 'map', 3).x, x)
    with pytest.raises(Refused, match=r'resolves to 0\.5; send FLOAT64'):
        messages.sheep_in(messages.cloud(x, np.zeros((2, 2)), 0, 'map'), 'map', 3)


def test_what_is_not_read_may_be_anything() -> None:
    """A NaN as the height of sheep, dogs and goals, and in covariances, says 'not known'."""
    assert len(messages.sheep_in(points_with(12, number(math.nan)), 'map', 3).ids) == 3
    odometry = deserialize_message(ODOMETRY, Odometry)
    odometry.pose.pose.position.z = math.nan
    odometry.pose.covariance[0] = odometry.twist.covariance[0] = math.nan
    odometry.twist.twist.linear.x = math.inf
    assert messages.dog_in(serialize_message(odometry), 'map')[2] == 0.0
    goal = PoseStamped(header=Header(frame_id='map'))
    goal.pose.position.z = goal.pose.orientation.w = math.nan
    assert not messages.goal_in(serialize_message(goal), 'map').any()


def absurd_length(at: int, length: int) -> bytes:
    data = bytearray(cloud_with())
    struct.pack_into('<I', data, at, length)
    return bytes(data)


def test_absurd_lengths_take_no_memory() -> None:
    """Those of the frame, the rows, the points, the fields, a name, the steps and the data."""
    for at in (12, 20, 24, 28, 32, 176, 180, 184):
        for length in (2**24, 2**31, 2**32 - 1):
            assert peak_of_refusing(absurd_length(at, length)) < 20_000, (at, length)


def test_more_points_than_allowed_are_not_even_copied() -> None:
    n = 100_000
    data = messages.cloud(np.zeros((n, 2)), np.zeros((n, 2)), 0, 'map')
    assert len(data) > 28 * n
    assert peak_of_refusing(data) < 20_000


def test_a_megabyte_of_fields_is_refused_unseen() -> None:
    data = bytearray(messages.cloud(np.zeros((40_000, 2)), np.zeros((40_000, 2)), 0, 'map'))
    struct.pack_into('<III', data, 20, 1, 1, 60_000)
    assert peak_of_refusing(bytes(data)) < 20_000


def peak_of_refusing(data: bytes) -> int:
    """How many bytes were in use more than before while sheep were refused."""
    tracemalloc.start()
    try:
        with pytest.raises(Refused):
            messages.sheep_in(data, 'map', MOST)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_wrong_frame_is_refused_and_named() -> None:
    dog = messages.odometry(np.zeros(2), np.zeros(2), 1, 0, 'odom')
    goal = serialize_message(PoseStamped(header=Header(frame_id='odom')))
    sheep = messages.cloud(np.zeros((1, 2)), np.zeros((1, 2)), 0, 'odom')
    for what, data in [('sheep', sheep), ('odometry', dog), ('goal', goal)]:
        with pytest.raises(Refused, match="'map', got 'odom'"):
            READERS[what](data)
    command = messages.command(np.zeros(2), 0.0, 2, 0)
    with pytest.raises(Refused, match="'dog_1/base_link' or 'map', got 'dog_2/base_link'"):
        READERS['command'](command)


ODOMETRY = messages.odometry(np.zeros(2), np.zeros(2), 1, 0, 'map')
names = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=60)
numbers = st.floats(-1e5, 1e5)
turns = st.floats(-3.1, 3.1)


@given(
    arrays(np.float64, (2, 2), elements=coordinates), turns, names, st.floats(0.96, 1.04),
    st.booleans(),
)  # fmt: skip
def test_dog_and_heading_come_out_as_they_went_in(
    values: np.ndarray, heading: float, child: str, length: float, big: bool
) -> None:
    """Also from others' robots, which fill in what we leave at zero, and round quaternions."""
    data = messages.odometry(values[0], values[1], 3, 5, 'map')
    message = deserialize_message(data, Odometry)
    assert message.header == Header(stamp=Time(nanosec=5), frame_id='map')
    assert message.child_frame_id == 'dog_3/base_link'
    assert message.twist.twist.linear == Vector3(x=values[1, 0], y=values[1, 1])
    assert messages.dog_in(data, 'map')[2] == 0.0
    message.child_frame_id = child
    message.pose.pose.orientation.z = length * math.sin(heading / 2)
    message.pose.pose.orientation.w = length * math.cos(heading / 2)
    message.pose.covariance = message.twist.covariance = values[0, 0] + np.arange(36.0)
    foreign = in_either_order(serialize_message(message), Odometry, big)
    ns, position, out, _ = messages.dog_in(foreign, 'map')
    assert ns == 5
    assert np.array_equal(position, values[0])
    assert out == pytest.approx(heading, abs=1e-12)
    ours = messages.odometry(values[0], values[1], 3, 5, 'map', heading)
    _, _, out, velocity = messages.dog_in(ours, 'map')
    assert out == pytest.approx(heading, abs=1e-12)
    assert velocity == pytest.approx(values[1], abs=1e-15 + 1e-12 * np.abs(values[1]).max())


@given(turns, st.floats(-1.5, 1.5), turns)
def test_heading_is_where_the_nose_points(roll: float, pitch: float, yaw: float) -> None:
    """Of a dog on a slope too: R_z(yaw) R_y(pitch) R_x(roll) turns the x axis to that heading."""
    x, y, z, w = product(
        product((0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
                (0.0, math.sin(pitch / 2), 0.0, math.cos(pitch / 2))),
        (math.sin(roll / 2), 0.0, 0.0, math.cos(roll / 2)),
    )  # fmt: skip
    message = deserialize_message(ODOMETRY, Odometry)
    message.pose.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
    _, _, heading, _ = messages.dog_in(serialize_message(message), 'map')
    assert heading == pytest.approx(yaw, abs=1e-10)


def product(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    """Hamilton's product of quaternions (x, y, z, w)."""
    u, v = np.array(a[:3]), np.array(b[:3])
    return *(a[3] * v + b[3] * u + np.cross(u, v)), a[3] * b[3] - u @ v


def pose_with(**changes: float) -> Pose:
    pose = Pose(position=Point(), orientation=Quaternion(w=1.0))
    for name, value in changes.items():
        setattr(pose.position if name in ('px', 'py') else pose.orientation, name[-1], value)
    return pose


def odometry_with(**changes: float) -> bytes:
    pose = PoseWithCovariance(pose=pose_with(**changes))
    return serialize_message(Odometry(header=Header(frame_id='map'), pose=pose))


def goal_with(**changes: float) -> bytes:
    return serialize_message(PoseStamped(header=Header(frame_id='map'), pose=pose_with(**changes)))


def twist_with(part: str = 'linear', **changes: float) -> Twist:
    return Twist(**{part: Vector3(**changes)})


def command_with(part: str = 'linear', **changes: float) -> bytes:
    twist = twist_with(part, **changes)
    return serialize_message(TwistStamped(header=Header(frame_id='map'), twist=twist))


def grid_with(
    frame: str = 'map', resolution: float = 0.5, cells: Sequence[int] = CELLS, width: int = 3,
    height: int = 2, **origin: float,
) -> bytes:  # fmt: skip
    info = MapMetaData(resolution=resolution, width=width, height=height)
    info.origin = pose_with(**origin)
    return serialize_message(
        OccupancyGrid(header=Header(frame_id=frame), info=info, data=array.array('b', cells))
    )


def outline_with(*corners: tuple[float, float], frame: str = 'map') -> bytes:
    polygon = Polygon(points=[Point32(x=x, y=y, z=math.nan) for x, y in corners])
    return serialize_message(PolygonStamped(header=Header(frame_id=frame), polygon=polygon))


def test_a_map_comes_out_as_it_went_in() -> None:
    """Its first row is that at the origin, as map_server has it."""
    half = math.sqrt(0.5)
    for big in (False, True):
        data = in_either_order(grid_with(px=1.0, py=-2.0, z=half, w=half), OccupancyGrid, big)
        grid = messages.grid_in(data, 'map')
        assert grid.occupied.tolist() == [[False, False, True], [True, False, False]]
        assert (grid.resolution, grid.x, grid.y) == (0.5, 1.0, -2.0)
        assert grid.yaw == pytest.approx(math.pi / 2)


def test_an_obstacle_comes_out_as_it_went_in() -> None:
    """What its heights are does not count."""
    corners = ((0.0, -1.5), (1.0, 0.25), (0.5, 2.0))
    for big in (False, True):
        data = in_either_order(outline_with(*corners), PolygonStamped, big)
        assert messages.outline_in(data, 'map') == corners
    assert messages.outline_in(outline_with(), 'map') == ()


def test_maps_and_obstacles_that_are_none_are_refused() -> None:
    far = [(0.0, 0.0), (1.0, 0.0), (2e6, 2.0)]
    bad = [
        ('grid', grid_with('odom'), 'wrong frame'),
        ('grid', grid_with(cells=CELLS[:5]), 'malformed'),
        ('grid', grid_with(cells=(*CELLS, 0)), 'malformed'),
        ('grid', grid_with(cells=[], width=0), 'empty'),
        ('grid', grid_with(cells=[], height=0), 'empty'),
        ('grid', grid_with(cells=[], width=2**32 - 1, height=2**32 - 1), 'too large'),
        *(('grid', grid_with(cells=(*CELLS[:5], cell)), 'not allowed') for cell in (-2, 101)),
        *(('grid', grid_with(resolution=r), 'not allowed') for r in (0.0, -0.05, 1e-9, 1e4)),
        *(('grid', grid_with(resolution=r), kind) for r, kind in BAD),
        *(('grid', grid_with(**{at: bad}), kind) for bad, kind in BAD
          for at in ('px', 'py', 'x', 'w')),
        ('grid', grid_with(px=1e9), 'too large'),
        ('grid', grid_with(w=0.0), 'not a rotation'),
        ('grid', grid_with(x=math.sin(0.2), w=math.cos(0.2)), 'not a rotation'),
        ('outline', outline_with((0.0, 0.0), frame='odom'), 'wrong frame'),
        ('outline', outline_with(*[(0.0, 0.0)] * 101), 'too large'),
        ('outline', outline_with(*far), 'too large'),
        *(('outline', outline_with((0.0, bad)), kind) for bad, kind in BAD),
    ]  # fmt: skip
    for what, data, kind in bad:
        assert refusal(what, data) == kind, (what, data)


BAD = [(math.nan, 'not finite'), (math.inf, 'not finite'), (-math.inf, 'not finite')]


def test_numbers_that_must_not_move_a_dog_are_refused() -> None:
    bad = [
        *(('odometry', odometry_with(**{at: bad}), kind) for bad, kind in BAD
          for at in ('px', 'py', 'x', 'y', 'z', 'w')),
        *(('odometry', odometry_with(**{at: 1e300}), 'too large') for at in ('px', 'py', 'w')),
        ('odometry', odometry_with(w=0.0), 'not a rotation'),
        ('odometry', odometry_with(w=0.94), 'not a rotation'),
        ('odometry', odometry_with(z=0.5), 'not a rotation'),
        ('odometry', odometry_with(x=1e-200, w=0.0), 'not a rotation'),
        *(('goal', goal_with(**{at: bad}), kind) for at in ('px', 'py')
          for bad, kind in [*BAD, (1e300, 'too large'), (-1.1e8, 'too large')]),
        *(('command', command_with(part, **{at: bad}), kind) for bad, kind in BAD
          for part in ('linear', 'angular') for at in ('x', 'y', 'z')),
        ('command', command_with(x=SPEED * 1.00001), 'too fast'),
        ('command', command_with(x=-0.04, y=0.04), 'too fast'),
        ('command', command_with(y=1e300), 'too fast'),
        ('twist', serialize_message(twist_with(x=0.051)), 'too fast'),
        *(('twist', serialize_message(twist_with(y=bad)), kind) for bad, kind in BAD),
    ]  # fmt: skip
    for what, data, kind in bad:
        assert refusal(what, data) == kind, (what, data)


ROUTE = np.arange(12.0).reshape(3, 2, 2)

VALID = {
    'sheep': (cloud_with(), PointCloud2),
    'odometry': (odometry_with(px=1.0), Odometry),
    'command': (command_with(x=0.01), TwistStamped),
    'twist': (serialize_message(twist_with(x=0.01)), Twist),
    'goal': (goal_with(px=1.0), PoseStamped),
    'grid': (grid_with(), OccupancyGrid),
    'outline': (outline_with((0.0, 0.0), (1.0, 0.0), (0.5, 2.0)), PolygonStamped),
    'plan': (
        messages.trajectory(
            Plan(4.0, 0.4, ROUTE), ROUTE + 100.0, ('dog_1', 'dog_2'), 4_000_000_000, 'map'
        ),
        MultiDOFJointTrajectory,
    ),
    'path': (serialize_message(messages.path(ROUTE[:, 0], 1.5, 10**9, 'map')), Path),
}


def read_or_refused(what: str, data: bytes) -> None:
    """Whatever comes, it is refused, or what is made of it can do no harm."""
    try:
        read = READERS[what](data)
    except Refused:
        return
    if what == 'sheep':
        assert 1 <= len(read.ids) <= MOST
        assert read.x.shape == read.v.shape == (len(read.ids), 2)
        assert np.all(np.diff(read.ids.astype(np.int64)) > 0)
        values = [*read.x.ravel(), *read.v.ravel()]
    elif what == 'odometry':
        values = [*read[1], read[2]]
    elif what == 'grid':
        assert 1 <= read.occupied.size <= len(data)
        values = [read.x, read.y, read.yaw, read.resolution]
    elif what == 'outline':
        values = [number for corner in read for number in corner]
    elif what in ('plan', 'path'):
        assert len(read.times) == len(read.points) >= 1
        assert np.isfinite(read.points).all()  # it is drawn, and moves no dog
        values = []
    else:
        values = list(read[1] if what == 'command' else read)
    assert all(abs(value) <= 1e8 for value in values)
    if what in ('command', 'twist'):
        assert math.hypot(*values) <= SPEED * 1.000002


@pytest.mark.filterwarnings('error')
@given(st.sampled_from(list(READERS)),
       st.sampled_from([b'', b'\0\1\0\0', b'\0\0\0\0', b'\0\3\0\0', b'\0\1\0\0' + bytes(12)]),
       st.binary(max_size=800))  # fmt: skip
@settings(max_examples=500)
def test_random_bytes_are_harmless(what: str, beginning: bytes, data: bytes) -> None:
    read_or_refused(what, beginning + data)


@st.composite
def mutations(draw: Any, data: bytes) -> bytes:
    """The message with a few bytes, lengths or numbers changed, cut off, or with a part twice."""
    mutated = bytearray(data)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(len(mutated) - 1, 0)))
        what = draw(st.integers(0, 4))
        if what == 0:
            mutated[at : at + 1] = draw(st.binary(min_size=1, max_size=1))
        elif what == 1:
            word = draw(st.sampled_from([0, 1, 255, 256, 2**16, 2**31 - 1, 2**31, 2**32 - 1]))
            at -= at % 4
            mutated[at : at + 4] = word.to_bytes(4, draw(st.sampled_from(['little', 'big'])))
        elif what == 2:
            value = draw(st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -0.0, 5e-324]))
            at -= at % 4
            mutated[at : at + 8] = struct.pack(draw(st.sampled_from('<>')) + 'd', value)
        elif what == 3:
            del mutated[at : at + draw(st.integers(1, 8))]
        else:
            mutated[at:at] = mutated[at : at + draw(st.integers(1, 40))]
    return bytes(mutated[: draw(st.integers(0, len(mutated)))] if draw(st.booleans()) else mutated)


@pytest.mark.filterwarnings('error')
@given(st.sampled_from(list(READERS)), st.booleans(), st.data())
@settings(max_examples=500)
def test_mutated_messages_are_harmless(what: str, big: bool, data: st.DataObject) -> None:
    valid, kind = VALID[what]
    read_or_refused(what, data.draw(mutations(in_either_order(valid, kind, big))))


def test_cut_off_messages_are_refused_at_any_length() -> None:
    for what, (valid, kind) in VALID.items():
        for data in (in_either_order(valid, kind, big) for big in (False, True)):
            assert refusal(what, data) == ''
            for length in range(len(data)):
                assert refusal(what, data[:length]) == 'malformed', (what, length)
            for more in (8, 1000):
                assert refusal(what, data + bytes(more)) == 'malformed', (what, more)


def test_command_is_in_the_body_frame() -> None:
    """A dog that looks along +y and shall run along +x of the map has to run to its right."""
    data = messages.command(np.array([0.03, 0.0]), math.pi / 2, 1, 7)
    message = deserialize_message(data, TwistStamped)
    assert message.twist.linear.x == pytest.approx(0.0, abs=1e-17)
    assert message.twist.linear.y == pytest.approx(-0.03)
    assert message.header.frame_id == 'dog_1/base_link'
    assert message.header.stamp == Time(nanosec=7)


@given(arrays(np.float64, (2,), elements=st.floats(-0.035, 0.035)), st.booleans())
def test_command_to_an_aligned_dog_keeps_every_bit(u: np.ndarray, big: bool) -> None:
    data = in_either_order(messages.command(u, 0.0, 1, 8), TwistStamped, big)
    ns, velocity = messages.command_in(data, 1, 'map', SPEED)
    assert ns == 8
    assert np.array_equal(velocity, u)
    data = in_either_order(serialize_message(messages.twist(u, 0.0)), Twist, big)
    assert np.array_equal(messages.twist_in(data, SPEED), u)


def test_a_dog_that_has_to_turn_is_told_speed_and_turn_rate() -> None:
    """It looks along +y; a point 0.1 m ahead of it is to move along (0.03, 0.02) in the map."""
    data = messages.command(np.array([0.03, 0.02]), math.pi / 2, 1, 7, 0.1)
    message = deserialize_message(data, TwistStamped).twist
    assert message.linear.x == pytest.approx(0.02)
    assert message.linear.y == 0.0
    assert message.angular.z == pytest.approx(-0.3)  # to the right
    for found in (
        messages.command_in(data, 1, 'map', SPEED, 0.1)[1],
        messages.twist_in(
            serialize_message(messages.twist(np.array([0.03, 0.02]), math.pi / 2, 0.1)), SPEED, 0.1
        ),
    ):
        assert messages.turned(found, -math.pi / 2) == pytest.approx((0.03, 0.02))
    quick = serialize_message(Twist(angular=Vector3(z=1.0)))
    with pytest.raises(Refused, match=r'at most 0\.05 m/s at the point that is steered, got 0\.1'):
        messages.twist_in(quick, SPEED, 0.1)
    assert not messages.twist_in(quick, SPEED).any()


@given(turns, turns)
def test_full_speed_is_not_too_fast_in_any_direction(direction: float, heading: float) -> None:
    u = SPEED * np.array([math.cos(direction), math.sin(direction)])
    _, velocity = messages.command_in(messages.command(u, heading, 1, 0), 1, 'map', SPEED)
    assert np.linalg.norm(velocity) == pytest.approx(SPEED)


@given(arrays(np.float64, (2,), elements=numbers), st.integers(0, 2**31 - 1), st.booleans())
def test_goal_comes_out_as_it_went_in(goal: np.ndarray, sec: int, big: bool) -> None:
    message = PoseStamped(
        header=Header(stamp=Time(sec=sec), frame_id='map'),
        pose=Pose(position=Point(x=goal[0], y=goal[1], z=3.0)),
    )
    data = in_either_order(serialize_message(message), PoseStamped, big)
    assert np.array_equal(messages.goal_in(data, 'map'), goal)


def test_times_beyond_all_stamps_become_the_last_one() -> None:
    """A clock gone mad must not end a node."""
    for ns in (-(10**19), -(2**31) * 10**9, -1, 0, 2**31 * 10**9 - 1, 10**19):
        nearest = min(max(ns, -(2**31) * 10**9), 2**31 * 10**9 - 1)
        assert messages.nanoseconds(messages.stamp_of(ns)) == nearest
        data = messages.command(np.zeros(2), 0.0, 1, ns)
        assert messages.command_in(data, 1, 'map', SPEED)[0] == nearest


NOW = 1_700_000_000_000_000_000


def test_stamps_of_another_time_are_refused() -> None:
    for seconds in (-2.0, -0.1, 0.0, 0.5):
        messages.check_stamp(NOW + round(seconds * 1e9), NOW, oldest=2.0, ahead=0.5)
    for ns, kind in [
        (NOW - 2_000_001_000, 'stamp too old'),
        (NOW + 500_001_000, 'stamp in the future'),
        (0, 'stamp too old'),
        (-(2**31) * 10**9, 'stamp too old'),
        (2**31 * 10**9, 'stamp in the future'),
    ]:
        with pytest.raises(Refused) as refused:
            messages.check_stamp(ns, NOW, oldest=2.0, ahead=0.5)
        assert refused.value.kind == kind


class Log:
    """Stands in for a node's logger."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def warning(self, line: str) -> None:
        self.lines.append(line)


def test_refusals_are_counted_by_topic_and_kind_and_logged_once_for_each_cause() -> None:
    log = Log()
    refusals = Refusals(log)  # type: ignore[arg-type]
    for k in range(10_000):
        for topic, frame in [('sheep', 'odom' if k else 'base'), ('dog_1/odom', 'x' * k)]:
            with pytest.raises(Refused) as refused:
                messages.check_frame('it', frame, 'map')
            refusals.add(topic, refused.value)
        refusals.add('sheep', Refused('empty', f'{k}'))
        refusals.add('sheep', ValueError(f'{k}'))
    logged = {
        'sheep: wrong frame': 2,
        'dog_1/odom: wrong frame': 5,  # a stranger may make up any number of causes
        'sheep: empty': 1,
        'sheep: not allowed': 1,
    }
    assert refusals.counts == dict.fromkeys(logged, 10_000)
    assert Counter(line.split('(')[1].split(')')[0] for line in log.lines) == logged
    assert all(len(line) < 500 for line in log.lines)


def test_refused_goals_are_logged_whenever_they_change(monkeypatch: pytest.MonkeyPatch) -> None:
    log, now = Log(), [0.0]
    monkeypatch.setattr(refusals_module.time, 'monotonic', lambda: now[0])
    refusals = Refusals(log)  # type: ignore[arg-type]
    goals = [(7.0, 'odom'), (7.0, 'odom'), (8.0, 'odom'), (7.0, 'odom'), (math.nan, 'map')]
    for x, frame in goals:
        now[0] += 1.0
        with pytest.raises(Refused) as refused:
            check_goal(frame, x, 0.0, 'map')
        refusals.add_request('goal_pose', refused.value)
    said = [line.split('goal (')[1].split(' must')[0] for line in log.lines]
    assert said == ['7, 0)', '8, 0)', '7, 0)', 'nan, 0)']
    for k in range(1000):  # half a second's worth of a flood
        now[0] += 0.0005
        refusals.add_request('goal_pose', Refused('wrong frame', f'{k}'))
    assert len(log.lines) == 4
    assert refusals.counts == {'goal_pose: wrong frame': 1004, 'goal_pose: not finite': 1}


def test_names_in_a_refusal_cannot_write_to_the_terminal() -> None:
    with pytest.raises(Refused) as refused:
        messages.check_frame('it', '\x1b[2J\n[INFO] all is well', 'map')
    assert str(refused.value).isprintable()


def test_plan_says_when_and_where() -> None:
    u = np.arange(12.0).reshape(3, 2, 2)
    data = messages.trajectory(
        Plan(4.0, 0.4, u), u + 100.0, ('dog_1', 'dog_2'), 4_000_000_000, 'map'
    )
    message = deserialize_message(data, MultiDOFJointTrajectory)
    assert message.header == Header(stamp=Time(sec=4), frame_id='map')
    assert message.joint_names == ['dog_1', 'dog_2']
    starts = [p.time_from_start.sec * 10**9 + p.time_from_start.nanosec for p in message.points]
    assert starts == [0, 400_000_000, 800_000_000]
    for k, point in enumerate(message.points):
        velocities = [(velocity.linear.x, velocity.linear.y) for velocity in point.velocities]
        assert np.array_equal(velocities, u[k])
        assert all(velocity.angular == Vector3() for velocity in point.velocities)
        places = [(place.translation.x, place.translation.y) for place in point.transforms]
        assert np.array_equal(places, u[k] + 100.0)
        assert all(place.rotation == Quaternion(w=1.0) for place in point.transforms)
        assert not point.accelerations


@pytest.mark.parametrize('big', [False, True])
def test_plan_and_path_come_out_as_they_went_in(big: bool) -> None:
    plan, path = (READERS[what](in_either_order(*VALID[what], big)) for what in ('plan', 'path'))
    assert np.allclose(plan.times, [4.0, 4.4, 4.8])
    assert np.array_equal(plan.points, ROUTE + 100.0)
    assert np.allclose(path.times, [1.0, 2.5, 4.0])
    assert np.array_equal(path.points, ROUTE[:, 0])


def test_plan_of_dogs_that_come_and_go_is_refused() -> None:
    points = [MultiDOFJointTrajectoryPoint(transforms=[Transform()] * count) for count in (1, 2)]
    data = serialize_message(MultiDOFJointTrajectory(header=Header(frame_id='map'), points=points))
    assert refusal('plan', data) == 'malformed'
    for nothing in ('plan', 'path'):
        empty = serialize_message(VALID[nothing][1](header=Header(frame_id='map')))
        assert refusal(nothing, empty) == 'not finite'


def test_path_is_stamped_along_the_way() -> None:
    message = messages.path(np.array([[0.0, 1.0], [2.0, 3.0]]), 1.5, 10**9, 'map')
    stamps = [messages.nanoseconds(pose.header.stamp) for pose in message.poses]
    assert stamps == [10**9, 2_500_000_000]
    assert message.poses[1].pose.position.y == 3.0


def test_markers_show_sheep_dogs_and_goal() -> None:
    x, d = np.array([[1.0, 2.0]]), np.array([[3.0, 4.0], [5.0, 6.0]])
    drawn = messages.marker_array(x, d, np.array([7.0, 8.0]), 0.5, 0, 'map')
    shown = {m.ns: m for m in drawn.markers}
    assert [(p.x, p.y) for p in shown['sheep'].points] == [(1.0, 2.0)]
    assert len(shown['dogs'].points) == 6
    triangle = np.array([(p.x, p.y) for p in shown['dogs'].points[3:]])
    assert np.allclose(triangle.mean(axis=0), (5.0, 6.0), atol=0.01)
    cross = np.array([(p.x, p.y) for p in shown['goal'].points])
    assert np.allclose(cross.mean(axis=0), (7.0, 8.0))
    assert np.allclose(np.abs(cross - (7.0, 8.0)), 0.5)
    assert 'walls' not in shown


def test_markers_show_what_the_controller_has_decided() -> None:
    changes = np.array(
        [[[1.0, 1.0], [1.2, 1.0], [1.1, 1.1]], [[3.0, 1.0], [3.2, 1.0], [3.0, 1.0]]]
    )
    d = np.array([[1.0, 1.0], [3.0, 1.0]])
    walls, route = np.arange(8.0).reshape(2, 2, 2), np.arange(6.0).reshape(3, 2)
    shown = messages.drawing(Drawing(walls, route, d, 0.1, changes, 0.01), 7, 'field').markers
    assert shown[0].action == Marker.DELETEALL
    assert {m.header.frame_id for m in shown} == {'field'}
    assert {messages.nanoseconds(m.header.stamp) for m in shown} == {7}
    places = {(m.ns, m.id): np.array([(p.x, p.y) for p in m.points]) for m in shown if m.points}
    assert np.array_equal(places['walls', 0], walls.reshape(-1, 2))
    assert np.array_equal(places['route', 0], route)
    assert np.array_equal(places['separation', 0], d)
    assert np.array_equal(places['asked', 0], changes[:, :2].reshape(-1, 2))
    assert np.array_equal(places['told', 0], changes[0, 1:])
    assert np.array_equal(places['told', 1], changes[1, 1:])
    assert len(places) == len(shown) - 1 == 6
    (disc,) = [m for m in shown if m.ns == 'separation']
    assert disc.scale.x == disc.scale.y == 0.1  # two that touch are so far apart
    found = surroundings_in(MarkerArray(markers=shown), 'field')
    assert np.array_equal(found.walls, walls)
    assert np.array_equal(found.route, route)
    data = serialized(messages.drawing(Drawing(walls, route, d, 0.1, changes, 0.01), 7, 'a'))
    assert data == as_rosbags_writes_it(data, MarkerArray)


def test_nothing_is_drawn_of_what_is_not_there() -> None:
    none = np.zeros((0, 2))
    d = np.zeros((2, 2))
    drawn = Drawing(none.reshape(0, 2, 2), none, d, 0.0, none.reshape(0, 3, 2), 0.01)
    assert [m.action for m in messages.drawing(drawn, 7, 'map').markers] == [Marker.DELETEALL]


def test_drawing_that_nobody_can_draw_is_refused() -> None:
    walls, none = np.arange(8.0).reshape(2, 2, 2), np.zeros((0, 2))
    drawn = Drawing(walls, none, none, 0.0, none.reshape(0, 3, 2), 0.01)
    message = messages.drawing(drawn, 7, 'map')
    with pytest.raises(Refused, match="frame 'field', got 'map'"):
        surroundings_in(message, 'field')
    message.markers[1].points[2].x = math.nan
    with pytest.raises(Refused, match='finite'):
        surroundings_in(message, 'map')
    message.markers[1].points.pop(2)
    with pytest.raises(Refused, match='two ends'):
        surroundings_in(message, 'map')


def test_markers_show_walls() -> None:
    field = Field(fences=(((1.0, 2.0), (3.0, 4.0)),), discs=((5.0, 5.0, 0.5),))
    x = np.ones((1, 2))
    drawn = messages.marker_array(x, x, x[0], 0.5, 0, 'map', field.outline)
    (walls,) = [each for each in drawn.markers if each.ns == 'walls']
    ends = np.array([(p.x, p.y) for p in walls.points])
    assert ends[:2].tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert np.allclose(np.linalg.norm(ends[2:] - 5.0, axis=1), 0.5)
    assert np.array_equal(ends[3:-1:2], ends[4::2])  # a closed ring
