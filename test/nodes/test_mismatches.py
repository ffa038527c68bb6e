# SPDX-License-Identifier: Apache-2.0
"""What does not match is said, with its remedy; two nodes in this process, real DDS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from herding_ros.nodes.graph import LOOK_ROUNDS
from herding_ros.nodes.herding_node import HerdingNode
from herding_ros.nodes.inbox import Inbox
from herding_ros.nodes.middleware import start_ros
from herding_ros.nodes.mismatches import Mismatches, twist_type
from herding_ros.nodes.publishing import ADJUSTABLE, EVERY_MESSAGE, is_heard
from herding_ros.nodes.settings import NodeSettings
from nav_msgs.msg import Path
import pytest
import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def ours(domain: int) -> Iterator[HerdingNode]:
    """Another node of this process, whose publisher of `sheep` a user has changed."""
    context = Context()
    start_ros(context=context, domain_id=domain)
    changed = Parameter('qos_overrides./sheep.publisher.reliability', value='best_effort')
    node = HerdingNode('ours', context=context, parameter_overrides=[changed])
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_each_mismatch_is_logged_once_with_its_remedy_and_reported_while_it_lasts(
    ours: Any,
    peer: Any,
    wait_until: Callable[[Callable[[], object]], None],
    capfd: pytest.CaptureFixture[str],
) -> None:
    commands = ours.create_publisher(TwistStamped, 'dog_1/cmd_vel', 10)
    for kind, topic in [(PointCloud2, 'sheep'), (Path, 'path')]:
        ours.create_publisher(kind, topic, EVERY_MESSAGE, qos_overriding_options=ADJUSTABLE)
    ours.create_subscription(PoseStamped, 'goal_pose', lambda _: None, 10)
    mismatches = Mismatches(ours)
    strangers = [
        peer.node.create_subscription(Twist, 'dog_1/cmd_vel', lambda _: None, 10),
        peer.node.create_subscription(Path, 'path', lambda _: None, LATCHED),
        peer.node.create_subscription(PointCloud2, 'sheep', lambda _: None, 10),
    ]
    peer.node.create_publisher(PoseStamped, 'goal_pose', BEST_EFFORT)
    expected = {
        'not matched: /dog_1/cmd_vel to /peer':
            'it subscribes to geometry_msgs/msg/Twist, here it is geometry_msgs/msg/TwistStamped; '
            'set stamped: false here, or change the other node',
        'not matched: /path to /peer':
            'Volatile publisher and transient local subscription; change the quality of service '
            'of /peer',
        'not matched: /sheep to /peer':
            'Best effort publisher and reliable subscription; change the quality of service of '
            '/peer, or set qos_overrides./sheep.publisher.reliability: reliable here',
        'not matched: /goal_pose from /peer':
            'Best effort publisher and reliable subscription; change the quality of service of '
            '/peer',
    }  # fmt: skip

    def reported() -> dict[str, object]:
        mismatches.check()
        return mismatches.report_values()

    wait_until(lambda: reported() == expected)
    # Nor does anybody wait for a stranger of another type.
    ours.create_subscription(TwistStamped, 'dog_1/cmd_vel', lambda _: None, 10)
    wait_until(lambda: is_heard(ours, [commands], 'ours'))
    for stranger in strangers:
        peer.node.destroy_subscription(stranger)
    wait_until(lambda: list(reported()) == ['not matched: /goal_pose from /peer'])
    log = capfd.readouterr().err
    for key, cause in expected.items():
        assert log.count(f'{key.removeprefix("not matched: ")}: {cause}') == 1


def test_a_best_effort_publisher_is_followed_and_received(
    ours: Any, peer: Any, wait_until: Callable[[Callable[[], object]], None]
) -> None:
    inbox = Inbox(ours, PointCloud2, 'sheep', 10, qos_overriding_options=ADJUSTABLE)
    mismatches = Mismatches(ours)
    mismatches.follow([inbox])
    publisher = peer.node.create_publisher(PointCloud2, 'sheep', BEST_EFFORT)

    def received() -> object:
        mismatches.check()
        publisher.publish(PointCloud2())
        return list(inbox.take())

    wait_until(received)
    assert inbox.subscription.qos_profile.depth == 10
    assert not mismatches.report_values()
    assert len(list(ours.subscriptions)) == 1


def test_others_are_looked_at_when_there_are_more_or_fewer_and_seldom_otherwise(
    ours: Any,
    peer: Any,
    wait_until: Callable[[Callable[[], object]], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is the thread of the commands that looks, and fifty dogs have hundreds of topics."""
    topics = [f'/topic_{k}' for k in range(10)]
    inboxes = [Inbox(ours, PointCloud2, topic, 10) for topic in topics]
    mismatches = Mismatches(ours)
    mismatches.follow(inboxes)
    publishers = [peer.node.create_publisher(PointCloud2, topic, 10) for topic in topics]
    wait_until(lambda: all(publisher.get_subscription_count() for publisher in publishers))
    wait_until(lambda: all(ours.count_publishers(topic) for topic in topics))
    for _ in range(2):
        mismatches.check()
    asked: list[str] = []
    for name in ('get_publishers_info_by_topic', 'get_subscriptions_info_by_topic'):
        ask = getattr(ours, name)
        monkeypatch.setattr(ours, name, lambda topic, ask=ask: asked.append(topic) or ask(topic))
    for _ in range(LOOK_ROUNDS):
        mismatches.check()
    counts = [asked.count(topic) for topic in topics]
    assert max(counts) <= 3
    assert min(counts) >= 1
    # Another in the place of one, between two checks: they are as many as before.
    peer.node.destroy_publisher(publishers[3])
    peer.node.create_publisher(PoseStamped, topics[3], 10)
    wait_until(
        lambda: {each.topic_type for each in ours.get_publishers_info_by_topic(topics[3])}
        == {'geometry_msgs/msg/PoseStamped'}
    )  # fmt: skip
    for _ in range(LOOK_ROUNDS + 1):
        mismatches.check()
    assert list(mismatches.report_values()) == [f'not matched: {topics[3]} from /peer']


@pytest.mark.parametrize(
    ('stamped', 'others', 'kind'),
    [
        (True, [], TwistStamped),
        (True, ['geometry_msgs/msg/TwistStamped'], TwistStamped),
        (True, ['geometry_msgs/msg/Twist'] * 2, Twist),
        (True, ['geometry_msgs/msg/Twist', 'geometry_msgs/msg/TwistStamped'], TwistStamped),
        (True, ['std_msgs/msg/String'], TwistStamped),
        (False, [], Twist),
        (False, ['geometry_msgs/msg/TwistStamped'], TwistStamped),
    ],
)
def test_commands_are_of_the_type_that_all_others_take(
    stamped: bool, others: list[str], kind: Any
) -> None:
    node: Any = Mock()
    infos: Any = [SimpleNamespace(topic_type=each) for each in others]
    assert twist_type(node, '/dog_1/cmd_vel', NodeSettings(stamped=stamped), infos) is kind
    in_lockstep = NodeSettings(lockstep=True)
    assert twist_type(node, '/dog_1/cmd_vel', in_lockstep, infos) is TwistStamped
