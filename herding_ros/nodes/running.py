"""How every node of ours starts, waits for its listeners and ends."""

from __future__ import annotations

import atexit
from collections.abc import Callable, Iterable
from functools import partial
import os
from pathlib import Path
import signal
import sys
import threading
import time
import traceback
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from .parameters import HerdingNode
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


_TURN = 0.2
"""Time after which a node that has nothing to do looks whether it shall end [s]."""

_FAREWELL = 1.0
"""Time in which the last messages are delivered before a node goes [s]."""


def use_our_profiles() -> None:
    """Let Fast DDS read our settings (fastdds.xml, which says why), unless the user has some.

    Nodes with and without them talk with each other.
    """
    settings = str(Path(__file__).with_name('fastdds.xml'))
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', settings)


def start_ros(args: list[str] | None = None) -> None:
    """Initialise rclpy; signals are left to the caller."""
    use_our_profiles()
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)


class CannotGoOnError(Exception):
    """Raised in a callback by a node that cannot go on; its text says why."""


def run(make_node: Callable[[], HerdingNode], args: list[str] | None = None) -> int:
    """Spin a node until SIGINT or SIGTERM, and let its last messages arrive.

    Returns the exit code: 0; 2 when the node cannot start (ValueError) or go on
    (CannotGoOnError), whose reason is said; 1 after any other exception, with its traceback.
    """
    code = _run(make_node, args)
    # It takes Python a second to free the kernels, and nothing is left to be saved.
    atexit.register(_exit_at_once, code)
    return code


def _run(make_node: Callable[[], HerdingNode], args: list[str] | None) -> int:
    signals = _Signals()
    try:
        start_ros(args)
        node = make_node()
    except (ValueError, ParameterException, _rclpy.RCLError) as error:
        print(f'cannot start: {error}', file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    ended = Future()

    def end() -> None:
        node.stop()
        ended.set_result(None)

    signals.call(end)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    code = 0
    try:
        while not ended.done():  # spin_until_future_complete keeps something of every turn
            executor.spin_once(timeout_sec=_TURN)
    except CannotGoOnError as reason:
        node.get_logger().fatal(f'ending: {reason}')
        code = 2
    except Exception:
        node.get_logger().fatal(f'ending: {traceback.format_exc()}')
        code = 1
    _say_farewell(node)
    node.destroy_node()
    rclpy.shutdown()
    ignore_signals()
    return code


def ignore_signals() -> None:
    """Let no further signal show in the exit code, as Python gives them their default back."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _say_farewell(node: Node) -> None:
    """Log what was published, and wait until it is acknowledged."""
    published = [p for p in node.publishers if isinstance(p, CountingPublisher) and p.count]
    counts = ', '.join(f'{p.count} on {p.topic_name}' for p in published)
    node.get_logger().info(f'published {counts or "nothing"}')
    deadline = time.monotonic() + _FAREWELL
    # Busy topics first: they are acknowledged at once, quiet ones with the next heartbeat.
    for publisher in sorted(published, key=lambda p: -p.count):
        remaining = max(deadline - time.monotonic(), 0.0)
        publisher.wait_for_all_acked(Duration(nanoseconds=int(remaining * 1e9)))


class _Signals:
    """SIGINT and SIGTERM: end the process with exit code 0, until there is something to call.

    Python's handlers run only when the main thread comes to it, and rclpy's shut the context
    down under the last messages. The byte that Python writes at once wakes a thread instead.
    """

    def __init__(self) -> None:
        # While the node is made, kernels may be compiling, and nobody has heard of it.
        self._act: Callable[[], None] = partial(_exit_at_once, 0)
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: None)

        def wait() -> None:
            os.read(reading, 1)
            self._act()

        threading.Thread(target=wait, daemon=True).start()

    def call(self, act: Callable[[], None]) -> None:
        """Call act, in a thread of its own, at the first signal."""
        self._act = act


def _exit_at_once(code: int) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


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
