# SPDX-License-Identifier: Apache-2.0
"""The sim as a process, with the test in the controller's place: real DDS between them."""

from __future__ import annotations

from collections.abc import Callable
import math
from pathlib import Path
import signal
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from herding_ros.model.crowd import Crowd
from herding_ros.model.motion import Unicycle
from herding_ros.model.simulation import Simulation, World
from herding_ros.nodes import messages
from herding_ros.nodes.pacing import CATCH_UP
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray


def flock(cloud: PointCloud2) -> tuple[np.ndarray, np.ndarray]:
    sheep = messages.sheep_in(serialize_message(cloud), 'map', most=1000)
    return sheep.x, sheep.v


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

    def values(self) -> dict[str, str]:
        """Those of the newest status."""
        status = self.diagnostics[-1].status[0] if self.diagnostics else None
        return {pair.key: pair.value for pair in status.values} if status else {}

    def refusals(self) -> dict[str, int]:
        return {k[8:]: int(v) for k, v in self.values().items() if k.startswith('refused ')}


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


def test_a_dog_that_has_to_turn_is_driven_by_speed_and_turn_rate(
    start: Callable[..., Any], peer: Any
) -> None:
    """A command to go aside turns it, as in the simulation of the core."""
    start('sim', lockstep=True, **SMALL, **{'motion.kind': 'unicycle'})
    shepherd, motion = Shepherd(peer), Unicycle()
    expected = Simulation(Crowd(), World(sheep=3, dogs=1, seed=5, motion=motion), np.ones(2) / 2)
    aside, u = expected.state.d[0, 2] + 1.5, np.zeros(2)
    for _ in range(5):
        u = 0.05 * np.array([np.cos(aside), np.sin(aside)])
        told = messages.twist(u, expected.state.d[0, 2], motion.ahead)
        ns, seen = shepherd.newest(), len(shepherd.truth)
        header = Header(stamp=messages.stamp_of(ns), frame_id='dog_1/base_link')
        shepherd.publishers[0].publish(TwistStamped(header=header, twist=told))
        peer.spin_until(lambda seen=seen: len(shepherd.truth) > seen)
        expected.advance(u[None])
        np.testing.assert_allclose(shepherd.true_dog(), expected.state.d[0, :2], atol=1e-12)
        pose = shepherd.true_odometry[0][-1].pose.pose.orientation
        heading = 2.0 * np.arctan2(pose.z, pose.w)
        assert np.cos(heading - expected.state.d[0, 2]) == pytest.approx(1.0, abs=1e-12)
    assert expected.state.d[0, 2] > aside - 1.4


def test_subscriber_that_asks_too_much_holds_up_nobody(
    start: Callable[..., Any], peer: Any
) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    heard = peer.listen(PointCloud2, 'sheep', latched)
    other = peer.listen(Twist, 'markers')
    process = start('sim', lockstep=True, **SMALL)
    shepherd = Shepherd(peer)
    assert shepherd.answer([0.01, 0.0]) == 100_000_000
    assert not heard
    assert not other
    said = {'not matched: /sheep to /peer', 'not matched: /markers to /peer'}
    peer.spin_until(lambda: said <= shepherd.values().keys())
    assert shepherd.diagnostics[-1].status[0].level == DiagnosticStatus.WARN
    for line in said:
        assert line.removeprefix('not matched: ') in process.log


def test_listening_to_the_time_is_not_recording_it(start: Callable[..., Any], peer: Any) -> None:
    """With use_sim_time a node hears /clock before it records anything."""
    start('sim', wait_for='peer', **SMALL)
    sheep = peer.listen(PointCloud2, 'sheep')
    for kind, topic in [
        (PointCloud2, 'truth/sheep'),
        (PointCloud2, 'dogs'),
        (PointCloud2, 'truth/dogs'),
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
    shepherd.command([3.0, 4.0], 0)
    peer.spin_until(lambda: shepherd.refusals() == {'dog_1/cmd_vel: too fast': 1})
    assert shepherd.newest() == 0
    shepherd.answer([0.024, 0.032])
    assert shepherd.true_dog() - before == pytest.approx(0.1 * np.array([0.024, 0.032]))


def test_bad_commands_move_nothing_and_are_counted(start: Callable[..., Any], peer: Any) -> None:
    process = start('sim', lockstep=True, **SMALL)
    shepherd = Shepherd(peer)
    shepherd.newest()
    for _ in range(3):
        shepherd.command([math.nan, 0.0], 0, frame='dog_1/base_link')
        shepherd.command([0.01, 0.0], 0, frame='odom')
    expected = {'dog_1/cmd_vel: not finite': 3, 'dog_1/cmd_vel: wrong frame': 3}
    peer.spin_until(lambda: shepherd.refusals() == expected)
    assert shepherd.newest() == 0
    assert process.log.count('refused') == 2
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
    assert (resting - first)[0] == pytest.approx(0.05 * 0.3)


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
    peer.spin_for(1.0)
    assert len(shepherd.truth) == held
    begun = peer.node.get_clock().now().nanoseconds
    peer.call(SetBool, 'sim/pause', SetBool.Request(data=False))
    peer.spin_until(lambda: len(shepherd.truth) > held + 20)
    wall = (peer.node.get_clock().now().nanoseconds - begun) * 1e-9
    assert wall > 18 * 0.1 / 5.0  # the time of the pause is not made up for
    stamps = [messages.nanoseconds(message.header.stamp) for message in shepherd.truth]
    assert set(np.diff(stamps)) == {100_000_000}


def test_pause_in_lockstep_keeps_the_commands(start: Callable[..., Any], peer: Any) -> None:
    start('sim', lockstep=True, **SMALL)
    shepherd = Shepherd(peer)
    place = shepherd.true_dog()
    assert peer.call(SetBool, 'sim/pause', SetBool.Request(data=True)).success
    shepherd.command([0.03, 0.0], 0)
    peer.spin_for(1.0)
    assert shepherd.newest() == 0
    assert peer.call(SetBool, 'sim/pause', SetBool.Request(data=False)).success
    peer.spin_until(lambda: shepherd.newest() == 100_000_000)
    assert shepherd.true_dog() - place == pytest.approx([0.003, 0.0])
    assert shepherd.answer([0.03, 0.0]) == 200_000_000


class Pace:
    """When the sim published each tick of its clock, by the wall."""

    def __init__(self, peer: Any, factor: float) -> None:
        self._peer = peer
        self._factor = factor
        self._late: list[float] = []  # behind the first tick's schedule [s of wall time]
        peer.node.create_subscription(Clock, '/clock', self._on_tick, 1000)

    def _on_tick(self, tick: Clock, info: dict[str, int]) -> None:
        due = messages.nanoseconds(tick.clock) * 1e-9 / self._factor
        self._late.append(info['source_timestamp'] * 1e-9 - due)

    def lateness(self, wall: float = 1.0) -> float:
        """Least lateness [s] in the next so many seconds, whatever else the machine does."""
        begun = len(self._late)
        self._peer.spin_for(wall)
        assert len(self._late) > begun + 5
        return min(self._late[begun:])


def skipped(shepherd: Shepherd) -> int:
    pairs = {pair.key: pair.value for pair in shepherd.diagnostics[-1].status[0].values}
    return int(pairs['periods_skipped'])


def test_real_time_keeps_the_wall_clocks_pace(start: Callable[..., Any], peer: Any) -> None:
    """Within one period after a minute and a half, though ticks come late on a busy machine."""
    factor = 20.0
    start('sim', real_time_factor=factor, **SMALL)
    shepherd, pace = Shepherd(peer), Pace(peer, factor)
    peer.spin_until(lambda: shepherd.newest() > 0)
    early = pace.lateness()
    peer.spin_for(4.0)
    assert abs(pace.lateness() - early) < 0.1 / factor
    assert skipped(shepherd) == 0
    stamps = [messages.nanoseconds(tick.clock) for tick in shepherd.clock]
    assert set(np.diff(stamps)) == {100_000_000}


def test_sim_that_was_held_up_makes_up_for_a_second(start: Callable[..., Any], peer: Any) -> None:
    factor = 10.0
    process = start('sim', real_time_factor=factor, **SMALL)
    shepherd, pace = Shepherd(peer), Pace(peer, factor)
    peer.spin_until(lambda: shepherd.newest() > 0)
    early = pace.lateness()
    for seconds in (0.5, 3.0):
        process.process.send_signal(signal.SIGSTOP)
        peer.spin_for(seconds)
        process.process.send_signal(signal.SIGCONT)
        peer.spin_for(1.0)
        late = pace.lateness() - early
        peer.spin_for(0.6)  # for the next diagnostics
        assert abs(late - skipped(shepherd) * 0.1 / factor) < 0.1 / factor
        assert (skipped(shepherd) > 0) == (seconds > CATCH_UP)
    assert late == pytest.approx(3.0 - CATCH_UP, abs=0.2)
    stamps = [messages.nanoseconds(tick.clock) for tick in shepherd.clock]
    assert set(np.diff(stamps)) == {100_000_000}


def test_pace_can_be_changed(start: Callable[..., Any], peer: Any) -> None:
    start('sim', real_time_factor=0.1, **SMALL)
    shepherd, pace = Shepherd(peer), Pace(peer, 20.0)
    slow = shepherd.newest()
    peer.spin_for(3.0)
    assert slow < shepherd.newest() <= slow + 400_000_000
    change = Parameter('real_time_factor', value=20.0).to_parameter_msg()
    request = SetParameters.Request(parameters=[change])
    assert peer.call(SetParameters, 'sim/set_parameters', request).results[0].successful
    early = pace.lateness()
    peer.spin_for(1.0)
    assert abs(pace.lateness() - early) < 0.1 / 20.0


def test_time_goes_on_while_a_parameter_changes_all_the_time(
    start: Callable[..., Any], peer: Any
) -> None:
    """As under a slider that is being moved."""
    start('sim', real_time_factor=1.0, **SMALL)
    shepherd = Shepherd(peer)
    client = peer.node.create_client(SetParameters, 'sim/set_parameters')
    peer.spin_until(client.service_is_ready)
    first = shepherd.newest()
    for k in range(40):
        change = Parameter('crowd.noise', value=0.01 + 1e-4 * k).to_parameter_msg()
        client.call_async(SetParameters.Request(parameters=[change]))
        peer.spin_for(0.05)
    assert shepherd.newest() - first > 1_000_000_000


def test_sim_that_finishes_twice_can_be_asked_as_long_after_the_second_time(
    start: Callable[..., Any], peer: Any
) -> None:
    quick: dict[str, Any] = {'real_time_factor': 20.0, 'time_limit': 1.0}
    process = start('sim', end_when_finished=True, **quick, **SMALL)
    shepherd = Shepherd(peer)
    peer.spin_until(lambda: shepherd.newest() >= 1_000_000_000)
    peer.spin_for(1.2)
    assert peer.call(Trigger, 'sim/reset', Trigger.Request()).success
    peer.spin_until(lambda: shepherd.newest() < 1_000_000_000)
    peer.spin_until(lambda: shepherd.newest() >= 1_000_000_000)
    peer.spin_for(1.5)  # when the first end was due
    assert process.process.poll() is None
    process.wait()


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
        ({'crowd__noise_field__period': 0.0}, 'crowd.noise_field.period'),
        ({'crowd__preset': 'lions'}, 'cohesive or printed'),
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


def test_unexpected_error_is_said_and_has_its_exit_code(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    program = tmp_path / 'broken_sim.py'
    program.write_text(
        'import sys\n'
        'from herding_ros.nodes.sim import main, Sim\n'
        'Sim._publish_diagnostics = lambda self: 1 / 0\n'
        'sys.exit(main(sys.argv[1:]))\n'
    )
    process = start('sim', program=program, **SMALL)
    assert process.wait() == 1
    assert 'FATAL' in process.log
    assert 'ZeroDivisionError' in process.log
    assert 'published' in process.log
