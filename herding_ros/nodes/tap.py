"""A subscription to serialised messages that is emptied by hand, past the executor."""

from __future__ import annotations

from typing import Any, NamedTuple

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile

MOST_AT_ONCE = 1_000
"""Messages taken in a row, so that a flooded topic does not keep out the others."""


class Received(NamedTuple):
    """A serialised message, with the wall times [ns] at which it was published and came in."""

    publish_ns: int
    receive_ns: int
    topic: str
    data: bytes


class Tap:
    """All messages of a topic, as they are on the wire.

    rclpy's executor spends up to 200 µs on a message, `take()` some 5. The executor could
    tell of lost messages too, but then it wakes for every message; `take_lost()` asks.
    """

    def __init__(self, node: Node, topic: str, message_type: Any, qos: QoSProfile) -> None:
        self.topic = topic
        self.message_type = message_type
        self.qos = qos
        self._node = node
        self._subscription = node.create_subscription(
            message_type,
            topic,
            lambda message: None,
            qos,
            callback_group=_Nobody(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )
        self._lost = rclpy_implementation.EventHandle(
            self._subscription.handle, QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
        )

    def take(self) -> list[Received]:
        """Return the messages that have come in, the oldest first."""
        received = []
        with self._subscription.handle:
            take_message = self._subscription.handle.take_message
            for _ in range(MOST_AT_ONCE):
                taken = take_message(self.message_type, True)
                if taken is None:
                    break
                data, info = taken
                received.append(
                    Received(
                        info['source_timestamp'], info['received_timestamp'], self.topic, data
                    )
                )
        return received

    def take_lost(self) -> int:
        """Return how many messages the middleware has lost since the last call."""
        with self._lost:
            event = self._lost.take_event()
        lost: int = event.total_count_change if event else 0
        return lost

    def destroy(self) -> None:
        """End the subscription; what it holds is lost."""
        self._lost.destroy_when_not_in_use()
        self._node.destroy_subscription(self._subscription)


class _Nobody(MutuallyExclusiveCallbackGroup):
    """Keeps the executor from waiting on a subscription."""

    def can_execute(self, entity: Any) -> bool:
        return False
