# SPDX-License-Identifier: Apache-2.0
"""What RViz draws: paths, poses and markers."""

from __future__ import annotations

from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Vector3
from herding_ros.model.state import Array
from nav_msgs.msg import Path
import numpy as np
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from .stamps import stamp_of


def path(route: Array, dt: float, ns: int, frame: str) -> Path:
    """Route (K, 2) [m], its points dt [s] apart, the first at the stamp."""
    message = Path(header=Header(stamp=stamp_of(ns), frame_id=frame))
    message.poses += [pose(at, ns + round(k * dt * 1e9), frame) for k, at in enumerate(route)]
    return message


def pose(position: Array, ns: int, frame: str) -> PoseStamped:
    """Position (2,) [m], upright, from the stamp on."""
    x, y = position.tolist()
    upright = Quaternion(w=1.0)
    return PoseStamped(
        header=Header(stamp=stamp_of(ns), frame_id=frame),
        pose=Pose(position=Point(x=x, y=y), orientation=upright),
    )


def marker_array(
    x: Array, d: Array, goal: Array, size: float, ns: int, frame: str, walls: Array | None = None
) -> MarkerArray:
    """Sheep as blue dots, dogs as red triangles, a cross of this size [m] at the destination.

    walls: straight pieces (n, 2, 2) [m] by their ends, drawn if there are any.
    """
    blue, red = ColorRGBA(r=0.1, g=0.3, b=0.9, a=1.0), ColorRGBA(r=0.9, g=0.1, b=0.1, a=1.0)
    black = ColorRGBA(a=1.0)
    corners = 0.8 * size * np.array([[0.0, 1.0], [-0.87, -0.5], [0.87, -0.5]])
    cross = size * np.array([[-1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [1.0, -1.0]])
    shapes: tuple[tuple[str, int, ColorRGBA, float, Array], ...] = (
        ('sheep', Marker.SPHERE_LIST, blue, 0.6 * size, x),
        ('dogs', Marker.TRIANGLE_LIST, red, 1.0, (d[:, None] + corners).reshape(-1, 2)),
        ('goal', Marker.LINE_LIST, black, 0.2 * size, goal + cross),
    )
    if walls is not None and len(walls):
        shapes += (('walls', Marker.LINE_LIST, black, 0.4 * size, walls.reshape(-1, 2)),)
    return MarkerArray(
        markers=[
            Marker(
                header=Header(stamp=stamp_of(ns), frame_id=frame),
                ns=name,
                type=kind,
                action=Marker.ADD,
                pose=Pose(orientation=Quaternion(w=1.0)),
                scale=Vector3(x=width, y=width, z=width),
                color=color,
                points=[Point(x=x, y=y) for x, y in vertices.tolist()],
            )
            for name, kind, color, width, vertices in shapes
        ]
    )
