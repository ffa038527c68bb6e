# SPDX-License-Identifier: Apache-2.0
"""The commands that the dogs of the sim receive."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from geometry_msgs.msg import Twist
from herding_ros.model.motion import MotionModel, steered_ahead
from herding_ros.model.state import Array
import numpy as np
from rclpy.publisher import Publisher

from . import messages
from .herding_node import HerdingNode
from .inbox import Inbox
from .mismatches import twist_type
from .publishing import ADJUSTABLE, is_heard, node_of
from .refusals import Refusals, Refused
from .settings import NodeSettings


class DogCommands:
    """Holds the newest good command of each dog, in its own frame, and refuses all others."""

    def __init__(
        self,
        node: HerdingNode,
        settings: NodeSettings,
        dogs: int,
        max_speed: float,
        motion: MotionModel,
        timeout: float,
        refused: Refusals,
    ) -> None:
        """Subscribe. Faster commands, and older than `timeout` [s], are refused."""
        self._node = node
        self._settings = settings
        self._max_speed = max_speed
        self._ahead = steered_ahead(motion)
        self._timeout = timeout
        self._refused = refused
        self.inboxes = tuple(self._subscribe(f'dog_{m}/cmd_vel') for m in range(1, dogs + 1))
        self.forget()

    def _subscribe(self, name: str) -> Inbox:
        topic = self._node.resolve_topic_name(name)
        others = self._node.get_publishers_info_by_topic(topic)
        kind = twist_type(self._node, topic, self._settings, others)
        return Inbox(self._node, kind, name, 10, qos_overriding_options=ADJUSTABLE)

    def forget(self) -> None:
        """Drop all commands that have been taken."""
        self._velocities: list[Array | None] = [None] * len(self.inboxes)
        self._received = [0] * len(self.inboxes)

    def arrivals(self, seconds: float) -> Iterator[None]:
        """Yield whenever the last dog gets commands, and when the time is over."""
        return self.inboxes[-1].arrivals(seconds)

    def take(self, now: int) -> None:
        """Take the commands that have come in by `now` [ns]."""
        for m, inbox in enumerate(self.inboxes):
            for data, _ in inbox.take():
                try:
                    self._velocities[m] = self._velocity_in(data, m + 1, now)
                    self._received[m] = now
                except ValueError as error:
                    self._refused.add(f'dog_{m + 1}/cmd_vel', error)

    def _velocity_in(self, data: bytes, m: int, now: int) -> Array:
        if self.inboxes[m - 1].subscription.msg_type is Twist:
            return messages.twist_in(data, self._max_speed, self._ahead)
        ns, velocity = messages.command_in(
            data, m, self._settings.frame, self._max_speed, self._ahead
        )
        if self._settings.lockstep:
            if ns != now:
                raise Refused('wrong stamp', 'its stamp must be that of the published state')
        elif ns:  # a sender without a clock stamps 0
            messages.check_stamp(ns, now, self._timeout, self._timeout)
        return velocity

    @property
    def missing(self) -> list[int]:
        """The dogs without a command, counted from 1."""
        return [m for m, u in enumerate(self._velocities, start=1) if u is None]

    def complete(self) -> Array | None:
        """Return the velocities (M, 2) [m/s] once every dog has a command."""
        velocities = [u for u in self._velocities if u is not None]
        return np.array(velocities) if len(velocities) == len(self.inboxes) else None

    def recent(self, now: int) -> Array:
        """Return the velocities (M, 2) [m/s]; 0 where the last command timed out by `now` [ns]."""
        oldest = now - round(self._timeout * 1e9)
        return np.array(
            [
                np.zeros(2) if u is None or received <= oldest else u
                for u, received in zip(self._velocities, self._received, strict=True)
            ]
        )

    def come_from_listeners(self, sensors: Sequence[Publisher]) -> bool:
        """Whether each dog's commands come from a node that all of these publishers reach."""
        return all(
            inbox.subscription.get_publisher_count() > 0
            and any(
                is_heard(self._node, sensors, node_of(commander))
                for commander in self._node.get_publishers_info_by_topic(
                    inbox.subscription.topic_name
                )
            )
            for inbox in self.inboxes
        )

    def publishers(self) -> set[bytes]:
        """Return the identifiers of all that publish commands."""
        return {
            bytes(info.endpoint_gid)
            for inbox in self.inboxes
            for info in self._node.get_publishers_info_by_topic(inbox.subscription.topic_name)
        }
