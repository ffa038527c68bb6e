# SPDX-License-Identifier: Apache-2.0
"""The controller as a process, in a test that plays the sim: the wiring of the pilot to ROS.

What the pilot decides is tested in test/control/test_pilot.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
import math
import signal
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from herding_ros.control.parameters import Control, Horizon, Mapping, Weights
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.noise_field import NoiseField
from herding_ros.model.state import HerdState
from herding_ros.nodes import messages
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from trajectory_msgs.msg import MultiDOFJointTrajectory

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
QUICK = {'horizon__length': 4.0, 'horizon__accepted': 2.0, 'mapping__paths': 20}
AS_PLANNED = {**QUICK, 'bodies__ramp': 0.0}
CONTROL = Control(horizon=Horizon(length=4.0, accepted=2.0), mapping=Mapping(paths=20))


def velocity(command: TwistStamped | Twist) -> np.ndarray:
    linear = getattr(command, 'twist', command).linear
    return np.array([linear.x, linear.y])


class Pasture:
    """Publishes a herd that stands still, and listens to the commands for its dogs."""

    def __init__(
        self, peer: Any, herd: HerdState, kind: Any = TwistStamped, qos: Any = 1000
    ) -> None:
        self.peer = peer
        self.herd = herd
        self.heading = 0.0
        dogs = range(1, len(herd.d) + 1)
        self.commands = [peer.listen(kind, f'dog_{m}/cmd_vel') for m in dogs]
        self.plans = peer.listen(MultiDOFJointTrajectory, 'plan', LATCHED)
        self.diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
        self.sheep = peer.talk_to(PointCloud2, 'sheep', qos=qos)
        self.odometry = [peer.talk_to(Odometry, f'dog_{m}/odom', qos=qos) for m in dogs]

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

    def wait_for_commands(self, count: int) -> None:
        self.peer.spin_until(lambda: min(len(heard) for heard in self.commands) >= count)

    def now(self) -> int:
        return int(self.peer.node.get_clock().now().nanoseconds)


@pytest.fixture
def herd() -> HerdState:
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.3, 0.3, (6, 2)).astype(np.float32)
    return HerdState(x, np.zeros((6, 2)), np.array([[-0.6, -0.5], [-0.4, -0.7]]))


def test_lockstep_replies_with_the_plan_of_the_core_in_each_dogs_own_frame(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    start('controller', lockstep=True, dogs=2, seed=7, goal='[1.0, 0.0]', **AS_PLANNED)
    pasture = Pasture(peer, herd)
    planner = RecedingHorizon(Crowd(), CONTROL, np.array([1.0, 0.0]), seed=7)
    plan = planner.solve(herd, 0.0).plan
    for k in range(20):
        if k == 10:
            planner.learn(herd, 1.0)
            plan = planner.improve(herd, 1.0).plan
        pasture.heading = 0.0 if k < 10 else math.pi / 2
        pasture.show(k * 100_000_000)
        pasture.wait_for_commands(k + 1)
        for m, heard in enumerate(pasture.commands):
            assert messages.nanoseconds(heard[k].header.stamp) == k * 100_000_000
            u = plan.at(k * 0.1)[m]
            expected = u if k < 10 else np.array([u[1], -u[0]])
            assert velocity(heard[k]) == pytest.approx(expected, abs=0.0 if k < 10 else 1e-15)
    peer.spin_until(lambda: pasture.plans)
    assert len(pasture.plans) == 2
    assert pasture.said('controller: plan')['kind'] == 'feedback'
    pasture.show(2_000_000_000)  # the accepted half is over
    peer.spin_until(lambda: len(pasture.plans) == 3)
    peer.spin_until(lambda: pasture.said('controller: plan')['kind'] == 'window')
    late = peer.listen(MultiDOFJointTrajectory, 'plan', LATCHED)
    peer.spin_until(lambda: late)
    assert len(late[0].points) == 40


def test_positions_of_sheep_are_enough_where_their_noise_is_told(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    start(
        'controller', lockstep=True, dogs=2, goal='[1.0, 0.0]', sensor__position_noise=0.05,
        **QUICK,
    )  # fmt: skip
    pasture = Pasture(peer, herd)
    for k in range(3):
        data = messages.cloud(herd.x, herd.v, k * 100_000_000, 'map')
        cloud = deserialize_message(data, PointCloud2)
        cloud.fields = [field for field in cloud.fields if not field.name.startswith('v')]
        pasture.show(k * 100_000_000, cloud)
        pasture.wait_for_commands(k + 1)
    assert all(velocity(heard[2]).any() for heard in pasture.commands)
    peer.spin_until(lambda: 'velocity_error_m_s' in pasture.said('controller: state'))
    said = pasture.said('controller: state')
    assert said['sheep_out_of_sight'] == '0'
    assert 0.0 < float(said['velocity_error_m_s']) < float(said['position_error_m']) <= 0.05


def test_dogs_without_influence_are_a_warning(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    start('controller', lockstep=True, dogs=2, goal='[1.0, 0.0]', **QUICK)
    pasture = Pasture(peer, replace(herd, d=herd.d + 1000.0))
    pasture.show(0)
    peer.spin_until(lambda: pasture.said('controller: plan'))
    statuses = [each for message in pasture.diagnostics for each in message.status]
    (plan,) = (each for each in statuses if each.name == 'controller: plan')
    assert (plan.message, plan.level) == ('no influence', DiagnosticStatus.WARN)


def test_moved_goal_and_dynamic_parameters_reach_the_planner(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    process = start('controller', lockstep=True, dogs=2, seed=7, goal='[1.0, 0.0]', **AS_PLANNED)
    pasture = Pasture(peer, herd)
    goals = peer.talk_to(PoseStamped, 'goal_pose')
    planner = RecedingHorizon(Crowd(), CONTROL, np.array([1.0, 0.0]), seed=7)
    plans = [planner.solve(herd, 0.0).plan]
    pasture.show(0)
    pasture.wait_for_commands(1)
    in_force = peer.listen(PoseStamped, 'herd/goal', LATCHED)  # late
    peer.spin_until(lambda: in_force)
    goal = PoseStamped()
    goal.header.frame_id = 'odom'
    goal.pose.position.x = 7.0
    goals.publish(goal)
    peer.spin_until(lambda: "goal (7, 0) must be in frame 'map', got 'odom'" in process.log)
    goal.header.frame_id = 'map'
    goal.pose.position.x = -1.0
    goals.publish(goal)
    peer.spin_until(lambda: 'destination is now (-1, 0)' in process.log)
    peer.spin_until(lambda: len(in_force) == 2)
    assert [message.pose.position.x for message in in_force] == [1.0, -1.0]
    assert {message.header.frame_id for message in in_force} == {'map'}
    changes = {
        'weights.centre': 5.0, 'weights.control': 0.02, 'crowd.noise': 0.03, 'max_speed': 0.04,
        'horizon.length': 3.0, 'horizon.accepted': 1.5,
        'crowd.common_noise': 0.5, 'crowd.noise_field.gust': 0.6,
    }  # fmt: skip
    values = [Parameter(name, value=value).to_parameter_msg() for name, value in changes.items()]
    request = SetParametersAtomically.Request(parameters=values)
    reply = peer.call(SetParametersAtomically, 'controller/set_parameters_atomically', request)
    assert reply.result.successful, reply.result.reason
    for count, ns in enumerate([100_000_000, 1_600_000_000], start=2):
        pasture.show(ns)
        pasture.wait_for_commands(count)
    planner.adjust(
        Crowd(noise=0.03, common_noise=0.5, noise_field=NoiseField(gust=0.6)),
        Control(
            max_speed=0.04,
            weights=Weights(centre=5.0, control=0.02),
            horizon=Horizon(length=3.0, accepted=1.5),
            mapping=Mapping(paths=20),
        ),
    )
    planner.move_goal(np.array([-1.0, 0.0]))
    for t in (0.1, 1.6):
        planner.learn(herd, t)
        plans.append(planner.solve(herd, t).plan)
    for m, heard in enumerate(pasture.commands):
        for message, plan in zip(heard, plans, strict=True):
            assert np.array_equal(velocity(message), plan.u[0, m])
    peer.spin_until(lambda: len(pasture.plans) == 3)
    assert [len(plan.points) for plan in pasture.plans] == [40, 30, 30]
    peer.spin_until(lambda: pasture.said('controller: plan').get('replan') == '2')
    assert pasture.said('controller: plan')['goal_x'] == '-1'


def test_bad_observations_get_no_reply(
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
    pasture.wait_for_commands(1)
    expected = {'not finite': '1', 'wrong frame': '2', 'malformed': '1'}
    peer.spin_until(lambda: pasture.said('controller: state').get('refused sheep: malformed'))
    state = pasture.said('controller: state')
    assert expected == {k[15:]: v for k, v in state.items() if k.startswith('refused sheep: ')}
    assert process.log.count('refused') == 4  # one line for each cause: of two wrong frames, two


def test_by_its_own_clock_a_plan_is_announced_before_it_is_played_and_solves_hold_up_no_command(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    start(
        'controller', dogs=2, lead=4.0, mapping__paths=4000, mapping__tolerance=0.0,
        mapping__max_iterations=12, mapping__standard_error=0.0, horizon__feedback=10.0,
    )  # fmt: skip
    pasture = Pasture(peer, herd)
    goals = peer.talk_to(PoseStamped, 'goal_pose')
    peer.node.create_timer(0.05, lambda: pasture.show(pasture.now()))
    peer.spin_until(lambda: pasture.plans)
    assert messages.nanoseconds(pasture.plans[0].header.stamp) > pasture.now()
    assert not pasture.commands[0]
    pasture.wait_for_commands(5)
    goal = PoseStamped()
    goal.header.frame_id = 'map'
    goal.pose.position.x = -1.0
    goals.publish(goal)
    before = len(pasture.commands[0])
    peer.spin_until(lambda: pasture.said('controller: plan').get('replan') == '1')
    stamps = np.array(
        [messages.nanoseconds(message.header.stamp) for message in pasture.commands[0][before:]]
    )
    pairs = pasture.said('controller: plan')
    assert (float(pairs['goal_x']), float(pairs['goal_y'])) == (-1.0, 0.0)
    assert float(pairs['solve_ms']) > 500.0
    assert len(stamps) >= 5
    assert np.diff(stamps).max() * 1e-6 < 0.7 * float(pairs['solve_ms'])


def test_stale_stamps_move_no_dog_and_silence_is_noticed(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    """The robots take Twist, and publish best effort; no parameter says so."""
    robots = [peer.listen(Twist, f'dog_{m}/cmd_vel') for m in (1, 2)]
    process = start('controller', dogs=2, lead=0.3, state_timeout=1.0, **QUICK)
    pasture = Pasture(peer, herd, Twist, BEST_EFFORT)
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
    silent: list[int] = []
    timer = peer.node.create_timer(0.05, lambda: pasture.show(pasture.now(), silent=silent))
    peer.spin_until(lambda: pasture.plans and velocity_of(pasture, 1).any())
    assert pasture.plans[-1].joint_names == ['dog_1', 'dog_2']
    peer.spin_until(lambda: pasture.said('controller: plan').get('kind') == 'feedback')
    peer.spin_until(lambda: pasture.said('controller: state').get('feedbacks_made', '0') != '0')
    silent.append(1)
    peer.spin_until(lambda: pasture.plans[-1].joint_names == ['dog_1'])
    peer.spin_until(lambda: pasture.said('controller: state')['dogs_silent'] == 'dog_2')
    assert 'no odometry from dog_2' in process.log
    assert all(robots)
    assert 'not matched' not in ' '.join(pasture.said('controller: state'))
    timer.cancel()
    peer.spin_until(lambda: not velocity_of(pasture, 0).any(), limit=10.0)


def velocity_of(pasture: Pasture, m: int) -> np.ndarray:
    return velocity(pasture.commands[m][-1]) if pasture.commands[m] else np.zeros(2)


def test_impossible_parameters_are_refused_with_a_reason(start: Callable[..., Any]) -> None:
    process = start('controller', horizon__accepted=30.0)
    assert process.wait() == 2
    assert 'accepted' in process.log
    assert 'Traceback' not in process.log


@pytest.mark.parametrize(('number', 'lockstep'), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_signal_while_solving_ends_at_once(
    number: int, lockstep: bool, start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    process = start(
        'controller', dogs=2, lockstep=lockstep, lead=150.0, mapping__paths=1000,
        mapping__tolerance=0.0, mapping__max_iterations=1000, mapping__standard_error=0.0,
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
