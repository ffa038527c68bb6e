"""How every node of ours starts, waits for its listeners and ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import sys

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

EVERY_MESSAGE = QoSProfile(depth=1000)
"""Reliable, with room for what a slow listener has not taken yet."""

ADJUSTABLE = QoSOverridingOptions.with_default_policies()
"""Lets users change reliability and depth by parameters, for robots on a radio link."""


def run(make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """Spin a node until SIGINT, SIGTERM or shutdown.

    Returns the exit code: 0, or 2 when the node was started with a parameter that is not
    allowed (ValueError), which is printed and nothing else.
    """
    rclpy.init(args=args)
    node = None
    try:
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except ValueError as error:
        if node is not None:
            raise
        print(f'cannot start: {error}', file=sys.stderr)
        return 2
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def is_heard(node: Node, publishers: Iterable[Publisher], listener: str) -> bool:
    """Whether the node named `listener` and all other subscribers are matched by publishers."""
    for publisher in publishers:
        subscribers = node.get_subscriptions_info_by_topic(publisher.topic_name)
        if listener not in {info.node_name for info in subscribers}:
            return False
        if publisher.get_subscription_count() < len(subscribers):
            return False
    return True


class Refusals:
    """Bad messages by kind: each kind is logged once and counted."""

    def __init__(self, logger: RcutilsLogger) -> None:
        """Log to `logger`."""
        self.counts: dict[str, int] = {}
        self._logger = logger

    def add(self, kind: str, error: ValueError) -> None:
        """Count a refused message of a kind, e.g. 'sheep'."""
        if kind not in self.counts:
            self._logger.warning(f'refused a message ({kind}): {error}; further ones are counted')
        self.counts[kind] = self.counts.get(kind, 0) + 1
