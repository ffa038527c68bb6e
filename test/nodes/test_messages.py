"""Messages carry what was put in, and nothing that must not move a dog gets out."""

from __future__ import annotations

import array
import math
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, Twist, Vector3
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField

from herding_ros.control.plan import Plan
from herding_ros.nodes import messages

coordinates = st.floats(-1e3, 1e3, width=32)
points = st.integers(1, 40).flatmap(lambda n: arrays(np.float64, (n, 2), elements=coordinates))


def over_the_wire(message: Any) -> Any:
    return deserialize_message(serialize_message(message), type(message))


@given(points, st.integers(0, 2**31 * 10**9 - 1))
def test_sheep_come_out_as_they_went_in(x: np.ndarray, ns: int) -> None:
    message = over_the_wire(messages.cloud(x, x[::-1], ns, 'map'))
    out_x, out_v = messages.sheep_in(message, 'map')
    assert np.array_equal(out_x, x)
    assert np.array_equal(out_v, x[::-1])
    assert messages.nanoseconds(message.header.stamp) == ns
    assert (message.width, message.height, message.is_dense) == (len(x), 1, True)


def test_cloud_is_what_rviz_expects() -> None:
    message = messages.cloud(np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]]), 0, 'map')
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
    x, v = messages.sheep_in(cloud, '')
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
    return messages.cloud(np.array([[0.0, value]]), np.zeros((1, 2)), 0, '')


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
        messages.sheep_in(cloud, '')


def test_wrong_frame_is_refused_and_named() -> None:
    cloud = messages.cloud(np.zeros((1, 2)), np.zeros((1, 2)), 0, 'odom')
    with pytest.raises(ValueError, match="'odom', allowed is 'map'"):
        messages.sheep_in(cloud, 'map')


@given(arrays(np.float64, (2, 2), elements=coordinates), st.floats(-3.1, 3.1))
def test_dog_and_heading_come_out_as_they_went_in(values: np.ndarray, heading: float) -> None:
    message = over_the_wire(messages.odometry(values[0], values[1], 3, 5, 'map'))
    message.pose.pose.orientation.z = math.sin(heading / 2)
    message.pose.pose.orientation.w = math.cos(heading / 2)
    position, out = messages.dog_in(message, 'map')
    assert np.array_equal(position, values[0])
    assert out == pytest.approx(heading, abs=1e-12)
    assert message.child_frame_id == 'dog_3/base_link'
    assert message.twist.twist.linear == Vector3(x=values[1, 0], y=values[1, 1])


def test_command_is_in_the_body_frame() -> None:
    """A dog that looks along +y and shall run along +x of the map has to run to its right."""
    message = messages.command(np.array([0.03, 0.0]), math.pi / 2, 1, 7)
    assert message.twist.linear.x == pytest.approx(0.0, abs=1e-17)
    assert message.twist.linear.y == pytest.approx(-0.03)
    assert message.header.frame_id == 'dog_1/base_link'
    assert message.header.stamp == Time(nanosec=7)


@given(arrays(np.float64, (2,), elements=coordinates))
def test_command_to_an_aligned_dog_keeps_every_bit(u: np.ndarray) -> None:
    assert np.array_equal(messages.velocity_in(messages.command(u, 0.0, 1, 0).twist), u)


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_bad_commands_and_goals_are_refused(bad: float) -> None:
    with pytest.raises(ValueError, match='NaN or infinite'):
        messages.velocity_in(Twist(linear=Vector3(x=bad)))
    goal = PoseStamped()
    goal.pose.position.y = bad
    with pytest.raises(ValueError, match='NaN or infinite'):
        messages.goal_in(goal, '')


def test_plan_says_when_and_where() -> None:
    u = np.arange(12.0).reshape(3, 2, 2)
    message = messages.trajectory(Plan(4.0, 0.4, u), u + 100.0, 4_000_000_000, 'map')
    assert message.joint_names == ['dog_1', 'dog_2']
    starts = [p.time_from_start.sec * 10**9 + p.time_from_start.nanosec for p in message.points]
    assert starts == [0, 400_000_000, 800_000_000]
    second = message.points[2]
    assert (second.velocities[1].linear.x, second.velocities[1].linear.y) == (10.0, 11.0)
    assert second.transforms[1].translation.x == 110.0
    assert second.transforms[1].rotation.w == 1.0


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
