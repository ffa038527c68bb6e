# SPDX-License-Identifier: Apache-2.0
"""From other frames into that of planning, where there is tf2."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

from geometry_msgs.msg import TransformStamped
from herding_ros.checks import check_size, Refused
from herding_ros.model.state import Array
import numpy as np
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time

from .stamps import level_yaw

LATEST = 0
"""In place of a stamp [ns]: the newest transform that there is."""

_ANY_JUMP_BACK = JumpThreshold(
    min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
)


class NoTransformError(Refused):
    """There is no transform for a message, or none yet."""


@dataclass(frozen=True)
class Placement:
    """Where a frame lies in another, in the plane: its origin x, y [m] and its turn yaw [rad]."""

    x: float
    y: float
    yaw: float

    @classmethod
    def of(cls, message: TransformStamped) -> Placement:
        """Return that of a transform; Refused if it tilts, or is none."""
        to, turn = message.transform.translation, message.transform.rotation
        check_size('a transform', to.x, to.y, turn.x, turn.y, turn.z, turn.w)
        return cls(to.x, to.y, level_yaw('a transform', turn.x, turn.y, turn.z, turn.w))

    def vectors(self, v: Array) -> Array:
        """Return vectors (n, 2), such as velocities, in the other frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1]], axis=1)

    def points(self, x: Array) -> Array:
        """Return points (n, 2) [m] in the other frame."""
        return self.vectors(x) + np.array([self.x, self.y])

    def heading(self, heading: float) -> float:
        """Return a heading [rad] in the other frame, from -pi to pi."""
        return math.remainder(heading + self.yaw, math.tau)


class Frames:
    """Placements of other frames in that of planning, from a buffer of tf2.

    A buffer has `lookup_transform(target, source, time)`, which raises `failure` where it knows
    no transform.
    """

    def __init__(self, frame: str, buffer: Any, failure: type[Exception]) -> None:
        self._frame = frame
        self._buffer = buffer
        self._failure = failure

    @classmethod
    def of(cls, node: Node, frame: str) -> Frames | None:
        """Listen to tf on behalf of a node; None where tf2_ros cannot be imported.

        When simulated time goes back, what was known before is forgotten.
        """
        try:
            import tf2_ros
        except ImportError:
            return None
        buffer = tf2_ros.Buffer()
        frames = cls(frame, buffer, tf2_ros.TransformException)
        # Both as long as they are kept. A buffer takes nothing older than what it has.
        frames._listener = tf2_ros.TransformListener(buffer, node)
        frames._jumps = node.get_clock().create_jump_callback(
            _ANY_JUMP_BACK, post_callback=lambda _: buffer.clear()
        )
        return frames

    _listener: Any = None
    _jumps: Any = None

    def placement(self, what: str, given: str, ns: int) -> Placement:
        """Return where the frame of a message lies at its stamp [ns]; Refused if unknown."""
        try:
            found = self._buffer.lookup_transform(self._frame, given, Time(nanoseconds=ns))
        except self._failure as error:
            raise NoTransformError(
                'no transform',
                f"{what} must be in frame '{self._frame}' or in one with a transform to it, got "
                f'{given!r}: {error}',
                given,
            ) from None
        return Placement.of(found)
