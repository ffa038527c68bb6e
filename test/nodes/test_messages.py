"""Messages carry what was put in, and nothing that must not move a dog gets out."""

from __future__ import annotations

import array
import math
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, Quaternion, Twist, TwistStamped, Vector3
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectory

from herding_ros.control.plan import Plan
from herding_ros.nodes import messages

coordinates = st.floats(-1e3, 1e3, width=32)
points = st.integers(1, 40).flatmap(lambda n: arrays(np.float64, (n, 2), elements=coordinates))


@given(points, st.integers(0, 2**31 * 10**9 - 1))
def test_sheep_come_out_as_they_went_in(x: np.ndarray, ns: int) -> None:
    data = messages.cloud(x, x[::-1], ns, 'map')
    out_ns, out_x, out_v = messages.sheep_in(data, 'map')
    assert out_ns == ns
    assert np.array_equal(out_x, x)
    assert np.array_equal(out_v, x[::-1])
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


def foreign_cloud(names: list[str], kind: str = '<f4', rows: int = 1) -> PointCloud2:
    """Two rows of sheep in a layout of somebody else's."""
    dtype = np.dtype([(name, kind) for name in names])
    data = np.zeros(3 * rows, dtype)
    for i, name in enumerate(names):
        data[name] = np.arange(3 * rows) + 10.0 * i
    assert dtype.fields is not None
    return PointCloud2(
        height=rows,
        width=3,
        is_bigendian=kind.startswith('>'),
        point_step=dtype.itemsize,
        row_step=3 * dtype.itemsize,
        fields=[
            PointField(
                name=name,
                offset=offset,
                datatype=PointField.FLOAT64 if field.itemsize == 8 else PointField.FLOAT32,
                count=1,
            )
            for name, (field, offset) in dtype.fields.items()
        ],
        data=array.array('B', data.tobytes()),
    )


@pytest.mark.parametrize('kind', ['<f4', '>f4', '<f8'])
def test_other_layouts_are_understood(kind: str) -> None:
    cloud = foreign_cloud(['vy', 'intensity', 'y', 'x', 'vx'], kind, rows=2)
    _, x, v = messages.sheep_in(serialize_message(cloud), '')
    assert np.array_equal(x, np.stack([np.arange(6) + 30.0, np.arange(6) + 20.0], axis=1))
    assert np.array_equal(v, np.stack([np.arange(6) + 40.0, np.arange(6) + 0.0], axis=1))


def truncated(cloud: PointCloud2) -> PointCloud2:
    cloud.data = cloud.data[:-1]
    return cloud


def beyond_step(cloud: PointCloud2) -> PointCloud2:
    cloud.fields[0].offset = cloud.point_step
    return cloud


def integer_cloud() -> PointCloud2:
    cloud = foreign_cloud(['x', 'y', 'vx', 'vy'])
    cloud.fields[2].datatype = PointField.INT32
    return cloud


def with_value(value: float) -> PointCloud2:
    data = messages.cloud(np.array([[0.0, value]]), np.zeros((1, 2)), 0, '')
    return deserialize_message(data, PointCloud2)


@pytest.mark.parametrize(
    ('cloud', 'complaint'),
    [
        (foreign_cloud(['x', 'y', 'vx']), 'vy'),
        (integer_cloud(), 'FLOAT32'),
        (truncated(foreign_cloud(['x', 'y', 'vx', 'vy'])), 'bytes'),
        (beyond_step(foreign_cloud(['x', 'y', 'vx', 'vy'])), 'itemsize'),
        (PointCloud2(fields=foreign_cloud(['x', 'y', 'vx', 'vy']).fields), 'empty'),
        (with_value(math.nan), 'NaN'),
        (with_value(math.inf), 'infinite'),
    ],
)
def test_bad_clouds_are_refused(cloud: PointCloud2, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        messages.sheep_in(serialize_message(cloud), '')


def test_wrong_frame_is_refused_and_named() -> None:
    cloud = messages.cloud(np.zeros((1, 2)), np.zeros((1, 2)), 0, 'odom')
    with pytest.raises(ValueError, match="'odom', allowed is 'map'"):
        messages.sheep_in(cloud, 'map')
    dog = messages.odometry(np.zeros(2), np.zeros(2), 1, 0, 'odom')
    for _ in range(2):
        with pytest.raises(ValueError, match="'odom', allowed is 'map'"):
            messages.dog_in(dog, 'map')
    command = messages.command(np.zeros(2), 0.0, 2, 0)
    with pytest.raises(ValueError, match='dog_2/base_link'):
        messages.command_in(command, 1, 'map')


@given(arrays(np.float64, (2, 2), elements=coordinates), st.floats(-3.1, 3.1), st.text())
def test_dog_and_heading_come_out_as_they_went_in(
    values: np.ndarray, heading: float, child: str
) -> None:
    """Also from others' robots, which fill in what we leave at zero."""
    data = messages.odometry(values[0], values[1], 3, 5, 'map')
    message = deserialize_message(data, Odometry)
    assert message.header == Header(stamp=Time(nanosec=5), frame_id='map')
    assert message.child_frame_id == 'dog_3/base_link'
    assert message.twist.twist.linear == Vector3(x=values[1, 0], y=values[1, 1])
    assert messages.dog_in(data, 'map')[2] == 0.0
    message.child_frame_id = child.replace('\0', '')
    message.pose.pose.orientation.z = math.sin(heading / 2)
    message.pose.pose.orientation.w = math.cos(heading / 2)
    message.pose.covariance = message.twist.covariance = values[0, 0] + np.arange(36.0)
    ns, position, out = messages.dog_in(serialize_message(message), 'map')
    assert ns == 5
    assert np.array_equal(position, values[0])
    assert out == pytest.approx(heading, abs=1e-12)


@pytest.mark.parametrize(
    'read',
    [
        lambda data: messages.dog_in(data, 'map'),
        lambda data: messages.command_in(data, 1, 'map'),
        lambda data: messages.sheep_in(data, 'map'),
        messages.twist_in,
    ],
)
@pytest.mark.parametrize('length', [0, 3, 4, 12, 100, 722])
def test_bytes_that_are_no_message_are_refused(read: Any, length: int) -> None:
    with pytest.raises(ValueError, match=r'no message|too few|NaN'):
        read((b'\0\1\0\0' + b'\xff' * length)[:length])


def test_message_with_bytes_left_over_is_refused() -> None:
    data = messages.odometry(np.zeros(2), np.zeros(2), 1, 0, 'map')
    with pytest.raises(ValueError, match='belong to nothing'):
        messages.dog_in(data + bytes(8), 'map')


def big_endian(data: bytes) -> bytes:
    """The Odometry of dog_1 in frame 'map' in the other byte order."""
    text = b''.join(
        len(word).to_bytes(4, 'big') + word for word in (b'map\0', b'dog_1/base_link\0')
    )
    stamp = np.frombuffer(data, '<u4', 2, 4).astype('>u4').tobytes()
    numbers = np.frombuffer(data, '<f8', 85, len(data) - 680).astype('>f8').tobytes()
    gap = bytes(-len(stamp + text) % 8)
    return bytes(4) + stamp + text + gap + numbers


def test_other_byte_order_is_understood() -> None:
    d = np.array([0.25, -3.0])
    data = messages.odometry(d, np.zeros(2), 1, 4_000_000_007, 'map')
    ns, position, heading = messages.dog_in(big_endian(data), 'map')
    assert (ns, heading) == (4_000_000_007, 0.0)
    assert np.array_equal(position, d)


def test_command_is_in_the_body_frame() -> None:
    """A dog that looks along +y and shall run along +x of the map has to run to its right."""
    data = messages.command(np.array([0.03, 0.0]), math.pi / 2, 1, 7)
    message = deserialize_message(data, TwistStamped)
    assert message.twist.linear.x == pytest.approx(0.0, abs=1e-17)
    assert message.twist.linear.y == pytest.approx(-0.03)
    assert message.header.frame_id == 'dog_1/base_link'
    assert message.header.stamp == Time(nanosec=7)


@given(arrays(np.float64, (2,), elements=coordinates))
def test_command_to_an_aligned_dog_keeps_every_bit(u: np.ndarray) -> None:
    ns, velocity = messages.command_in(messages.command(u, 0.0, 1, 8), 1, 'map')
    assert ns == 8
    assert np.array_equal(velocity, u)
    assert np.array_equal(messages.twist_in(serialize_message(messages.twist(u, 0.0))), u)


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_bad_commands_and_goals_are_refused(bad: float) -> None:
    with pytest.raises(ValueError, match='NaN or infinite'):
        messages.twist_in(serialize_message(Twist(linear=Vector3(x=bad))))
    command = TwistStamped(twist=Twist(linear=Vector3(y=bad)))
    with pytest.raises(ValueError, match='NaN or infinite'):
        messages.command_in(serialize_message(command), 1, '')
    for field in ('position', 'orientation'):
        odometry = Odometry()
        getattr(odometry.pose.pose, field).y = bad
        with pytest.raises(ValueError, match='NaN or infinite'):
            messages.dog_in(serialize_message(odometry), '')
    goal = PoseStamped()
    goal.pose.position.y = bad
    with pytest.raises(ValueError, match='NaN or infinite'):
        messages.goal_in(goal, '')


def test_plan_says_when_and_where() -> None:
    u = np.arange(12.0).reshape(3, 2, 2)
    data = messages.trajectory(Plan(4.0, 0.4, u), u + 100.0, 4_000_000_000, 'map')
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


def test_path_is_stamped_along_the_way() -> None:
    message = messages.path(np.array([[0.0, 1.0], [2.0, 3.0]]), 1.5, 10**9, 'map')
    stamps = [messages.nanoseconds(pose.header.stamp) for pose in message.poses]
    assert stamps == [10**9, 2_500_000_000]
    assert message.poses[1].pose.position.y == 3.0


def test_markers_show_sheep_dogs_and_goal() -> None:
    x, d = np.array([[1.0, 2.0]]), np.array([[3.0, 4.0], [5.0, 6.0]])
    shown = {m.ns: m for m in messages.markers(x, d, np.array([7.0, 8.0]), 0, 'map').markers}
    assert [(p.x, p.y) for p in shown['sheep'].points] == [(1.0, 2.0)]
    assert len(shown['dogs'].points) == 6
    triangle = np.array([(p.x, p.y) for p in shown['dogs'].points[3:]])
    assert np.allclose(triangle.mean(axis=0), (5.0, 6.0), atol=0.01)
    cross = np.array([(p.x, p.y) for p in shown['goal'].points])
    assert np.allclose(cross.mean(axis=0), (7.0, 8.0))
