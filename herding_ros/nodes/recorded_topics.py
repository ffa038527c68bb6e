# SPDX-License-Identifier: Apache-2.0
"""The topics of the graph that are recorded, each from the moment it appears."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from operator import attrgetter
import time
from typing import Any, NamedTuple

from rclpy.node import Node

from ..bag.definitions import message_definition
from .tap import Received, Tap
from .topic_qos import adapted_qos, asks_more, qos_map

DEPTH = 10_000
"""Messages that a subscription holds between two rounds: by far more than a burst brings."""


class NewTopic(NamedTuple):
    """A topic that is recorded from now on, as `BagWriter.add_topic` takes it."""

    name: str
    type_name: str
    definition: str
    qos_profiles: Sequence[dict[str, Any]]
    type_hash: str


class RecordedTopics:
    """Subscriptions to the topics that `is_wanted` accepts; `add` is called for each new one."""

    def __init__(
        self,
        node: Node,
        is_wanted: Callable[[str], bool],
        add: Callable[[NewTopic], None],
    ) -> None:
        self._node = node
        self._log = node.get_logger()
        self._is_wanted = is_wanted
        self._add = add
        self._taps: dict[str, Tap] = {}
        self._left_out: set[str] = set()  # topics that cannot be recorded, or not all of them
        self._for_next_round: list[Received] = []

    def __len__(self) -> int:
        return len(self._taps)

    def discover(self) -> list[Received]:
        """Follow new topics and publishers; returns what ended subscriptions still held."""
        received: list[Received] = []
        for topic, types in self._node.get_topic_names_and_types():
            if topic not in self._left_out and self._is_wanted(topic):
                received += self._follow(topic, types)
        return received

    def take(self) -> list[Received]:
        """Return what has come in before now, in that order.

        Subscriptions are emptied one after the other. What comes in meanwhile has to wait, or a
        /clock would be known before messages that came in ahead of it.
        """
        now_ns = time.time_ns()
        taken = [message for tap in self._taps.values() for message in tap.take()]
        received = [*self._for_next_round, *(m for m in taken if m.receive_ns <= now_ns)]
        self._for_next_round = [m for m in taken if m.receive_ns > now_ns]
        received.sort(key=attrgetter('receive_ns'))
        return received

    def take_last(self) -> list[Received]:
        """Return what has come in and is still to be taken."""
        received = self.take()
        last, self._for_next_round = self._for_next_round, []
        return received + last

    def take_lost(self) -> int:
        """Return how many messages the middleware has lost since the last call, and log it."""
        total = 0
        for topic, tap in self._taps.items():
            if lost := tap.take_lost():
                total += lost
                self._log.error(f'{lost} messages of {topic} were lost')
        return total

    def _follow(self, topic: str, types: Sequence[str]) -> list[Received]:
        """Subscribe to a new topic, or again to one whose new publisher offers less."""
        publishers = self._node.get_publishers_info_by_topic(topic)
        if not publishers:
            return []
        tap = self._taps.get(topic)
        if len(types) > 1:
            self._left_out.add(topic)
            what = 'is not recorded' if tap is None else 'is recorded as the first that was there'
            self._log.warning(f'{topic} has several types, {", ".join(types)}: it {what}')
            return []
        qos = adapted_qos(publishers, DEPTH)
        if tap is None:
            try:
                definition = message_definition(types[0])
                self._taps[topic] = Tap(self._node, topic, _message_type(types[0]), qos)
            except Exception as error:  # whatever comes from a package that is not ours
                self._left_out.add(topic)
                self._log.warning(f'{topic} is not recorded: {error}')
                return []
            profiles = [qos_map(publisher.qos_profile) for publisher in publishers]
            type_hash = str(publishers[0].topic_type_hash)
            self._add(NewTopic(topic, types[0], definition, profiles, type_hash))
            self._log.debug(f'recording {topic} [{types[0]}]')
        elif asks_more(tap.qos, qos):
            self._log.warning(
                f'a new publisher of {topic} offers less than the others: '
                f'subscribing anew as {qos.reliability.name}, {qos.durability.name}'
            )
            self._taps[topic] = Tap(self._node, topic, tap.message_type, qos)
            received = tap.take()
            tap.destroy()
            return received
        return []


def _message_type(name: str) -> Any:
    """Return the class of a type; ValueError when it cannot be imported."""
    try:
        package, kind, name = name.split('/')
        if kind != 'msg':  # the name comes from the graph, and would be imported
            raise ImportError(f'{kind} must be msg')
        return getattr(import_module(f'{package}.{kind}'), name)
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f'its type cannot be imported ({error}); source the workspace that provides it'
        ) from error
