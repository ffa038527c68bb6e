"""How every node of ours starts, waits for its listeners and ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import os
from pathlib import Path
import signal
import sys
import threading
import time
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from .topic_qos import asks_more

CLOCK = '/clock'
"""The topic that tells the time of a simulation."""

LOCKSTEP_TURN = 0.02
"""Time for which a node in lockstep only answers, before it looks at everything else [s]."""

EVERY_MESSAGE = QoSProfile(depth=1000)
"""Reliable, with room for what a slow listener has not taken yet."""

ADJUSTABLE = QoSOverridingOptions.with_default_policies()
"""Lets users change reliability and depth by parameters, for robots on a radio link."""

UNWATCHED = PublisherEventCallbacks(use_default_callbacks=False)
"""No events: the executor would look at two for every publisher each time it wakes."""


class CountingPublisher(Publisher):
    """A publisher that knows how many messages it has published."""

    count = 0

    def publish(self, msg: Any) -> None:
        """Publish and count."""
        super().publish(msg)
        self.count += 1


_FAREWELL = 1.0
"""Time in which the last messages are delivered before a node goes [s]."""


def start_ros(args: list[str] | None = None) -> None:
    """Initialise rclpy; signals are left to the caller.

    Fast DDS reads our settings, unless the user has some: they change how often a node says
    that it is there, and nothing about how others talk with it.
    """
    settings = str(Path(__file__).with_name('fastdds.xml'))
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', settings)
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)


def run(make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """Spin a node until SIGINT or SIGTERM, and let its last messages arrive.

    Returns the exit code: 0, or 2 when the node was started with a parameter that is not
    allowed (ValueError), which is printed and nothing else.
    """
    start_ros(args)
    ended = Future()
    _on_signal(lambda: ended.set_result(None))
    try:
        node = make_node()
    except ValueError as error:
        print(f'cannot start: {error}', file=sys.stderr)
        rclpy.shutdown()
        return 2
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.spin_until_future_complete(ended)
    published = [p for p in node.publishers if isinstance(p, CountingPublisher) and p.count]
    counts = ', '.join(f'{p.count} on {p.topic_name}' for p in published)
    node.get_logger().info(f'published {counts or "nothing"}')
    deadline = time.monotonic() + _FAREWELL
    # Busy topics first: they are acknowledged at once, quiet ones with the next heartbeat.
    for publisher in sorted(published, key=lambda p: -p.count):
        remaining = max(deadline - time.monotonic(), 0.0)
        publisher.wait_for_all_acked(Duration(nanoseconds=int(remaining * 1e9)))
    node.destroy_node()
    rclpy.shutdown()
    return 0


def _on_signal(act: Callable[[], None]) -> None:
    """Call act, in a thread of its own, at the first SIGINT or SIGTERM.

    Python's handlers run only when the executor wakes up, and rclpy's shut the context down
    under the last messages. The byte that Python writes at once wakes a thread instead.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: None)

    def wait() -> None:
        os.read(reading, 1)
        act()

    threading.Thread(target=wait, daemon=True).start()


def is_heard(node: Node, publishers: Iterable[Publisher], listener: str) -> bool:
    """Whether the node named `listener` and all other subscribers are matched by publishers.

    Subscribers that ask for more than a publisher offers never will be, and do not count. Nor
    does it count as listening when rclpy itself looks at the time, with a lower reliability.
    """
    for publisher in publishers:
        subscribers = [
            info
            for info in node.get_subscriptions_info_by_topic(publisher.topic_name)
            if not asks_more(info.qos_profile, publisher.qos_profile)
        ]
        listeners = {
            info.node_name
            for info in subscribers
            if publisher.topic_name != CLOCK
            or info.qos_profile.reliability == publisher.qos_profile.reliability
        }
        if listener not in listeners:
            return False
        if publisher.get_subscription_count() < len(subscribers):
            return False
    return True
