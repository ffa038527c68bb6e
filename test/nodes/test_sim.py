"""The sim as a process, with the test in the controller's place: real DDS between them."""

from __future__ import annotations

from collections.abc import Callable
import math
import signal
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from herding_ros.model.parameters import Crowd
from herding_ros.model.simulation import Simulation, World
from herding_ros.nodes import messages


def flock(cloud: PointCloud2) -> tuple[np.ndarray, np.ndarray]:
    _, x, v = messages.sheep_in(serialize_message(cloud), 'map')
    return x, v


def place(dog: Odometry) -> np.ndarray:
    return messages.dog_in(serialize_message(dog), 'map')[1]


class Shepherd:
    """Hears what the sim publishes and commands its dogs."""

    def __init__(self, peer: Any, dogs: int = 1) -> None:
        self.peer = peer
        self.sheep = peer.listen(PointCloud2, 'sheep')
        self.truth = peer.listen(PointCloud2, 'truth/sheep')
        self.odometry = [peer.listen(Odometry, f'dog_{m + 1}/odom') for m in range(dogs)]
        self.true_odometry = [
            peer.listen(Odometry, f'truth/dog_{m + 1}/odom') for m in range(dogs)
        ]
        self.clock = peer.listen(Clock, '/clock')
        self.diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
        self.publishers = [peer.talk_to(TwistStamped, f'dog_{m + 1}/cmd_vel') for m in range(dogs)]

    def command(self, u: Any, ns: int, m: int = 0, frame: str = 'dog_1/base_link') -> None:
        header = Header(stamp=messages.stamp_of(ns), frame_id=frame)
        message = TwistStamped(header=header, twist=messages.twist(np.array(u), 0.0))
        self.publishers[m].publish(message)

    def answer(self, u: Any) -> int:
        """Answer the newest state, wait for the next and return its stamp."""
        ns = self.newest()
        seen = len(self.truth)
        for m in range(len(self.publishers)):
            self.command(u, ns, m, messages.dog_frame(m + 1))
        self.peer.spin_until(lambda: len(self.truth) > seen)
        return self.newest()

    def newest(self) -> int:
        self.peer.spin_until(lambda: self.truth and self.true_odometry[-1])
        return messages.nanoseconds(self.truth[-1].header.stamp)

    def true_dog(self, m: int = 0) -> np.ndarray:
        ns = self.newest()
        mine = self.true_odometry[m]
        self.peer.spin_until(lambda: messages.nanoseconds(mine[-1].header.stamp) >= ns)
        return place(mine[-1])

    def refusals(self) -> dict[str, int]:
        status = self.diagnostics[-1].status[0] if self.diagnostics else None
        pairs = {pair.key: pair.value for pair in status.values} if status else {}
        return {k[8:]: int(v) for k, v in pairs.items() if k.startswith('refused ')}


SMALL = {'sheep': 3, 'dogs': 1, 'seed': 5}


def test_lockstep_is_the_simulation_of_the_core(start: Callable[..., Any], peer: Any) -> None:
    start('sim', lockstep=True, **{**SMALL, 'dogs': 2})
    shepherd = Shepherd(peer, dogs=2)
    expected = Simulation(Crowd(), World(sheep=3, dogs=2, seed=5), np.array([0.5, 0.5]))
    u = np.array([0.02, -0.01])
    for k in range(6):
        seen = expected.observe()
        peer.spin_until(
            lambda k=k: (
                min(len(heard) for heard in (shepherd.sheep, *shepherd.odometry)) > k  # type: ignore[misc]
            )
        )
        x, v = flock(shepherd.sheep[k])
        assert np.array_equal(x, seen.state.x)
        assert np.array_equal(v, seen.state.v)
        for m, heard in enumerate(shepherd.odometry):
            assert np.array_equal(place(heard[k]), seen.state.d[m])
        assert messages.nanoseconds(shepherd.sheep[k].header.stamp) == k * 100_000_000
        shepherd.answer(u)
        expected.advance(np.array([u, u]))


def test_subscriber_that_asks_too_much_holds_up_nobody(
    start: Callable[..., Any], peer: Any
) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    heard = peer.listen(PointCloud2, 'sheep', latched)
    start('sim', lockstep=True, **SMALL)
    shepherd = Shepherd(peer)
    assert shepherd.answer([0.01, 0.0]) == 100_000_000
    assert not heard


def test_listening_to_the_time_is_not_recording_it(start: Callable[..., Any], peer: Any) -> None:
    """With use_sim_time a node hears /clock before it records anything."""
    start('sim', wait_for='peer', **SMALL)
    sheep = peer.listen(PointCloud2, 'sheep')
    for kind, topic in [
        (PointCloud2, 'truth/sheep'),
        (Odometry, 'dog_1/odom'),
        (Odometry, 'truth/dog_1/odom'),
        (MarkerArray, 'markers'),
        (DiagnosticArray, '/diagnostics'),
    ]:
        peer.listen(kind, topic)
    peer.listen(Clock, '/clock', QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    peer.talk_to(TwistStamped, 'dog_1/cmd_vel')
    peer.spin_for(1.0)
    assert not sheep
    peer.listen(Clock, '/clock')
    peer.spin_until(lambda: sheep)


def test_lockstep_waits_for_every_dog_and_for_the_right_stamp(
    start: Callable[..., Any], peer: Any
) -> None:
    start('sim', lockstep=True, **{**SMALL, 'dogs': 2})
    shepherd = Shepherd(peer, dogs=2)
    assert shepherd.newest() == 0
    shepherd.command([0.01, 0.0], 0, 0)
    shepherd.command([0.01, 0.0], 100_000_000, 1, 'dog_2/base_link')
    peer.spin_for(0.5)
    assert shepherd.newest() == 0
    shepherd.command([0.01, 0.0], 0, 1, 'dog_2/base_link')
    peer.spin_until(lambda: shepherd.newest() == 100_000_000)


def test_no_dog_is_faster_than_the_limit(start: Callable[..., Any], peer: Any) -> None:
    start('sim', lockstep=True, max_speed=0.04, **SMALL)
    shepherd = Shepherd(peer)
    before = shepherd.true_dog()
    shepherd.answer([3.0, 4.0])
    assert shepherd.true_dog() - before == pytest.approx(0.1 * 0.04 * np.array([0.6, 0.8]))


@pytest.mark.parametrize(
    ('u', 'frame'),
    [([math.nan, 0.0], 'dog_1/base_link'), ([math.inf, 0.0], 'map'), ([0.01, 0.0], 'odom')],
)
def test_bad_commands_move_nothing_and_are_counted(
    start: Callable[..., Any], peer: Any, u: Any, frame: str
) -> None:
    process = start('sim', lockstep=True, **SMALL)
    shepherd = Shepherd(peer)
    shepherd.newest()
    for _ in range(3):
        shepherd.command(u, 0, frame=frame)
    peer.spin_until(lambda: shepherd.refusals() == {'dog_1/cmd_vel': 3})
    assert shepherd.newest() == 0
    assert process.log.count('refused') == 1
    assert shepherd.answer([0.01, 0.0]) == 100_000_000


def test_silent_dog_stops(start: Callable[..., Any], peer: Any) -> None:
    """Ordered once, a dog runs until the timeout and no further."""
    start('sim', command_timeout=0.3, real_time_factor=5.0, **SMALL)
    shepherd = Shepherd(peer)
    first = shepherd.true_dog()
    shepherd.command([0.05, 0.0], 0)
    peer.spin_until(lambda: shepherd.true_dog()[0] > first[0])
    begun = shepherd.newest()
    peer.spin_until(lambda: shepherd.newest() > begun + 2_000_000_000)
    resting = shepherd.true_dog()
    peer.spin_until(lambda: shepherd.newest() > begun + 4_000_000_000)
    assert np.array_equal(shepherd.true_dog(), resting)
    # Played in whole periods of 0.1 s: 0.3 s, and one more when the order came late in one.
    assert 0.05 * 0.29 <= (resting - first)[0] <= 0.05 * 0.51


def test_reset_starts_the_same_run_again(start: Callable[..., Any], peer: Any) -> None:
    start('sim', lockstep=True, **SMALL)
    shepherd = Shepherd(peer)
    runs = []
    for _ in range(2):
        peer.spin_until(lambda: shepherd.truth and shepherd.newest() == 0)
        first = len(shepherd.truth) - 1
        for _ in range(3):
            shepherd.answer([0.03, 0.0])
        runs.append([bytes(message.data) for message in shepherd.truth[first:]])
        assert peer.call(Trigger, 'sim/reset', Trigger.Request()).success
    assert len(runs[0]) == 4
    assert runs[0] == runs[1]


def test_pause_holds_the_world(start: Callable[..., Any], peer: Any) -> None:
    start('sim', real_time_factor=5.0, **SMALL)
    shepherd = Shepherd(peer)
    peer.spin_until(lambda: shepherd.newest() > 0)
    assert peer.call(SetBool, 'sim/pause', SetBool.Request(data=True)).success
    peer.spin_for(0.2)
    held = len(shepherd.truth)
    peer.spin_for(0.5)
    assert len(shepherd.truth) == held
    peer.call(SetBool, 'sim/pause', SetBool.Request(data=False))
    peer.spin_until(lambda: len(shepherd.truth) > held + 2)
    stamps = [messages.nanoseconds(message.header.stamp) for message in shepherd.truth]
    assert set(np.diff(stamps)) == {100_000_000}


def test_real_time_keeps_the_wall_clocks_pace(start: Callable[..., Any], peer: Any) -> None:
    start('sim', real_time_factor=4.0, **SMALL)
    shepherd = Shepherd(peer)
    shepherd.newest()
    begun, t0 = peer.node.get_clock().now().nanoseconds, shepherd.newest()
    peer.spin_until(lambda: shepherd.newest() >= t0 + 8_000_000_000)
    wall = peer.node.get_clock().now().nanoseconds - begun
    assert (shepherd.newest() - t0) / wall == pytest.approx(4.0, rel=0.15)
    assert len(shepherd.clock) >= 80


def test_sensors_are_as_noisy_as_told(start: Callable[..., Any], peer: Any) -> None:
    """Four standard errors of a standard deviation over 400 sheep and two coordinates: 10 %."""
    start('sim', lockstep=True, sheep=400, dogs=1, position_noise=0.02, velocity_noise=0.03)
    shepherd = Shepherd(peer)
    shepherd.newest()
    peer.spin_until(lambda: shepherd.sheep)
    seen_x, seen_v = flock(shepherd.sheep[0])
    true_x, true_v = flock(shepherd.truth[0])
    assert np.std(seen_x - true_x) == pytest.approx(0.02, rel=0.1)
    assert np.std(seen_v - true_v) == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize(
    ('parameters', 'complaint'),
    [
        ({'sheep': 0}, 'sheep'),
        ({'crowd__noise': -1.0}, 'crowd.noise'),
        ({'dt': 'nan'}, 'dt'),
        ({'crowd__preset': 'lions'}, 'cohesive or printed'),
        ({'goal': '[1.0]'}, '2 numbers'),
        ({'lockstep': True, 'stamped': False}, 'lockstep needs stamped'),
    ],
)
def test_impossible_parameters_are_refused_with_a_reason(
    start: Callable[..., Any], parameters: dict[str, Any], complaint: str
) -> None:
    process = start('sim', **parameters)
    assert process.wait() == 2
    assert complaint in process.log
    assert 'Traceback' not in process.log


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_ends_cleanly_at_a_signal(start: Callable[..., Any], peer: Any, number: int) -> None:
    process = start('sim', **SMALL)
    Shepherd(peer).newest()
    assert process.end(number) == 0
    assert 'Traceback' not in process.log
