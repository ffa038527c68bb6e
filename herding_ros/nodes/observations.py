# SPDX-License-Identifier: Apache-2.0
"""The newest messages of sheep and dogs, as observations of the herd."""

from __future__ import annotations

from collections.abc import Iterator
import time

from herding_ros.control.parameters import Control
from herding_ros.control.pilot import is_set_back, Observed
from herding_ros.model.state import Array, HerdState
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from . import messages
from .inbox import Inbox
from .publishing import ADJUSTABLE
from .refusals import Refusals, Refused

_MOST_WAITING = 100
"""Messages of a topic that wait for a transform."""


class Observations:
    """Holds the newest good message of the sheep and of each dog, and refuses all others."""

    def __init__(
        self,
        node: Node,
        dogs: int,
        frame: str,
        most_sheep: int,
        timeout: float,
        control: Control,
        refused: Refusals,
        frames: messages.Frames | None = None,
    ) -> None:
        """Subscribe. Stamps older than `timeout` [s], or as far in the future, are refused.

        What is in another frame waits for as long for its transform, where there are `frames`.
        """
        self.headings: Array = np.zeros(dogs)
        """Newest known headings of the dogs (M,) [rad]."""
        self._frame = frame
        self._most_sheep = most_sheep
        self._timeout = timeout
        self._control_period = control.horizon.control_period
        self._motion = control.motion
        self._needs_velocities = not control.sensor.position_noise
        self._refused = refused
        self._frames = frames
        self._waiting: dict[str, list[tuple[float, bytes]]] = {}
        self._now = 0
        self._flock: messages.Sheep | None = None
        self._dogs: dict[int, tuple[int, Array]] = {}
        self._sheep = Inbox(node, PointCloud2, 'sheep', 10, qos_overriding_options=ADJUSTABLE)
        self._odometry = [
            Inbox(node, Odometry, f'dog_{m + 1}/odom', 10, qos_overriding_options=ADJUSTABLE)
            for m in range(dogs)
        ]

    @property
    def inboxes(self) -> tuple[Inbox, ...]:
        """All subscriptions."""
        return self._sheep, *self._odometry

    def arrivals(self, seconds: float) -> Iterator[None]:
        """Yield whenever sheep come, and when the time is over."""
        return self._sheep.arrivals(seconds)

    def _forget(self) -> None:
        self._flock = None
        self._dogs.clear()

    def _incoming(self, topic: str, inbox: Inbox) -> Iterator[tuple[float, bytes]]:
        """Yield messages and when they came [s]: first those that waited for a transform."""
        yield from self._waiting.pop(topic, ())
        for data, _ in inbox.take():
            yield time.monotonic(), data

    def _refuse(self, topic: str, error: ValueError, came: float, data: bytes) -> None:
        """Refuse a message, or let it wait: a transform often comes later than what it is for."""
        waiting = self._waiting.setdefault(topic, [])
        is_early = time.monotonic() < came + self._timeout and len(waiting) < _MOST_WAITING
        if isinstance(error, messages.NoTransformError) and is_early:
            waiting.append((came, data))
        else:
            self._refused.add(topic, error)

    def _take(self, now: int | None = None) -> None:
        """Take the messages that have come in; stamps are checked if `now` [ns] is given."""
        for came, data in self._incoming('sheep', self._sheep):
            try:
                flock = messages.sheep_in(
                    data, self._frame, self._most_sheep, self._needs_velocities, self._frames
                )
                self._check_stamp(flock.ns, now, self._flock.ns if self._flock else 0)
                self._flock = flock
            except ValueError as error:
                self._refuse('sheep', error, came, data)
        for m, inbox in enumerate(self._odometry):
            topic = f'dog_{m + 1}/odom'
            for came, data in self._incoming(topic, inbox):
                try:
                    ns, position, heading, velocity = messages.dog_in(
                        data, self._frame, self._frames
                    )
                    self._check_stamp(ns, now, self._dogs[m][0] if m in self._dogs else 0)
                    self._dogs[m] = ns, self._state_of_dog(position, heading, velocity)
                    self.headings[m] = heading
                except ValueError as error:
                    self._refuse(topic, error, came, data)

    def _check_stamp(self, ns: int, now: int | None, last: int) -> None:
        if now is None:
            return
        messages.check_stamp(ns, now, self._timeout, self._timeout)
        if ns < last:
            raise Refused('overtaken', 'a newer one has come before it')

    def complete(self) -> Observed | None:
        """Return the herd when all messages have the same stamp, and each stamp only once."""
        self._take()
        stamps = {ns for ns, _ in self._dogs.values()}
        if self._flock is None or stamps != {self._flock.ns}:
            return None
        if len(self._dogs) < len(self._odometry):
            return None
        observed = self._observed(self._flock, tuple(range(len(self._odometry))))
        self._forget()
        return observed

    def recent(self, now: int) -> Observed | None:
        """Return what was observed recently at `now` [ns]; None without sheep or any dog."""
        if is_set_back(now * 1e-9, self._now * 1e-9, self._control_period):
            self._forget()
            self._waiting.clear()
        self._now = now
        self._take(now)
        oldest = now - self._timeout * 1e9
        dogs = tuple(m for m, (ns, _) in sorted(self._dogs.items()) if ns >= oldest)
        if self._flock is None or self._flock.ns < oldest or not dogs:
            return None
        return self._observed(self._flock, dogs)

    def _observed(self, flock: messages.Sheep, dogs: tuple[int, ...]) -> Observed:
        states = np.array([self._dogs[m][1] for m in dogs])
        state = HerdState(flock.x, flock.v, states)
        return Observed(flock.ns, flock.ids, state, dogs, flock.is_velocity_seen)

    def _state_of_dog(self, position: Array, heading: float, velocity: Array) -> Array:
        """Return the state (S,) of a dog; refuse odometry that lacks what its motion needs."""
        state = self._motion.state(position[None], np.array([heading]), velocity[None])[0]
        if not np.isfinite(state).all():
            raise Refused('not finite', f'the state of a dog must be finite, got {state.tolist()}')
        return state
