# SPDX-License-Identifier: Apache-2.0
"""What the controller draws of its surroundings, read back from its markers.

Messages of rclpy and of rosbags alike have what is read here.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from herding_ros.checks import check_frame, Refused
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WALLS, ROUTE = 'walls', 'route'
"""Namespaces of the markers."""


class Surroundings(NamedTuple):
    """What a controller goes by.

    walls: (n, 2, 2) [m] ends of straight pieces that it keeps clear of; route: (k, 2) [m] of the
    flock's centre to the destination.
    """

    walls: Array
    route: Array


NOTHING = Surroundings(np.zeros((0, 2, 2)), np.zeros((0, 2)))


def surroundings_in(message: Any, frame: str) -> Surroundings:
    """Return what is in a MarkerArray on herd/markers; raises Refused."""
    walls, route = (_points(message, name, frame) for name in (WALLS, ROUTE))
    if len(walls) % 2:
        raise Refused('malformed', f'walls must have two ends each, got {len(walls)} points')
    return Surroundings(walls.reshape(-1, 2, 2), route)


@lru_cache(maxsize=8)
def _kept(data: bytes) -> bytes:
    """Return the same bytes as for equal ones before: walls seldom change."""
    return data


def _points(message: Any, name: str, frame: str) -> Array:
    found = []
    for marker in message.markers:
        if marker.ns == name:
            check_frame('a marker', marker.header.frame_id, frame)
            found += [(point.x, point.y) for point in marker.points]
    points = np.array(found, dtype=np.float64).reshape(-1, 2)
    if not np.isfinite(points).all():
        raise Refused('not finite', f'{name} must be finite, got NaN or infinite values')
    return np.frombuffer(_kept(points.tobytes())).reshape(-1, 2)
