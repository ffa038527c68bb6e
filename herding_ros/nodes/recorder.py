"""The recorder node: every topic of the graph, as it is on the wire, into a rosbag2 bag.

A lockstep run brings 10,000 messages a second, too many for rclpy's executor. So that serves
timers and parameters alone, and 50 times a second the recorder empties its subscriptions.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
import json
from operator import attrgetter
from pathlib import Path
import signal
import sys
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor
import rclpy
from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock as ClockMessage

from .. import __version__
from ..bag.definitions import message_definition
from ..bag.writer import BagWriter
from .parameter_query import ParameterQuery
from .running import CLOCK, start_ros
from .tap import Received, Tap
from .topic_qos import adapted_qos, asks_more, qos_map

TAKE_PERIOD = 0.02
"""Time between two rounds over the subscriptions [s]."""

GRAPH_PERIOD = 0.1
"""Time between two looks at the graph for new topics, publishers and nodes [s]."""

DIAGNOSTICS_PERIOD = 1.0
"""Time between two messages on /diagnostics [s]."""

LAST_MESSAGES = 0.05
"""Time in which messages published before the end arrive [s]."""

DEPTH = 10_000
"""Messages that a subscription holds between two rounds: by far more than a burst brings."""


class Recorder(Node):
    """Records topics into a bag from the moment they appear."""

    _bag: BagWriter

    def __init__(self) -> None:
        super().__init__('recorder')
        self.bag_path = Path(
            self._declare(
                'bag',
                time.strftime('bag_%Y_%m_%d-%H_%M_%S'),
                'Folder of the bag, created at start; it must not exist.',
            )
        )
        topics = self._declare(
            'topics', [''], 'Full names of the topics to record; none, or an empty one: all.'
        )
        self._chosen = {topic for topic in topics if topic}
        self._taps: dict[str, Tap] = {}
        self._told: set[str] = set()  # topics that cannot be recorded, or not all of them
        self._queries: dict[str, ParameterQuery] = {}
        self._parameters_of: dict[str, dict[str, Any]] = {}
        self._waiting: list[Received] = []  # for the first /clock
        self._clock_ns: int | None = None  # the last /clock
        self._sim_time_ns = 0
        self._bytes = 0
        self._lost = 0
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def _declare(self, name: str, default: Any, description: str) -> Any:
        descriptor = ParameterDescriptor(description=description, read_only=True)
        return self.declare_parameter(name, default, descriptor).value

    def record(self, bag: BagWriter, stop: threading.Event) -> None:
        """Record into the bag until stop is set.

        Raises OSError when the bag can be written no more.
        """
        self._bag = bag
        bag.set_custom_data(self._custom_data())
        wall = Clock(clock_type=ClockType.STEADY_TIME)  # goes on while the sim's clock stands
        self.create_timer(GRAPH_PERIOD, self._look_at_graph, clock=wall)
        self.create_timer(DIAGNOSTICS_PERIOD, self._publish_diagnostics, clock=wall)
        executor = SingleThreadedExecutor()
        executor.add_node(self)
        self._look_at_graph()
        while not stop.is_set():
            time.sleep(TAKE_PERIOD)
            executor.spin_once(timeout_sec=0.0)
            self._write(self._take_all())
        time.sleep(LAST_MESSAGES)
        self._write(self._take_all(), last=True)
        self._count_lost()

    def _look_at_graph(self) -> None:
        for topic, types in self.get_topic_names_and_types():
            if topic not in self._told and self._is_wanted(topic):
                self._follow(topic, types)
        for name, namespace in self.get_node_names_and_namespaces():
            full_name = f'{namespace.rstrip("/")}/{name}'
            if full_name not in self._parameters_of and full_name not in self._queries:
                self._queries[full_name] = ParameterQuery(self, full_name)
        for full_name, query in list(self._queries.items()):
            query.advance()
            if query.values is not None:
                self._parameters_of[full_name] = query.values
                self._queries.pop(full_name).destroy()
                self._bag.set_custom_data(self._custom_data())

    def _is_wanted(self, topic: str) -> bool:
        # In a simulation the log times are the clock's, so it is wanted in any case.
        is_clock = topic == CLOCK and self._in_simulation
        return not self._chosen or topic in self._chosen or is_clock

    @property
    def _in_simulation(self) -> bool:
        clock = self.get_clock()
        return isinstance(clock, ROSClock) and clock.ros_time_is_active

    def _custom_data(self) -> dict[str, str]:
        return {
            'herding_ros_version': __version__,
            'parameters': json.dumps(self._parameters_of, sort_keys=True, default=list),
        }

    def _follow(self, topic: str, types: Sequence[str]) -> None:
        """Subscribe to a new topic, or anew to one whose new publisher offers less."""
        publishers = self.get_publishers_info_by_topic(topic)
        if not publishers:
            return
        tap = self._taps.get(topic)
        if len(types) > 1:
            self._told.add(topic)
            what = 'is not recorded' if tap is None else 'is recorded as the first that was there'
            self.get_logger().warning(f'{topic} has several types, {", ".join(types)}: it {what}')
            return
        qos = adapted_qos(publishers, DEPTH)
        if tap is None:
            try:
                message_type = _message_type(types[0])
                definition = message_definition(types[0])
            except ValueError as error:
                self._told.add(topic)
                self.get_logger().warning(f'{topic} is not recorded: {error}')
                return
            self._bag.add_topic(
                topic,
                types[0],
                definition,
                [qos_map(publisher.qos_profile) for publisher in publishers],
                str(publishers[0].topic_type_hash),
            )
            self._taps[topic] = Tap(self, topic, message_type, qos)
            self.get_logger().debug(f'recording {topic} [{types[0]}]')
        elif asks_more(tap.qos, qos):
            self.get_logger().warning(
                f'a new publisher of {topic} offers less than the others: '
                f'subscribing anew as {qos.reliability.name}, {qos.durability.name}'
            )
            self._taps[topic] = Tap(self, topic, tap.message_type, qos)
            self._write(tap.take())
            tap.destroy()

    def _take_all(self) -> list[Received]:
        # The clock last: whatever has come in before is then of a time that is known.
        taps = sorted(self._taps.values(), key=lambda tap: tap.topic == CLOCK)
        received = [message for tap in taps for message in tap.take()]
        received.sort(key=attrgetter('publish_ns'))
        return received

    def _write(self, received: list[Received], last: bool = False) -> None:
        """Write messages. Their log time is when they came in, by the simulation's clock if any.

        What comes before the first /clock gets the time of the latter, however long it takes.
        """
        self._waiting += received
        if self._in_simulation and self._clock_ns is None:
            clock = next((message for message in self._waiting if message.topic == CLOCK), None)
            if clock is not None:
                self._clock_ns = self._sim_time_ns = _clock_ns(clock.data)
            elif not last:
                return
        log_ns = 0
        for message in self._waiting:
            if self._clock_ns is None:
                log_ns = max(log_ns, message.receive_ns)
            else:
                if message.topic == CLOCK:
                    self._follow_clock(_clock_ns(message.data))
                log_ns = self._sim_time_ns
            self._bag.write(message.topic, message.data, log_ns, message.publish_ns)
            self._bytes += len(message.data)
        self._waiting.clear()

    def _follow_clock(self, clock_ns: int) -> None:
        # A reset of the simulation takes its clock back; a bag whose times went back as well
        # would play both runs at once.
        if self._clock_ns is not None:
            self._sim_time_ns += max(clock_ns - self._clock_ns, 0)
        self._clock_ns = clock_ns

    def _count_lost(self) -> None:
        for topic, tap in self._taps.items():
            lost = tap.take_lost()
            if lost:
                self._lost += lost
                self.get_logger().error(f'{lost} messages of {topic} were lost')

    def _publish_diagnostics(self) -> None:
        self._count_lost()
        values = {
            'bag': self._bag.path,
            'topics': len(self._taps),
            'messages': self._bag.message_count,
            'bytes': self._bytes,
            'lost': self._lost,
        }
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if self._lost else DiagnosticStatus.OK,
            name='recorder: bag',
            message=f'{self._lost} messages lost' if self._lost else 'recording',
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Returns 0, 2 when the bag cannot be created, 1 when it can be written no more.
    """
    # An exception raised by a signal could break a message in two, so there is none: the
    # handler only asks to stop.
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    start_ros(args)
    recorder = Recorder()
    log = recorder.get_logger()
    try:
        try:
            bag = BagWriter(recorder.bag_path)
        except OSError as error:
            log.fatal(str(error))
            return 2
        log.info(f'recording into {bag.path}')
        try:
            with bag:
                recorder.record(bag, stop)
        except OSError as error:
            log.fatal(f'stopped recording into {bag.path}: {error}')
            return 1
        log.info(
            f'recorded {bag.message_count} messages of {len(bag.topics)} topics, '
            f'{bag.size / 1e6:.1f} MB, in {bag.path}'
        )
        return 0
    finally:
        recorder.destroy_node()
        rclpy.try_shutdown()


def _message_type(name: str) -> Any:
    """Return the class of a type; ValueError when it cannot be imported."""
    try:
        package, kind, name = name.split('/')
        return getattr(import_module(f'{package}.{kind}'), name)
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f'its type cannot be imported ({error}); source the workspace that provides it'
        ) from error


def _clock_ns(data: bytes) -> int:
    """Return the time [ns] in a serialised /clock message."""
    clock = deserialize_message(data, ClockMessage).clock
    return max(int(clock.sec) * 1_000_000_000 + int(clock.nanosec), 0)


if __name__ == '__main__':
    sys.exit(main())
