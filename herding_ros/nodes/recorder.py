# SPDX-License-Identifier: Apache-2.0
"""The recorder node: every topic of the graph, as it is on the wire, into a rosbag2 bag.

A lockstep run brings 10,000 messages a second, too many for rclpy's executor. So that serves
timers, services and parameters alone, and 50 times a second the recorder empties its
subscriptions.
"""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import sys
import time
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from herding_ros import __version__
from herding_ros.bag.metadata import advice
from herding_ros.bag.writer import BagWriter, NewTopic
import rclpy
from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from std_srvs.srv import Trigger

from . import command_line
from .herding_node import HerdingNode
from .log_clock import LogClock, rewritten
from .middleware import start_ros
from .mismatches import Mismatches
from .parameter_query import ParameterQueries
from .parameters import declare
from .publishing import CLOCK, CountingPublisher, EVERY_MESSAGE, full_name
from .recorded_topics import RecordedTopics
from .refusals import Refused
from .settings import RecorderSettings
from .signals import ignore_signals, note_signals, Noted
from .tap import Received
from .wire import seconds_and_rest

TAKE_PERIOD = 0.02
"""Time between two rounds over the subscriptions [s]."""

GRAPH_PERIOD = 0.1
"""Time between two searches of the graph for new topics, publishers and nodes [s]."""

DIAGNOSTICS_PERIOD = 1.0
"""Time between two messages on /diagnostics [s]."""

FLUSH_PERIOD = 0.05
"""Time after which messages are handed to the operating system [s].

With `TAKE_PERIOD` before it and a round in which it falls due, a kill costs less than 0.1 s.
"""

CLOCK_PATIENCE = 5.0
"""Time after which a clock that has not come is missed [s]."""

_MOST_GONE = 100
"""Nodes whose parameters are kept although they are gone.

Metadata that grow with each node that passes by would become more than `report` reads.
"""

SHARED = ('/diagnostics', '/rosout', '/parameter_events')
"""Topics that nodes of all namespaces share, besides the clock; each message names its node."""

LAST_MESSAGES = 0.05
"""Time in which messages published before the end arrive [s]."""


_UNTIL_CLOCK = (
    'log times are wall time until then; start what publishes it, or set use_sim_time to false'
)


class Recorder(HerdingNode):
    """Records topics into a bag from the moment they appear.

    When the disk refuses, it closes the bag and goes on as if paused, for good: publishers do not
    notice, /diagnostics says it.
    """

    bag: BagWriter

    def __init__(self) -> None:
        super().__init__('recorder')
        settings = RecorderSettings(bag=time.strftime('bag_%Y_%m_%d-%H_%M_%S'))
        self._settings = declare(self, settings)
        self._chosen = {topic for topic in self._settings.topics if topic}
        self._clock_topic = self.resolve_topic_name(CLOCK)
        self._shared = {self.resolve_topic_name(topic) for topic in (CLOCK, *SHARED)}
        self._topics = RecordedTopics(self, self._is_wanted, self._add_topic)
        self._queries = ParameterQueries(self, self._is_within)
        self._parameters_of: dict[str, dict[str, Any]] = {}
        self._log_clock = LogClock()
        self._bytes = 0
        self._lost = 0
        self._begun = time.monotonic()
        self._is_clock_missed = False
        self._paused = False
        self._failure = ''  # why nothing is written any more
        self._diagnostics = self.create_publisher(
            DiagnosticArray, '/diagnostics', EVERY_MESSAGE, publisher_class=CountingPublisher
        )
        # What it subscribes to follows what others offer.
        self._mismatches = Mismatches(self, subscriptions=False)
        self.create_service(Trigger, '~/pause', self._on_pause)
        self.create_service(Trigger, '~/resume', self._on_resume)

    def create_bag(self) -> None:
        """Create the bag; raises what `BagWriter` raises."""
        self.bag = self._create_bag()

    def _create_bag(self) -> BagWriter:
        settings = self._settings
        max_duration_ns = settings.max_bag_duration * 1_000_000_000
        return BagWriter(
            Path(settings.bag).expanduser(),
            self._custom_data(),
            settings.max_bag_size,
            max_duration_ns,
        )

    def record(self, stop: Noted) -> bool:
        """Record into the bag until stop is set, and close it.

        Returns whether all could be written.
        """
        wall = Clock(clock_type=ClockType.STEADY_TIME)  # goes on while the sim's clock stands
        self.create_timer(GRAPH_PERIOD, self._search_graph, clock=wall)
        self.create_timer(DIAGNOSTICS_PERIOD, self._publish_diagnostics, clock=wall)
        executor = SingleThreadedExecutor()
        executor.add_node(self)
        self._search_graph()
        flushed = time.monotonic()
        while not stop.is_set():
            time.sleep(TAKE_PERIOD)
            executor.spin_once(timeout_sec=0.0)
            self._write(self._topics.take())
            if time.monotonic() > flushed + FLUSH_PERIOD:
                flushed = time.monotonic()
                self._attempt(self.bag.flush)
        time.sleep(LAST_MESSAGES)
        self._write(self._topics.take_last())
        self._count_lost()
        self._attempt(self.bag.close)
        return not self._failure

    def _attempt(self, write: Callable[[], None]) -> None:
        """Do something to the bag; the first time that the disk refuses is the end of it."""
        if self._failure:
            return
        try:
            write()
        except OSError as error:
            self._failure = error.strerror or str(error)
            try:
                self.bag.close()
                rest = f'the {self.bag.message_count} messages until now are a complete bag'
            except OSError:
                rest = f'the bag is not complete: {advice(self.bag.path)}'
            self.get_logger().fatal(f'stopped recording into {self.bag.path}: {error}; {rest}')

    def _on_pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._write(self._topics.take())  # what came before
        self._paused = True
        return self._reply(response)

    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._write(self._topics.take())  # so that it is passed over
        self._paused = False
        return self._reply(response)

    def _reply(self, response: Trigger.Response) -> Trigger.Response:
        response.success = not self._failure
        response.message = self._state
        return response

    @property
    def _state(self) -> str:
        if self._failure:
            return f'stopped: {self._failure}'
        state = 'paused' if self._paused else 'recording'
        return f'{state}, {self._without_clock}' if self._lacks_clock else state

    def _search_graph(self) -> None:
        self._topics.discover()
        if answers := self._queries.answers():
            self._parameters_of.update(answers)
            gone = [name for name in self._parameters_of if name not in self._queries.names]
            for name in gone[_MOST_GONE:]:  # the nodes of a run mostly come first
                del self._parameters_of[name]
            self._keep_custom_data()

    def _is_wanted(self, topic: str) -> bool:
        # In a simulation the log times are the clock's, so it is wanted in any case.
        if self._chosen:
            return topic in self._chosen or (topic == self._clock_topic and self._in_simulation)
        return self._is_within(topic) or topic in self._shared

    def _is_within(self, name: str) -> bool:
        """Whether a topic or node is in this node's namespace, or in one below it."""
        return name.startswith(full_name(self.get_namespace(), ''))

    @property
    def _in_simulation(self) -> bool:
        clock = self.get_clock()
        return isinstance(clock, ROSClock) and clock.ros_time_is_active

    @property
    def _lacks_clock(self) -> bool:
        """Whether the simulation's clock should have come by now."""
        late = time.monotonic() > self._begun + CLOCK_PATIENCE
        return late and self._in_simulation and not self._log_clock.is_known

    @property
    def _without_clock(self) -> str:
        return f'use_sim_time is true, but nothing has come on {self._clock_topic}'

    def _keep_custom_data(self) -> None:
        self._attempt(lambda: self.bag.set_custom_data(self._custom_data()))

    def _custom_data(self) -> dict[str, str]:
        return {
            'herding_ros_version': __version__,
            'parameters': json.dumps(self._parameters_of, sort_keys=True, default=list),
            'messages_lost': str(self._lost),
        }

    def _count_lost(self) -> None:
        if lost := self._topics.take_lost():
            self._lost += lost
            self._keep_custom_data()

    def _add_topic(self, topic: NewTopic) -> None:
        self._attempt(lambda: self.bag.add_topic(*topic))

    def _write(self, received: list[Received]) -> None:
        """Write messages, unless paused.

        Their log time is when they came in, by the simulation's clock if any. What comes before
        the first /clock gets the time of the latter, however long it takes; until then it has
        wall time.
        """
        self._attempt(lambda: self._write_in_time(received))

    def _write_in_time(self, received: list[Received]) -> None:
        in_simulation = self._in_simulation
        for message in received:
            if in_simulation and message.topic == self._clock_topic:
                self._follow_clock(message)
            if not self._paused:
                self._write_message(message)

    def _write_message(self, message: Received) -> None:
        log_ns = self._log_clock.log_time(message.receive_ns)
        try:
            self.bag.write(message.topic, message.data, log_ns, message.publish_ns)
            self._bytes += len(message.data)
        except ValueError as error:
            self._refused.add(message.topic, error)

    def _follow_clock(self, message: Received) -> None:
        is_first = not self._log_clock.is_known
        try:
            self._log_clock.follow(message.data)
        except Refused as error:
            self._refused.add(self._clock_topic, error)  # as a clock: it is recorded
            return
        if is_first and self.bag.message_count:
            log_ns = self._log_clock.log_time(message.receive_ns)
            self.bag = rewritten(self.bag, self._create_bag, log_ns)

    def _publish_diagnostics(self) -> None:
        self._count_lost()
        mismatched = self._mismatches.report_values()
        values = {
            'bag': self.bag.path,
            'files': self.bag.file_count,
            'topics': len(self._topics),
            'messages': self.bag.message_count,
            'bytes': self._bytes,
            'lost': self._lost,
            'parameters_of': ' '.join(sorted(self._parameters_of)),
            **self._refused.report_values(),
            **mismatched,
        }
        if self._lacks_clock and not self._is_clock_missed:
            self._is_clock_missed = True
            self.get_logger().warning(f'{self._without_clock}: {_UNTIL_CLOCK}')
        good = not (self._refused.counts or mismatched or self._lacks_clock)
        level = DiagnosticStatus.OK if good else DiagnosticStatus.WARN
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if self._lost or self._failure else level,
            name=self.status_name('bag'),
            message=self._state + (f', {self._lost} messages lost' if self._lost else ''),
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        # A stranger's clock may show times that fit into no stamp.
        sec, nanosec = seconds_and_rest(self.get_clock().now().nanoseconds)
        message.header.stamp = Time(sec=sec, nanosec=nanosec)
        self._diagnostics.publish(message)


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM, or print help.

    Returns 0, 2 when the node cannot start or the bag not be created, 1 when the bag could be
    written no more.
    """
    command_line.read('recorder', args)
    # An exception raised by a signal could break a message in two, so there is none.
    stop = note_signals()
    try:
        start_ros(args)
        recorder = Recorder()
    except (ParameterException, RuntimeError, ValueError, rclpy_implementation.RCLError) as error:
        print(f'cannot start: {error}', file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    try:
        return _record(recorder, stop)
    finally:
        recorder.destroy_node()
        rclpy.try_shutdown()
        ignore_signals()


def _record(recorder: Recorder, stop: Noted) -> int:
    """Record into a new bag; returns the exit code."""
    log = recorder.get_logger()
    try:
        recorder.create_bag()
    except OSError as error:
        log.fatal(str(error))
        return 2
    log.info(f'recording into {recorder.bag.path}')
    try:
        complete = recorder.record(stop)
    finally:
        recorder.bag.close()
    bag = recorder.bag
    log.info(
        f'recorded {bag.message_count} messages of {len(bag.topics)} topics, '
        f'{bag.size / 1e6:.1f} MB, in {bag.path}'
    )
    return 0 if complete else 1


if __name__ == '__main__':
    sys.exit(main())
