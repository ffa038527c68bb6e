# SPDX-License-Identifier: Apache-2.0
"""Duplicate nodes, such as two sims by mistake: all but one end, with the reason.

Each kind of node has a topic that no other kind publishes, and a simulation has one clock. A node
that finds a publisher of it does not become active. Two that start at the same instant may not
discover each other, so both keep watching: then the one that was there first stays, or else the
one with the lower identifier.
"""

from __future__ import annotations

from collections.abc import Callable
import time

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.topic_endpoint_info import TopicEndpointInfo

from .herding_node import HerdingNode
from .publishing import node_of
from .running import CannotGoOnError

DISCOVERY = 0.6
"""Time in which a node discovers those that were there before, nearly always [s]."""

PATIENCE = 2.0
"""Time in which another node that is about to end has gone [s]."""

CLAIM = 4.0
"""Time that an active node waits for a duplicate to go, for each of its two claims to stay [s].

More than PATIENCE: a duplicate that is being refused may have been active for a moment.
"""

WATCH_PERIOD = 0.5
"""Time between two checks of an active node for duplicates [s]."""

ANOTHER_NODE = 'end it, or give this one a namespace or another ROS_DOMAIN_ID'
"""What helps against a duplicate node."""

ANOTHER_CLOCK = (
    'end it, or give all nodes of this herd a clock of their own, by a namespace and '
    '-r /clock:=clock, or another ROS_DOMAIN_ID'
)
"""What helps against a second clock."""


def sole_publisher(
    node: HerdingNode,
    topic: str,
    create: Callable[[], Publisher],
    advice: str = ANOTHER_NODE,
) -> Publisher:
    """Return create(), a publisher of the topic, and make sure that it stays the only one.

    Raises ValueError, with the advice, if another node publishes the topic and goes on doing so.
    If one appears later, the executor raises CannotGoOnError in one of the two nodes.
    """
    full_name = node.resolve_topic_name(topic)
    _wait_until_nobody_publishes(node, full_name, advice)
    publisher = create()
    found = node.get_publishers_info_by_topic(full_name)
    if len(found) != 1:  # another did it at the same instant: which one is mine?
        node.destroy_publisher(publisher)
        return sole_publisher(node, topic, create, advice)

    watch = _Watch(node, full_name, found[0].endpoint_gid, advice)
    node.create_timer(WATCH_PERIOD, watch.check, clock=Clock(clock_type=ClockType.STEADY_TIME))
    return publisher


class _Watch:
    """Watches for duplicates of an active node; raises CannotGoOnError when the node must go."""

    def __init__(self, node: Node, topic: str, mine: list[int], advice: str) -> None:
        self._node = node
        self._advice = advice
        self._topic = topic
        self._mine = mine
        self._begun = time.monotonic()
        self._since: float | None = None  # when a duplicate was first there

    def check(self) -> None:
        """Raise if a duplicate has stayed for as long as this node's claims allow."""
        infos = self._node.get_publishers_info_by_topic(self._topic)
        others = [info for info in infos if info.endpoint_gid != self._mine]
        now = time.monotonic()
        if not others:
            self._since = None
            return
        if self._since is None:
            self._since = now
            return
        was_first = self._since > self._begun + CLAIM
        is_lower = all(self._mine < info.endpoint_gid for info in others)
        if now > self._since + CLAIM * (2 * was_first + is_lower):
            raise CannotGoOnError(
                f'{_name(others[0])} publishes {self._topic} as well; {self._advice}'
            )


def _wait_until_nobody_publishes(node: HerdingNode, topic: str, advice: str) -> None:
    end = time.monotonic() + PATIENCE
    is_logged = False
    while True:
        others = node.get_publishers_info_by_topic(topic)
        now = time.monotonic()
        if not others and now > node.joined + DISCOVERY:
            return
        if others and now > end:
            raise ValueError(f'{_name(others[0])} publishes {topic} already; {advice}')
        if others and node_of(others[0]) and not is_logged:
            node.get_logger().info(
                f'waiting for {_name(others[0])} to end, which publishes {topic}'
            )
            is_logged = True
        time.sleep(0.02)


def _name(info: TopicEndpointInfo) -> str:
    name = node_of(info)
    return f'node {name}' if name else 'another node'
