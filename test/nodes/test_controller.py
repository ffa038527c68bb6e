"""The controller as a process, with the test in the sim's place: it needs no sim of ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
import signal
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
import numpy as np
import pytest
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from trajectory_msgs.msg import MultiDOFJointTrajectory

from herding_ros.control.parameters import Control, Horizon, Mapping, Weights
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.noise_field import NoiseField
from herding_ros.model.state import HerdState
from herding_ros.nodes import messages

QUICK = {'horizon__length': 4.0, 'horizon__accepted': 2.0, 'mapping__paths': 20}
CONTROL = Control(horizon=Horizon(length=4.0, accepted=2.0), mapping=Mapping(paths=20))


def velocity(command: TwistStamped | Twist) -> np.ndarray:
    linear = getattr(command, 'twist', command).linear
    return np.array([linear.x, linear.y])


class Pasture:
    """Publishes a herd that stands still and hears what its dogs are told."""

    def __init__(self, peer: Any, herd: HerdState, kind: Any = TwistStamped) -> None:
        self.peer = peer
        self.herd = herd
        self.heading = 0.0
        dogs = range(1, len(herd.d) + 1)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.commands = [peer.listen(kind, f'dog_{m}/cmd_vel') for m in dogs]
        self.plans = peer.listen(MultiDOFJointTrajectory, 'plan', latched)
        self.diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
        self.sheep = peer.talk_to(PointCloud2, 'sheep')
        self.odometry = [peer.talk_to(Odometry, f'dog_{m}/odom') for m in dogs]

    def said(self, name: str) -> dict[str, str]:
        """The values of the newest status of this name."""
        for message in reversed(self.diagnostics):
            for status in message.status:
                if status.name == name:
                    return {pair.key: pair.value for pair in status.values}
        return {}

    def show(
        self,
        ns: int,
        cloud: PointCloud2 | bytes | None = None,
        silent: Sequence[int] = (),
    ) -> None:
        for m, publisher in enumerate(self.odometry):
            if m in silent:
                continue
            data = messages.odometry(self.herd.d[m], np.zeros(2), m + 1, ns, 'map')
            message = deserialize_message(data, Odometry)
            message.pose.pose.orientation.z = math.sin(self.heading / 2)
            message.pose.pose.orientation.w = math.cos(self.heading / 2)
            publisher.publish(message)
        self.sheep.publish(cloud or messages.cloud(self.herd.x, self.herd.v, ns, 'map'))

    def answered(self, count: int) -> None:
        self.peer.spin_until(lambda: min(len(heard) for heard in self.commands) >= count)

    def now(self) -> int:
        return int(self.peer.node.get_clock().now().nanoseconds)


@pytest.fixture
def herd() -> HerdState:
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.3, 0.3, (6, 2)).astype(np.float32)
    return HerdState(x, np.zeros((6, 2)), np.array([[-0.6, -0.5], [-0.4, -0.7]]))


def test_lockstep_answers_with_the_plan_of_the_core(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    start('controller', lockstep=True, dogs=2, seed=7, goal='[1.0, 0.0]', **QUICK)
    pasture = Pasture(peer, herd)
    planner = RecedingHorizon(Crowd(), CONTROL, np.array([1.0, 0.0]), seed=7)
    planner.solve(herd, 0.0)
    assert planner.plan is not None
    for k in range(20):
        pasture.show(k * 100_000_000)
        pasture.answered(k + 1)
        for m, heard in enumerate(pasture.commands):
            assert messages.nanoseconds(heard[k].header.stamp) == k * 100_000_000
            assert np.array_equal(velocity(heard[k]), planner.plan.at(k * 0.1)[m])
    peer.spin_until(lambda: pasture.plans)
    assert len(pasture.plans) == 1
    pasture.show(2_000_000_000)  # the accepted half is over
    peer.spin_until(lambda: len(pasture.plans) == 2)


def test_time_set_back_starts_anew(start: Callable[..., Any], peer: Any, herd: HerdState) -> None:
    """After a reset of the sim the same observation gets the same answer as at first."""
    start('controller', lockstep=True, dogs=2, **QUICK)
    pasture = Pasture(peer, herd)
    for count, ns in enumerate([0, 100_000_000, 2_000_000_000, 0, 0], start=1):
        pasture.show(ns)
        pasture.answered(count)
    for heard in pasture.commands:
        answers = [velocity(message) for message in heard]
        assert np.array_equal(answers[3], answers[0])
        assert not np.array_equal(answers[3], answers[2])


def test_commands_are_in_the_dogs_own_frame(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    start('controller', lockstep=True, dogs=2, **QUICK)
    pasture = Pasture(peer, herd)
    pasture.show(0)
    pasture.answered(1)
    pasture.heading = math.pi / 2
    pasture.show(1)
    pasture.answered(2)
    for heard in pasture.commands:
        ahead, turned = (velocity(message) for message in heard[:2])
        assert np.linalg.norm(ahead) > 1e-3
        assert np.linalg.norm(ahead) <= 0.05 * (1 + 1e-12)
        assert turned == pytest.approx(np.array([ahead[1], -ahead[0]]), abs=1e-15)


def test_bad_observations_get_no_answer(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    process = start('controller', lockstep=True, dogs=2, **QUICK)
    pasture = Pasture(peer, herd)
    nan = herd.x.copy()
    nan[2, 1] = math.nan
    pasture.show(0, messages.cloud(nan, herd.v, 0, 'map'))
    pasture.show(0, messages.cloud(herd.x, herd.v, 0, 'odom'))
    pasture.show(0, PointCloud2())
    pasture.show(0, b'no message at all')
    peer.spin_until(lambda: process.log.count('refused') >= 3)
    peer.spin_for(0.3)
    assert not pasture.commands[0]
    pasture.show(100_000_000)
    pasture.answered(1)
    expected = {'not finite': '1', 'wrong frame': '2', 'malformed': '1'}
    peer.spin_until(lambda: pasture.said('controller: state').get('refused sheep: malformed'))
    state = pasture.said('controller: state')
    assert expected == {k[15:]: v for k, v in state.items() if k.startswith('refused sheep: ')}
    assert process.log.count('refused') == len(expected)


def test_new_goal_is_planned_for_at_once(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    process = start('controller', lockstep=True, dogs=2, goal='[1.0, 0.0]', **QUICK)
    pasture = Pasture(peer, herd)
    paths = peer.listen(Path, 'herd/path')
    goals = peer.talk_to(PoseStamped, 'goal_pose')
    pasture.show(0)
    pasture.answered(1)
    goal = PoseStamped()
    goal.header.frame_id = 'map'
    goal.pose.position.x = -1.0
    goals.publish(goal)
    peer.spin_until(lambda: 'destination is now (-1, 0)' in process.log)
    pasture.show(100_000_000)
    pasture.answered(2)
    peer.spin_until(lambda: len(paths) == 2)
    assert messages.nanoseconds(paths[1].poses[0].header.stamp) == 100_000_000
    planner = RecedingHorizon(Crowd(), CONTROL, np.array([1.0, 0.0]))
    planner.solve(herd, 0.0)
    assert planner.plan is not None
    old = planner.plan.at(0.1)
    planner.move_goal(np.array([-1.0, 0.0]))
    planner.solve(herd, 0.1)
    new = np.array([velocity(heard[1]) for heard in pasture.commands])
    assert np.array_equal(new, planner.plan.at(0.1))
    assert not np.array_equal(new, old)


def test_plan_is_there_for_latecomers(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    start('controller', lockstep=True, dogs=2, **QUICK)
    pasture = Pasture(peer, herd)
    pasture.show(0)
    pasture.answered(1)
    peer.spin_until(lambda: pasture.plans)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    late = peer.listen(MultiDOFJointTrajectory, 'plan', latched)
    peer.spin_until(lambda: late)
    assert len(late[0].points) == 40


def test_solving_does_not_hold_up_the_commands(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    """While a long solve runs in the background, commands of the old plan keep coming."""
    start(
        'controller', dogs=2, lead=4.0, mapping__paths=4000, mapping__accuracy=1e-9,
        mapping__max_iterations=12, mapping__standard_error=0.0,
    )  # fmt: skip
    pasture = Pasture(peer, herd)
    goals = peer.talk_to(PoseStamped, 'goal_pose')
    peer.node.create_timer(0.05, lambda: pasture.show(pasture.now()))
    pasture.answered(5)
    peer.spin_until(lambda: len(pasture.plans) == 1)
    goal = PoseStamped()
    goal.header.frame_id = 'map'
    goal.pose.position.x = -1.0
    goals.publish(goal)
    before = len(pasture.commands[0])
    peer.spin_until(lambda: len(pasture.plans) == 2)
    stamps = np.array(
        [messages.nanoseconds(message.header.stamp) for message in pasture.commands[0][before:]]
    )
    peer.spin_until(lambda: pasture.said('controller: plan').get('replan') == '1')
    pairs = pasture.said('controller: plan')
    assert (float(pairs['goal_x']), float(pairs['goal_y'])) == (-1.0, 0.0)
    assert float(pairs['solve_ms']) > 500.0
    assert len(stamps) >= 5
    assert np.diff(stamps).max() * 1e-6 < 0.7 * float(pairs['solve_ms'])


def test_plan_is_announced_before_it_is_played(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    """Nobody waits for the first plan longer than it takes to make it."""
    process = start('controller', dogs=2, lead=10.0, **QUICK)
    pasture = Pasture(peer, herd)
    peer.node.create_timer(0.05, lambda: pasture.show(pasture.now()))
    process.wait_for('ready')
    peer.spin_until(lambda: pasture.plans)
    assert messages.nanoseconds(pasture.plans[0].header.stamp) > pasture.now()
    assert not pasture.commands[0]


def test_dogs_stop_when_the_sheep_are_out_of_sight(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    start('controller', dogs=2, lead=0.5, state_timeout=0.5, stamped=False, **QUICK)
    pasture = Pasture(peer, herd, Twist)
    timer = peer.node.create_timer(0.05, lambda: pasture.show(pasture.now()))
    peer.spin_until(lambda: pasture.commands[0] and velocity(pasture.commands[0][-1]).any())
    timer.cancel()
    peer.spin_until(lambda: not velocity(pasture.commands[0][-1]).any(), limit=10.0)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_ends_cleanly_at_a_signal(
    start: Callable[..., Any], peer: Any, herd: HerdState, number: int
) -> None:
    process = start('controller', lockstep=True, dogs=2, **QUICK)
    Pasture(peer, herd)
    assert process.end(number) == 0
    assert 'Traceback' not in process.log


def test_impossible_parameters_are_refused_with_a_reason(start: Callable[..., Any]) -> None:
    process = start('controller', horizon__accepted=30.0)
    assert process.wait() == 2
    assert 'accepted' in process.log
    assert 'Traceback' not in process.log


def test_silent_dog_is_left_out_and_taken_back(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    process = start('controller', dogs=2, lead=0.5, state_timeout=0.5, **QUICK)
    pasture = Pasture(peer, herd)
    silent: list[int] = []
    peer.node.create_timer(0.05, lambda: pasture.show(pasture.now(), silent=silent))
    peer.spin_until(lambda: pasture.plans and velocity_of(pasture, 1).any())
    assert pasture.plans[-1].joint_names == ['dog_1', 'dog_2']
    silent.append(1)
    peer.spin_until(lambda: pasture.plans[-1].joint_names == ['dog_1'])
    peer.spin_until(lambda: not velocity_of(pasture, 1).any() and velocity_of(pasture, 0).any())
    peer.spin_until(lambda: pasture.said('controller: state')['dogs_silent'] == 'dog_2')
    assert 'nothing is heard from dog_2' in process.log
    silent.clear()
    peer.spin_until(lambda: pasture.plans[-1].joint_names == ['dog_1', 'dog_2'])
    peer.spin_until(lambda: velocity_of(pasture, 1).any())


def velocity_of(pasture: Pasture, m: int) -> np.ndarray:
    return velocity(pasture.commands[m][-1]) if pasture.commands[m] else np.zeros(2)


@pytest.mark.parametrize('lockstep', [True, False])
def test_sheep_come_and_go(
    lockstep: bool, start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    process = start('controller', dogs=2, lead=0.5, lockstep=lockstep, **QUICK)
    pasture = Pasture(peer, herd)
    whole = herd
    flocks = [whole.x[:-1], np.vstack([whole.x, [[0.3, 0.4]], [[-0.3, 0.4]]]), whole.x[:1]]
    pasture.show(0 if lockstep else pasture.now())
    if not lockstep:
        peer.node.create_timer(0.05, lambda: pasture.show(pasture.now()))
    peer.spin_until(lambda: len(pasture.plans) == 1)
    for k, x in enumerate(flocks, start=1):
        pasture.herd = HerdState(x, np.zeros_like(x), whole.d)
        if lockstep:
            pasture.show(2_000_000_000 * k)
        peer.spin_until(lambda k=k: len(pasture.plans) > k)  # type: ignore[misc]
    state = pasture.said('controller: state')
    assert not [key for key in state if key.startswith('refused')]
    assert process.process.poll() is None


def test_stale_and_future_stamps_move_no_dog(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    start('controller', dogs=2, lead=0.2, state_timeout=1.0, **QUICK)
    pasture = Pasture(peer, herd)
    for shift in (-3_000_000_000, 3_000_000_000):
        for _ in range(10):
            pasture.show(pasture.now() + shift)
            peer.spin_for(0.05)
    expected = {
        f'refused {topic}: stamp {what}': '10'
        for topic in ('sheep', 'dog_1/odom', 'dog_2/odom')
        for what in ('too old', 'in the future')
    }
    peer.spin_until(lambda: expected.items() <= pasture.said('controller: state').items())
    assert not pasture.plans
    assert not pasture.commands[0]


def test_live_parameters_count_from_the_next_plan_on(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    start('controller', lockstep=True, dogs=2, seed=7, goal='[1.0, 0.0]', **QUICK)
    pasture = Pasture(peer, herd)
    planner = RecedingHorizon(Crowd(), CONTROL, np.array([1.0, 0.0]), seed=7)
    first = planner.solve(herd, 0.0).plan
    pasture.show(0)
    pasture.answered(1)
    changes = {
        'weights.centre': 5.0, 'weights.control': 0.02, 'crowd.noise': 0.03, 'max_speed': 0.04,
        'horizon.length': 3.0, 'horizon.accepted': 1.5,
        'crowd.common_noise': 0.5, 'crowd.noise_field.gust': 0.6,
    }  # fmt: skip
    values = [Parameter(name, value=value).to_parameter_msg() for name, value in changes.items()]
    request = SetParametersAtomically.Request(parameters=values)
    answer = peer.call(SetParametersAtomically, 'controller/set_parameters_atomically', request)
    assert answer.result.successful, answer.result.reason
    for count, ns in enumerate([1_900_000_000, 2_000_000_000, 3_500_000_000], start=2):
        pasture.show(ns)
        pasture.answered(count)
    planner.adjust(
        Crowd(noise=0.03, common_noise=0.5, noise_field=NoiseField(gust=0.6)),
        Control(
            max_speed=0.04,
            weights=Weights(centre=5.0, control=0.02),
            horizon=Horizon(length=3.0, accepted=1.5),
            mapping=Mapping(paths=20),
        ),
    )
    second = planner.solve(herd, 2.0).plan
    third = planner.solve(herd, 3.5).plan
    for m, heard in enumerate(pasture.commands):
        assert np.array_equal(velocity(heard[1]), first.at(1.9)[m])
        assert np.array_equal(velocity(heard[2]), second.at(2.0)[m])
        assert np.array_equal(velocity(heard[3]), third.at(3.5)[m])
    peer.spin_until(lambda: len(pasture.plans) == 3)
    assert [len(plan.points) for plan in pasture.plans] == [40, 30, 30]


@pytest.mark.parametrize('lockstep', [True, False])
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signal_while_solving_ends_at_once(
    number: int, lockstep: bool, start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    process = start(
        'controller', dogs=2, lockstep=lockstep, lead=1000.0, mapping__paths=1000,
        mapping__accuracy=1e-9, mapping__max_iterations=1000, mapping__standard_error=0.0,
    )  # fmt: skip
    pasture = Pasture(peer, herd)
    process.wait_for('ready')
    if lockstep:
        pasture.show(0)
    else:
        peer.node.create_timer(0.05, lambda: pasture.show(pasture.now()))
    peer.spin_for(1.0)  # the solve goes on for minutes
    assert not pasture.plans
    process.ends_in_time(number, times=2)
