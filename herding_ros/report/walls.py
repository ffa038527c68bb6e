# SPDX-License-Identifier: Apache-2.0
"""The walls of a field, as what is drawn of them."""

from __future__ import annotations

from herding_ros.model.field import Field
from herding_ros.model.state import Array
import numpy as np

_CORNERS = 48
"""Of a disc."""


def outlines(field: Field) -> tuple[Array, ...]:
    """Return fences, obstacles and discs as polylines (K, 2) [m], the latter two closed."""
    closed = [(*corners, corners[0]) for corners in field.obstacles]
    angles = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    discs = [radius * circle + (x, y) for x, y, radius in field.discs]
    return tuple(np.array(line) for line in (*field.fences, *closed, *discs))


def region(field: Field) -> Array:
    """Return the polygon that has to hold the flock, closed (K, 2) [m]; (0, 2) without one."""
    corners = field.goal if len(field.goal) > 2 else ()
    return np.array([*corners, *corners[:1]]).reshape(-1, 2)


def further(field: Field, walls: Array) -> Array:
    """Return those of the straight pieces (n, 2, 2) [m] that the field does not have."""
    known = {piece.tobytes() for piece in field.outline}
    return walls[[piece.tobytes() not in known for piece in walls]]
