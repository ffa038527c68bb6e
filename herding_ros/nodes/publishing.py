# SPDX-License-Identifier: Apache-2.0
"""How our nodes publish: quality of service, counts, matched subscribers, the last messages."""

from __future__ import annotations

from collections.abc import Iterable
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo

from .topic_qos import asks_more
from .wire import serialized, type_name

CLOCK = '/clock'
"""The topic that publishes the time of a simulation, unless the nodes are told another."""

EVERY_MESSAGE = QoSProfile(depth=1000)
"""Reliable, with room for what a slow subscriber has not received yet."""

ADJUSTABLE = QoSOverridingOptions.with_default_policies()
"""Lets users change reliability and depth by parameters, for robots on a radio link."""

UNWATCHED = PublisherEventCallbacks(use_default_callbacks=False)
"""No events: the executor would check two for every publisher each time it wakes."""

_FLUSH_TIME = 1.0
"""Longest time in which the last messages are delivered before a node ends [s]."""


class CountingPublisher(Publisher):
    """A publisher that counts the messages it has published; equal ones have equal bytes."""

    count = 0

    def publish(self, msg: Any) -> None:
        """Publish a message, or its bytes, and count."""
        super().publish(msg if isinstance(msg, bytes) else serialized(msg))
        self.count += 1


def flush(node: Node) -> None:
    """Log what was published, and wait until it is acknowledged."""
    published = [p for p in node.publishers if isinstance(p, CountingPublisher) and p.count]
    counts = ', '.join(f'{p.count} on {p.topic_name}' for p in published)
    node.get_logger().info(f'published {counts or "nothing"}')
    deadline = time.monotonic() + _FLUSH_TIME
    # Busy topics first: they are acknowledged at once, quiet ones with the next heartbeat.
    for publisher in sorted(published, key=lambda p: -p.count):
        remaining = max(deadline - time.monotonic(), 0.0)
        publisher.wait_for_all_acked(Duration(nanoseconds=int(remaining * 1e9)))


def full_name(namespace: str, name: str) -> str:
    """Return the full name of what has a name in a namespace; the root is '/'."""
    return f'{namespace.rstrip("/")}/{name}'


def node_of(endpoint: TopicEndpointInfo) -> str:
    """Return the full name of an endpoint's node; '' for one just discovered, without a name."""
    if endpoint.node_name == '_NODE_NAME_UNKNOWN_':
        return ''
    return full_name(endpoint.node_namespace, endpoint.node_name)


def full_node_name(node: Node, name: str) -> str:
    """Return the full name of a node that stands in the namespace of `node`, unless it is full."""
    return name if name.startswith('/') else full_name(node.get_namespace(), name)


def is_heard(node: Node, publishers: Iterable[Publisher], listener: str) -> bool:
    """Whether publishers are matched with the node named `listener` and all other subscribers.

    The name may be relative to the namespace of `node`. Subscribers of another type, or that ask
    for more than a publisher offers, are never matched, and do not count. Nor does rclpy's own
    subscription to /clock, which has a lower reliability, count as listening.
    """
    listener = full_node_name(node, listener)
    clock = node.resolve_topic_name(CLOCK)
    for publisher in publishers:
        subscribers = [
            info
            for info in node.get_subscriptions_info_by_topic(publisher.topic_name)
            if info.topic_type == type_name(publisher.msg_type)
            and not asks_more(info.qos_profile, publisher.qos_profile)
        ]
        listeners = {
            node_of(info)
            for info in subscribers
            if publisher.topic_name != clock
            or info.qos_profile.reliability == publisher.qos_profile.reliability
        }
        if listener not in listeners:
            return False
        if publisher.get_subscription_count() < len(subscribers):
            return False
    return True
