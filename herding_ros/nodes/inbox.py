# SPDX-License-Identifier: Apache-2.0
"""A subscription that is emptied by hand, past the executor."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
import time
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

MOST_AT_ONCE = 1_000
"""Messages taken in a row, so that a flooded topic does not keep out the others."""


LOCKSTEP_TURN = 0.02
"""Time for which a node in lockstep only replies, before it does everything else [s]."""


class Inbox:
    """Holds the messages of a topic, as bytes, until they are taken.

    rclpy's executor spends some 200 µs on waking up for a message, since it then checks
    everything that a node has. `take` spends 3 and `arrivals` 10.
    """

    def __init__(
        self, node: Node, message_type: Any, topic: str, qos: QoSProfile | int, **options: Any
    ) -> None:
        self._node = node
        self._type = message_type
        self.subscription = self._subscribe(topic, qos, **options)

    def _subscribe(self, topic: str, qos: QoSProfile | int, **options: Any) -> Subscription:
        return self._node.create_subscription(
            self._type,
            topic,
            lambda message: None,
            qos,
            callback_group=_Nobody(),
            raw=True,
            **options,
        )

    def become_best_effort(self) -> None:
        """Subscribe anew, to publishers that offer no more; what has not been taken is lost."""
        old = self.subscription
        qos = copy(old.qos_profile)
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
        self.subscription = self._subscribe(old.topic_name, qos)
        self._node.destroy_subscription(old)

    def take(self) -> Iterator[tuple[bytes, dict[str, int]]]:
        """Yield the messages that have come in, the oldest first, each with its time stamps."""
        with self.subscription.handle:
            take_message = self.subscription.handle.take_message
            for _ in range(MOST_AT_ONCE):
                taken = take_message(self._type, True)
                if taken is None:
                    break
                yield taken

    def arrivals(self, seconds: float) -> Iterator[None]:
        """Yield whenever there are messages, and when the time is over."""
        end = time.monotonic() + seconds
        context = self._node.context.handle
        assert context is not None
        with self.subscription.handle, context:
            wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, context)
            while (left := end - time.monotonic()) > 0.0:
                wait_set.clear_entities()
                wait_set.add_subscription(self.subscription.handle)
                wait_set.wait(int(left * 1e9))
                yield


class _Nobody(MutuallyExclusiveCallbackGroup):
    """Keeps the executor from waiting on a subscription."""

    def can_execute(self, entity: Any) -> bool:
        return False
