# SPDX-License-Identifier: Apache-2.0
"""Publishers and subscribers of other nodes that ours do not match: the middleware is silent.

Ours are all reliable, so that nothing is lost. A tracker that publishes best effort would not be
received at all; so subscriptions can follow what is offered. The rest is reported with a remedy.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from typing import NamedTuple, TYPE_CHECKING

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration, Infinite
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from .graph import Looks
from .inbox import Inbox
from .publishing import node_of
from .wire import type_name

if TYPE_CHECKING:
    from .settings import NodeSettings

CHECK_PERIOD = 1.0
"""Time between two searches of the graph [s]. What is found twice in a row is reported."""

_MOST_LOGGED = 100
"""A stranger may make up any number of nodes."""


class _Known(NamedTuple):
    """What does not match of a topic, and whether no end was just discovered, without a name."""

    mismatches: list[tuple[str, str]]
    is_all: bool


class Mismatches:
    """Who cannot hear a node or be heard by it: logged once, reported for as long as it lasts.

    `subscriptions`: whether those of the node are checked, too.
    """

    def __init__(self, node: Node, subscriptions: bool = True) -> None:
        self._node = node
        self._with_subscriptions = subscriptions
        self._inboxes: tuple[Inbox, ...] = ()
        self._looks, self._looks_to_follow = Looks(), Looks()
        self._known: dict[Publisher | Subscription, _Known] = {}
        self._found: dict[str, str] = {}
        self._lasting: dict[str, str] = {}
        self._logged: set[tuple[str, str]] = set()
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(CHECK_PERIOD, self.check, clock=wall)

    def follow(self, inboxes: Iterable[Inbox]) -> None:
        """Let these subscriptions become best effort where a publisher offers no more."""
        self._inboxes = tuple(inboxes)

    def report_values(self) -> dict[str, object]:
        """Return what was found for /diagnostics."""
        return {f'not matched: {key}': cause for key, cause in self._lasting.items()}

    def check(self) -> None:
        """Search the graph, follow what is offered, and log what is new."""
        count = self._node.count_publishers
        publishers = {inbox: count(inbox.subscription.topic_name) for inbox in self._inboxes}
        for inbox in self._looks_to_follow.due(publishers):
            self._follow(inbox)
        found = dict(self._search())
        self._lasting = {key: cause for key, cause in found.items() if key in self._found}
        self._found = found
        for item in self._lasting.items():
            if item not in self._logged and len(self._logged) < _MOST_LOGGED:
                self._logged.add(item)
                self._node.get_logger().warning(': '.join(item))

    def _follow(self, inbox: Inbox) -> None:
        subscription = inbox.subscription
        if subscription.qos_profile.reliability != ReliabilityPolicy.RELIABLE:
            return
        for other in self._node.get_publishers_info_by_topic(subscription.topic_name):
            if other.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
                self._node.get_logger().info(
                    f'{subscription.topic_name} is published best effort by {node_of(other)}: '
                    'subscribing likewise; what gets lost is not sent again'
                )
                inbox.become_best_effort()
                return

    def _search(self) -> Iterable[tuple[str, str]]:
        """Yield topic with node, and cause with remedy, of each mismatch."""
        node = self._node
        counts: dict[Publisher | Subscription, int] = {
            publisher: node.count_subscribers(publisher.topic_name)
            for publisher in node.publishers
        }
        for subscription in node.subscriptions if self._with_subscriptions else ():
            counts[subscription] = node.count_publishers(subscription.topic_name)
        due = set(self._looks.due(counts))
        known = self._known
        self._known = {
            ours: known[ours] if ours not in due and known[ours].is_all else self._look(ours)
            for ours in counts
        }
        for each in self._known.values():
            yield from each.mismatches

    def _look(self, ours: Publisher | Subscription) -> _Known:
        node, topic = self._node, ours.topic_name
        if isinstance(ours, Subscription):
            others = node.get_publishers_info_by_topic(topic)
        else:
            others = node.get_subscriptions_info_by_topic(topic)
        named = [other for other in others if node_of(other)]
        mismatches = [found for other in named for found in self._compare(ours, other)]
        return _Known(mismatches, len(named) == len(others))

    def _compare(
        self, ours: Publisher | Subscription, other: TopicEndpointInfo
    ) -> Iterable[tuple[str, str]]:
        is_heard = isinstance(ours, Subscription)
        name, kind = node_of(other), type_name(ours.msg_type)
        key = f'{ours.topic_name} {"from" if is_heard else "to"} {name}'
        if other.topic_type != kind:
            what = 'publishes' if is_heard else 'subscribes to'
            cause = f'it {what} {other.topic_type}, here it is {kind}'
            yield key, f'{cause}; {_type_remedy(kind, other.topic_type)}'
            return
        profiles = _comparable(other.qos_profile), _comparable(ours.qos_profile)
        compatibility, reasons = qos_check_compatible(*(profiles if is_heard else profiles[::-1]))
        if compatibility == QoSCompatibility.ERROR:
            cause = reasons.replace('ERROR: ', '').strip('; ').replace(';', ', ')
            yield key, f'{cause}; {self._qos_remedy(ours, name, cause)}'

    def _qos_remedy(self, ours: Publisher | Subscription, name: str, cause: str) -> str:
        remedy = f'change the quality of service of {name}'
        what, value = ('publisher', 'reliable')
        if isinstance(ours, Subscription):
            what, value = ('subscription', 'best_effort')
        parameter = f'qos_overrides.{ours.topic_name}.{what}.reliability'
        if 'reliable' in cause and self._node.has_parameter(parameter):
            return f'{remedy}, or set {parameter}: {value} here'
        return remedy


def _comparable(profile: QoSProfile) -> QoSProfile:
    """Return a profile without infinite durations, which the graph has in place of defaults."""
    profile = copy(profile)
    for name in ('deadline', 'lifespan', 'liveliness_lease_duration'):
        if getattr(profile, name) == Infinite:
            setattr(profile, name, Duration())
    return profile


def _type_remedy(ours: str, theirs: str) -> str:
    stamped = type_name(TwistStamped)
    if {ours, theirs} == {stamped, type_name(Twist)}:
        return f'set stamped: {str(theirs == stamped).lower()} here, or change the other node'
    return 'a topic must have one type: remap one of the two'


def twist_type(
    node: Node, topic: str, settings: NodeSettings, others: Iterable[TopicEndpointInfo]
) -> type[Twist] | type[TwistStamped]:
    """Return the type of commands on a topic: that of `stamped`, unless all others have another.

    In lockstep it is always TwistStamped.
    """
    kind, other = (TwistStamped, Twist) if settings.stamped else (Twist, TwistStamped)
    types = {each.topic_type for each in others}
    if settings.lockstep or types != {type_name(other)}:
        return kind
    node.get_logger().info(
        f'commands on {topic} are {type_name(other)}, as for all others there, '
        f'though stamped is {str(settings.stamped).lower()}'
    )
    return other
