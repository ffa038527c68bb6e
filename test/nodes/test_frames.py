# SPDX-License-Identifier: Apache-2.0
"""Messages in other frames, with a stand-in for the buffer of tf2."""

from __future__ import annotations

from collections.abc import Callable
import math
import sys
from types import SimpleNamespace
from typing import Any

from geometry_msgs.msg import PoseStamped, TransformStamped
from herding_ros.checks import Refused
from herding_ros.control.parameters import Control
from herding_ros.nodes import messages, observations
from herding_ros.nodes.maps import MAP
from herding_ros.nodes.messages import Frames, LATEST, NoTransformError, Placement
from herding_ros.nodes.observations import Observations
from herding_ros.nodes.occupancy import walls_of
from herding_ros.nodes.refusals import Refusals
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from rclpy.clock import ClockType, ROSClock
from rclpy.serialization import serialize_message
from rclpy.time import Time
from scipy.spatial.transform import Rotation
from test_maps import a_map, an_obstacle, Live, Log, TRIANGLE, WALL


class TransformError(Exception):
    """As tf2's exceptions, which have nothing but a base of their own in common."""


class Buffer:
    """As tf2_ros.Buffer, with transforms that come by hand."""

    def __init__(self) -> None:
        self.known: dict[tuple[str, str], tuple[TransformStamped, int]] = {}
        self.asked: list[tuple[str, str, int]] = []

    def learn(self, source: str, transform: TransformStamped, newest: int = 2**62) -> None:
        """From `source` into map, up to a stamp."""
        self.known['map', source] = transform, newest

    def clear(self) -> None:
        self.known.clear()

    def lookup_transform(self, target: str, source: str, time: Time) -> TransformStamped:
        self.asked.append((target, source, time.nanoseconds))
        transform, newest = self.known.get((target, source), (None, 0))
        if transform is None:
            raise TransformError(f'"{source}" passed to lookupTransform does not exist')
        if time.nanoseconds > newest:
            raise TransformError('Lookup would require extrapolation into the future')
        return transform


def transform(x: float, y: float, yaw: float, tilt: float = 0.0) -> TransformStamped:
    message = TransformStamped()
    message.transform.translation.x, message.transform.translation.y = x, y
    message.transform.translation.z = math.nan  # not read
    turn = message.transform.rotation
    turn.x, turn.y, turn.z, turn.w = Rotation.from_euler('zx', [yaw, tilt]).as_quat()
    return message


places = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-math.pi, math.pi))


@given(places)
def test_points_vectors_and_headings_turn_as_in_space(place: tuple[float, float, float]) -> None:
    placement = Placement.of(transform(*place))
    turn = Rotation.from_euler('z', place[2])
    flat = np.random.default_rng(0).uniform(-5.0, 5.0, (4, 2))
    turned = turn.apply(np.pad(flat, ((0, 0), (0, 1))))[:, :2]
    np.testing.assert_allclose(placement.vectors(flat), turned, atol=1e-12)
    np.testing.assert_allclose(placement.points(flat), turned + place[:2], atol=1e-12)
    nose = turn.apply([math.cos(0.3), math.sin(0.3), 0.0])
    heading = placement.heading(0.3)
    assert abs(heading) <= math.pi
    np.testing.assert_allclose([math.cos(heading), math.sin(heading)], nose[:2], atol=1e-12)


def test_transforms_that_are_none_are_refused() -> None:
    for bad, kind in [
        (transform(math.nan, 0.0, 0.0), 'not finite'),
        (transform(1e9, 0.0, 0.0), 'too large'),
        (transform(0.0, 0.0, 0.0, tilt=0.1), 'not a rotation'),
        (TransformStamped(), ''),
    ]:
        if not kind:
            bad.transform.rotation.w, kind = 0.0, 'not a rotation'
        with pytest.raises(Refused) as refused:
            Placement.of(bad)
        assert refused.value.kind == kind


def frames_with(buffer: Buffer) -> Frames:
    return Frames('map', buffer, TransformError)


def in_frame(data: bytes, frame: str) -> bytes:
    """Our messages are in frame map; this is the same in another one with a name as long."""
    assert len(frame) == len('map')
    assert data.count(b'map\0') == 1
    return data.replace(b'map\0', frame.encode() + b'\0')


@given(places, st.integers(0, 2**62))
def test_what_is_in_another_frame_is_as_if_it_were_in_ours(
    place: tuple[float, float, float], ns: int
) -> None:
    """Everything is written twice: in map, and as seen from odo, by an inverse of our own."""
    buffer = Buffer()
    buffer.learn('odo', transform(*place))
    frames, c, s = frames_with(buffer), math.cos(place[2]), math.sin(place[2])
    inverse = np.array([[c, s], [-s, c]])
    rng = np.random.default_rng(1)
    x, v = rng.uniform(-2.0, 2.0, (2, 5, 2))
    there = (x - place[:2]) @ inverse.T
    close: dict[str, Any] = {'rtol': 0, 'atol': 1e-3}  # single precision, up to 1.4 km away

    data = in_frame(messages.cloud(there, v @ inverse.T, ns, 'map'), 'odo')
    sheep = messages.sheep_in(data, 'map', 10, frames=frames)
    np.testing.assert_allclose(sheep.x, x, **close)
    np.testing.assert_allclose(sheep.v, v, **close)
    stamp = min(ns, 2**31 * 10**9 - 1)
    assert buffer.asked == [('map', 'odo', stamp)]
    assert sheep.ns == stamp

    data = in_frame(messages.odometry(there[0], v[0] @ inverse.T, 1, ns, 'map', 0.4), 'odo')
    at, position, heading, velocity = messages.dog_in(data, 'map', frames)
    assert at == stamp
    np.testing.assert_allclose(position, x[0], atol=1e-9)
    np.testing.assert_allclose(velocity, v[0], atol=1e-9)
    assert math.remainder(heading - 0.4 - place[2], math.tau) == pytest.approx(0.0, abs=1e-9)

    goal = messages.pose(there[1], ns, 'odo')
    goal_here = messages.goal_in(serialize_message(goal), 'map', frames)
    np.testing.assert_allclose(goal_here, x[1], atol=1e-9)
    corners = messages.outline_in(
        serialize_message(an_obstacle(*there[:3].tolist(), frame='odo')), 'map', frames
    )
    np.testing.assert_allclose(corners, x[:3], **close)
    assert buffer.asked[-2:] == [('map', 'odo', LATEST)] * 2


def test_a_map_in_another_frame_has_its_walls_in_ours() -> None:
    buffer = Buffer()
    buffer.learn('odo', transform(1.0, -2.0, 0.7))
    data = serialize_message(a_map(WALL, frame='odo'))
    walls = walls_of(messages.grid_in(data, 'map', frames_with(buffer)))
    there = walls_of(messages.grid_in(serialize_message(a_map(WALL)), 'map'))
    expected = Placement(1.0, -2.0, 0.7).points(np.array(there.obstacles[0]))
    np.testing.assert_allclose(walls.obstacles[0], expected, atol=1e-9)
    assert buffer.asked == [('map', 'odo', LATEST)]


def test_our_own_frame_needs_no_transform_and_an_unknown_one_is_named() -> None:
    buffer = Buffer()
    frames = frames_with(buffer)
    data = messages.cloud(np.ones((1, 2)), np.ones((1, 2)), 7, 'map')
    assert messages.sheep_in(data, 'map', 10, frames=frames).ns == 7
    assert not buffer.asked
    with pytest.raises(NoTransformError, match='with a transform to it') as no:
        messages.sheep_in(in_frame(data, 'odo'), 'map', 10, frames=frames)
    assert (no.value.kind, no.value.cause) == ('no transform', 'odo')
    with pytest.raises(NoTransformError):
        messages.goal_in(serialize_message(PoseStamped()), 'map', frames)


@pytest.fixture
def listeners(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Buffer, Any]]:
    """Buffers and nodes of those that listen to tf."""
    found: list[tuple[Buffer, Any]] = []

    def listen(buffer: Buffer, node: Any) -> object:
        found.append((buffer, node))
        buffer.learn('odo', transform(1.0, 2.0, 0.0))
        return object()

    module = SimpleNamespace(
        Buffer=Buffer, TransformListener=listen, TransformException=TransformError
    )
    monkeypatch.setitem(sys.modules, 'tf2_ros', module)
    return found


def test_tf_is_listened_to_where_it_can_be_imported(
    listeners: list[tuple[Buffer, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    node: Any = SimpleNamespace(get_clock=ROSClock)
    frames = Frames.of(node, 'map')
    assert frames is not None
    assert listeners[0][1] is node
    assert frames.placement('sheep', 'odo', 3) == Placement(1.0, 2.0, 0.0)
    with pytest.raises(NoTransformError):
        frames.placement('sheep', 'base', 3)
    monkeypatch.setitem(sys.modules, 'tf2_ros', None)
    assert Frames.of(node, 'map') is None


def test_transforms_of_a_former_run_are_forgotten_when_time_goes_back(
    listeners: list[tuple[Buffer, Any]],
) -> None:
    """Or tf2 would take none for being older than those, and the last of them would count."""
    clock = ROSClock()
    clock._set_ros_time_is_active(True)
    node: Any = SimpleNamespace(get_clock=lambda: clock)
    frames = Frames.of(node, 'map')
    assert frames is not None
    for seconds in (0, 1, 100):
        clock.set_ros_time_override(Time(seconds=seconds, clock_type=ClockType.ROS_TIME))
        assert frames.placement('sheep', 'odo', LATEST) == Placement(1.0, 2.0, 0.0)
    clock.set_ros_time_override(Time(seconds=0, clock_type=ClockType.ROS_TIME))
    with pytest.raises(NoTransformError):
        frames.placement('sheep', 'odo', LATEST)
    listeners[0][0].learn('odo', transform(3.0, 4.0, 0.0))
    assert frames.placement('sheep', 'odo', LATEST) == Placement(3.0, 4.0, 0.0)


class Box:
    """In place of an `Inbox`."""

    boxes: dict[str, Box]

    def __init__(self, node: Any, kind: Any, topic: str, *_: Any, **__: Any) -> None:
        self.data: list[bytes] = []
        node.boxes[topic] = self

    def take(self) -> list[tuple[bytes, dict[str, int]]]:
        taken, self.data = self.data, []
        return [(data, {}) for data in taken]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Sets the wall time that observations go by."""
    now = [0.0]
    monkeypatch.setattr(observations, 'time', SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(observations, 'Inbox', Box)
    return lambda t: now.__setitem__(0, t)


def test_observations_wait_for_their_transform_and_are_refused_when_it_does_not_come(
    clock: Callable[[float], None],
) -> None:
    buffer, node, log = Buffer(), SimpleNamespace(boxes={}), Log()
    refused = Refusals(log)  # type: ignore[arg-type]
    seen = Observations(node, 1, 'map', 10, 0.5, Control(), refused, frames_with(buffer))  # type: ignore[arg-type]

    def show(ns: int) -> None:
        x = np.full((1, 2), ns * 1e-9)
        node.boxes['sheep'].data.append(in_frame(messages.cloud(x, 0.0 * x, ns, 'map'), 'odo'))
        node.boxes['dog_1/odom'].data.append(messages.odometry(x[0], x[0], 1, ns, 'map'))

    tenth = 100_000_000
    buffer.learn('odo', transform(5.0, 0.0, 0.0), newest=10 * tenth)
    show(10 * tenth)
    first = seen.recent(10 * tenth)
    assert first is not None
    assert first.state.x[0, 0] == pytest.approx(6.0)
    show(11 * tenth)  # its transform comes a period later, and meanwhile the last one counts
    clock(0.1)
    last = seen.recent(11 * tenth)
    assert last is not None
    assert last.stamp == 10 * tenth
    assert not refused.counts
    buffer.learn('odo', transform(5.0, 0.0, 0.0), newest=11 * tenth)
    clock(0.2)
    show(12 * tenth)
    newest = seen.recent(12 * tenth)
    assert newest is not None
    assert newest.stamp == 11 * tenth
    assert newest.state.x[0, 0] == pytest.approx(6.1, abs=1e-6)
    clock(0.69)
    seen.recent(13 * tenth)
    assert not refused.counts
    clock(0.71)
    seen.recent(14 * tenth)
    assert refused.counts == {'sheep: no transform': 1}
    assert 'extrapolation' in log.lines[0]
    clock(5.0)
    seen.recent(15 * tenth)
    assert refused.counts == {'sheep: no transform': 1}
    show(16 * tenth)
    seen.recent(16 * tenth)
    seen.recent(0)  # a reset: what waited is of the former run
    clock(6.0)
    seen.recent(10 * tenth)
    assert refused.counts == {'sheep: no transform': 1}


def test_a_map_waits_for_its_transform_and_that_is_said_once() -> None:
    """Nothing else is refused meanwhile, and what is in our frame does not wait."""
    buffer = Buffer()
    live = Live(frames=frames_with(buffer))
    live.show(MAP, a_map(WALL, frame='odo'))
    live.show(MAP, a_map(np.zeros((2, 2)), frame='odo'))
    live.show(MAP, a_map(WALL, frame='odo'))
    live.show('field/obstacle', an_obstacle(*TRIANGLE))
    assert [len(field.obstacles) for field in live.fields] == [1]
    (waits,) = [line for line in live.log.lines if 'waits for its transform' in line]
    assert "got 'odo'" in waits
    live.look_again()
    assert len(live.fields) == 1
    buffer.learn('odo', transform(1.0, 2.0, 0.3))
    live.look_again()
    assert len(live.fields) == 2
    assert not live.timers
    assert not live.refused.counts
    wall = walls_of(messages.grid_in(serialize_message(a_map(WALL)), 'map')).obstacles[0]
    placed = Placement(1.0, 2.0, 0.3).points(np.array(wall))
    np.testing.assert_allclose(live.fields[-1].obstacles[0], placed, atol=1e-9)


def test_a_map_that_waits_is_forgotten_when_a_newer_one_is_taken() -> None:
    buffer = Buffer()
    live = Live(frames=frames_with(buffer))
    live.show(MAP, a_map(WALL, frame='odo'))
    live.show(MAP, a_map(WALL[::-1]))
    newest = live.fields[-1]
    buffer.learn('odo', transform(1.0, 2.0, 0.3))
    live.look_again()
    assert live.fields == [newest]
    assert not live.timers


def test_frames_without_end_fill_neither_log_nor_memory() -> None:
    live = Live(frames=frames_with(Buffer()))
    for k in range(300):
        live.show(MAP, a_map(WALL, frame=f'odo_{k}'))
    assert 0 < len(live.log.lines) <= 100
    assert len(live.maps._said) <= 100
