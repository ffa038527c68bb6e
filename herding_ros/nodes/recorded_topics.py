# SPDX-License-Identifier: Apache-2.0
"""The topics of the graph that are recorded, each from the moment it appears."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from operator import attrgetter
import time
from typing import Any

from herding_ros.bag.definitions import message_definition
from herding_ros.bag.writer import NewTopic
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

from .graph import Looks
from .inbox import MOST_AT_ONCE
from .tap import Received, Tap
from .topic_qos import adapted_qos, asks_more, is_same, qos_map

DEPTH = 1_000_000
"""Messages that a subscription holds between two rounds: more than the longest delay brings.

Room is taken when they come in. What does not fit is dropped without a word.
"""


OVERLAP = 1.0
"""Time in which a new subscription is matched, while the one that it replaces goes on [s]."""


_MOST_SEEN = 1000
"""Messages that are remembered, since they may come again, while no publisher is known."""


class RecordedTopics:
    """Subscriptions to the topics that `is_wanted` accepts; `add` is called for each new one.

    A topic is subscribed to as soon as somebody publishes it or subscribes to it, since a
    publisher may send a single message and end at once; it is new when it has a publisher or a
    message. A subscription is replaced without a gap.
    """

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
        self._followed: dict[str, _Followed] = {}
        self._looks = Looks()
        self._reported: set[tuple[str, ...]] = set()  # topics and types that were warned of
        self._for_next_round: list[Received] = []
        self._lost = 0  # since the last take_lost()

    def __len__(self) -> int:
        return sum(topic.is_added for topic in self._followed.values())

    def discover(self) -> None:
        """Follow new topics and publishers."""
        topics = self._node.get_topic_names_and_types()
        names = [name for name, _ in topics if self._is_wanted(name)]
        for name in self._looks.due({name: self._count_ends(name) for name in names}):
            self._follow(name)

    def _count_ends(self, name: str) -> tuple[int, int]:
        """Return how many publishers a topic has, and how many subscribers if it has none."""
        publishers = self._node.count_publishers(name)
        return publishers, 0 if publishers else self._node.count_subscribers(name)

    def take(self) -> list[Received]:
        """Return what has come in before now, in that order.

        Subscriptions are emptied one after the other. What comes in meanwhile has to wait, or a
        /clock would be known before messages that came in ahead of it.
        """
        now_ns = time.time_ns()
        taken = [message for topic in self._followed.values() for message in self._take(topic)]
        received = [*self._for_next_round, *(m for m in taken if m.receive_ns <= now_ns)]
        self._for_next_round = [m for m in taken if m.receive_ns > now_ns]
        received.sort(key=attrgetter('receive_ns'))
        return received

    def take_last(self) -> list[Received]:
        """Return what has come in and is still to be taken."""
        received = self.take()
        while any(topic.is_behind for topic in self._followed.values()):
            received += self.take()
        last, self._for_next_round = self._for_next_round, []
        return received + last

    def take_lost(self) -> int:
        """Return how many messages the middleware has lost since the last call, and log it."""
        for topic in self._followed.values():
            self._count_lost(topic.tap)
        lost, self._lost = self._lost, 0
        return lost

    def _count_lost(self, tap: Tap) -> None:
        if lost := tap.take_lost():
            self._lost += lost
            self._log.error(f'{lost} messages of {tap.topic} were lost')

    def _take(self, topic: _Followed) -> list[Received]:
        received = topic.take()
        if received and not topic.is_added:
            publishers = self._node.get_publishers_info_by_topic(topic.tap.topic)
            self._add_topic(topic, publishers)  # none, if it is gone again
        return received

    def _follow(self, name: str) -> None:
        """Subscribe to a new topic, or again to one whose publishers offer something else."""
        topic = self._followed.get(name)
        publishers = self._node.get_publishers_info_by_topic(name)
        if not publishers:
            self._follow_subscribers(name, topic)
            return
        types = sorted({publisher.topic_type for publisher in publishers})
        if len(types) > 1 or (topic is not None and topic.is_added and types != [topic.type]):
            what = 'it is not recorded'
            if topic is not None and topic.is_added:
                what = f'it is recorded as {topic.type} alone'
                publishers = [each for each in publishers if each.topic_type == topic.type]
            self._warn_once(
                (name, 'several', *types),
                f'{name} has several types, {", ".join(types)}: {what}; a topic must have one',
            )
            if topic is None or not topic.is_added or not publishers:
                return
        qos = adapted_qos(publishers, DEPTH)
        if topic is not None and topic.type != publishers[0].topic_type:  # it has had no message
            self._forget(name)
            topic = None
        if topic is None:
            topic = self._subscribe(name, publishers[0].topic_type, qos)
            if topic is None:
                return
        elif topic.is_provisional and not is_same(topic.tap.qos, qos):
            self._replace(topic, qos)
        elif asks_more(topic.tap.qos, qos):
            self._log.warning(
                f'a new publisher of {name} offers less than the others: '
                f'subscribing anew as {qos.reliability.name}, {qos.durability.name}'
            )
            self._replace(topic, qos)
        topic.is_provisional = False
        if not topic.is_added:
            self._add_topic(topic, publishers)

    def _follow_subscribers(self, name: str, topic: _Followed | None) -> None:
        """Subscribe, as others do, to a topic that nobody publishes: so it gets what they get."""
        if topic is not None and topic.is_added:
            return
        me = self._node.get_name(), self._node.get_namespace()
        others = [
            each
            for each in self._node.get_subscriptions_info_by_topic(name)
            if (each.node_name, each.node_namespace) != me
        ]
        types = {each.topic_type for each in others}
        if topic is not None and topic.type not in types:
            self._forget(name)
        elif topic is None and len(types) == 1:
            self._subscribe(name, types.pop(), adapted_qos(others, DEPTH))

    def _subscribe(self, name: str, type_name: str, qos: QoSProfile) -> _Followed | None:
        if (name, type_name) in self._reported:
            return None
        try:
            definition = message_definition(type_name)
            tap = Tap(self._node, name, _message_type(type_name), qos)
        except Exception as error:  # whatever comes from a package that is not ours
            self._warn_once((name, type_name), f'{name} is not recorded: {error}')
            return None
        self._followed[name] = _Followed(tap, type_name, definition)
        return self._followed[name]

    def _replace(self, topic: _Followed, qos: QoSProfile) -> None:
        self._count_lost(topic.tap)
        topic.replace(Tap(self._node, topic.tap.topic, topic.tap.message_type, qos))

    def _add_topic(self, topic: _Followed, publishers: Sequence[TopicEndpointInfo]) -> None:
        topic.is_added = True
        name = topic.tap.topic
        # There is a subscriber of this type in any case: ourselves.
        ends = [*publishers, *self._node.get_subscriptions_info_by_topic(name)]
        type_hash = next(str(end.topic_type_hash) for end in ends if end.topic_type == topic.type)
        profiles = [qos_map(publisher.qos_profile) for publisher in publishers]
        self._add(NewTopic(name, topic.type, topic.definition, profiles, type_hash))
        self._log.debug(f'recording {name} [{topic.type}]')

    def _forget(self, name: str) -> None:
        self._followed.pop(name).tap.destroy()

    def _warn_once(self, key: tuple[str, ...], text: str) -> None:
        if key not in self._reported:
            self._reported.add(key)
            self._log.warning(text)


class _Followed:
    """A topic with its subscription, and for a while those that it has replaced.

    `is_provisional`: no publisher was known when it was subscribed to; `is_behind`: there may be
    more than the last `take()` returned.
    """

    def __init__(self, tap: Tap, type_name: str, definition: str) -> None:
        self.tap = tap
        self.type = type_name
        self.definition = definition
        self.is_added = False
        self.is_provisional = True
        self.is_behind = False
        self._replaced: list[Tap] = []
        self._replaced_at = 0.0
        self._seen: set[tuple[int, bytes]] = set()  # what may come in once more

    def take(self) -> list[Received]:
        """Return what has come in, each message once."""
        taken = [tap.take() for tap in (*self._replaced, self.tap)]
        received = [message for each in taken for message in each]
        self.is_behind = any(len(each) == MOST_AT_ONCE for each in taken)
        if self._replaced or self.is_provisional:
            received = self._new_of(received)
        is_matched = time.monotonic() > self._replaced_at + OVERLAP
        if self._replaced and is_matched and not self.is_behind:
            for tap in self._replaced:
                tap.destroy()
            self._replaced.clear()
            self._seen.clear()
        return received

    def replace(self, tap: Tap) -> None:
        """Go on with another subscription, beside the present one until it is matched."""
        self._replaced.append(self.tap)
        self._replaced_at = time.monotonic()
        self.tap = tap

    def _new_of(self, received: list[Received]) -> list[Received]:
        new = []
        if len(self._seen) > _MOST_SEEN and not self._replaced:
            self._seen.clear()
        for message in received:
            key = message.publish_ns, message.data
            # The same message has the same time, unless its publisher gives none.
            if key not in self._seen or not message.publish_ns:
                new.append(message)
                self._seen.add(key)
        return new


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
