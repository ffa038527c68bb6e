# SPDX-License-Identifier: Apache-2.0
"""A subscription to serialised messages, for the recorder."""

from __future__ import annotations

from typing import Any, NamedTuple

from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile

from .inbox import Inbox


class Received(NamedTuple):
    """A serialised message, with the wall times [ns] at which it was published and came in."""

    publish_ns: int
    receive_ns: int
    topic: str
    data: bytes


class Tap:
    """All messages of a topic, as they are on the wire.

    The executor could report lost messages too, but then it wakes for every message;
    `take_lost()` asks.
    """

    def __init__(self, node: Node, topic: str, message_type: Any, qos: QoSProfile) -> None:
        self.topic = topic
        self.message_type = message_type
        self.qos = qos
        self._node = node
        self._inbox = Inbox(
            node,
            message_type,
            topic,
            qos,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        self._lost = rclpy_implementation.EventHandle(
            self._inbox.subscription.handle,
            QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST,
        )

    def take(self) -> list[Received]:
        """Return the messages that have come in, the oldest first."""
        topic = self.topic
        return [
            # A stranger's stamp may be missing, which is negative.
            Received(max(info['source_timestamp'], 0), info['received_timestamp'], topic, data)
            for data, info in self._inbox.take()
        ]

    def take_lost(self) -> int:
        """Return how many messages the middleware has lost since the last call."""
        with self._lost:
            event = self._lost.take_event()
        lost: int = event.total_count_change if event else 0
        return lost

    def destroy(self) -> None:
        """End the subscription; what it holds is lost."""
        self._lost.destroy_when_not_in_use()
        self._node.destroy_subscription(self._inbox.subscription)
