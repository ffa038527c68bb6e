# SPDX-License-Identifier: Apache-2.0
"""What a topic's publishers offer: how to subscribe to all of them, and how a bag keeps it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo


def adapted_qos(ends: Sequence[TopicEndpointInfo], depth: int) -> QoSProfile:
    """Return the strictest profile that every publisher satisfies, as rosbag2 chooses it.

    Of subscribers it is the one that gets what any of them gets. `depth` is the number of
    messages that the subscription can hold.
    """
    offers = [end.qos_profile for end in ends]
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    durable = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if durable else DurabilityPolicy.VOLATILE,
    )


def asks_more(profile: QoSProfile, other: QoSProfile) -> bool:
    """Whether a subscription with this profile asks for more than the other one offers."""
    return (
        profile.reliability == ReliabilityPolicy.RELIABLE != other.reliability
        or profile.durability == DurabilityPolicy.TRANSIENT_LOCAL != other.durability
    )


def is_same(profile: QoSProfile, other: QoSProfile) -> bool:
    """Whether subscriptions with these profiles match the same publishers in the same way."""
    return profile.reliability == other.reliability and profile.durability == other.durability


def qos_map(profile: QoSProfile) -> dict[str, Any]:
    """Return a profile as the map in a bag's metadata (see `bag.metadata`)."""
    return {
        'history': profile.history.name.lower(),
        'depth': profile.depth,
        'reliability': profile.reliability.name.lower(),
        'durability': profile.durability.name.lower(),
        'deadline': _duration_map(profile.deadline),
        'lifespan': _duration_map(profile.lifespan),
        'liveliness': profile.liveliness.name.lower(),
        'liveliness_lease_duration': _duration_map(profile.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions,
    }


def _duration_map(duration: Duration) -> dict[str, int]:
    sec, nsec = divmod(duration.nanoseconds, 1_000_000_000)
    return {'sec': sec, 'nsec': nsec}
