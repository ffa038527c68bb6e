"""A subscription that is emptied by hand, past the executor."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile

MOST_AT_ONCE = 1_000
"""Messages taken in a row, so that a flooded topic does not keep out the others."""


STRAGGLERS = 0.02
"""Time between two looks for messages that came after the one that wakes the node [s]."""


class Inbox:
    """Holds the messages of a topic until they are taken.

    rclpy's executor spends some 200 µs on waking up for a message, `take` some 5. So a node
    that needs all of several topics wakes for one of them and takes the others.
    """

    def __init__(
        self,
        node: Node,
        message_type: Any,
        topic: str,
        qos: QoSProfile | int,
        raw: bool = False,
        **options: Any,
    ) -> None:
        self._type = message_type
        self._raw = raw
        self.subscription = node.create_subscription(
            message_type,
            topic,
            lambda message: None,
            qos,
            callback_group=_Nobody(),
            raw=raw,
            **options,
        )

    def take(self) -> Iterator[tuple[Any, dict[str, int]]]:
        """Yield the messages that have come in, the oldest first, each with its time stamps."""
        with self.subscription.handle:
            take_message = self.subscription.handle.take_message
            for _ in range(MOST_AT_ONCE):
                taken = take_message(self._type, self._raw)
                if taken is None:
                    break
                yield taken


class _Nobody(MutuallyExclusiveCallbackGroup):
    """Keeps the executor from waiting on a subscription."""

    def can_execute(self, entity: Any) -> bool:
        return False
