# SPDX-License-Identifier: Apache-2.0
"""What RViz draws: paths, poses and markers."""

from __future__ import annotations

from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Vector3
from herding_ros.markers import ROUTE, WALLS
from herding_ros.model.state import Array
from herding_ros.nodes.drawing import Drawing
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
        shapes += ((WALLS, Marker.LINE_LIST, black, 0.4 * size, walls.reshape(-1, 2)),)
    return MarkerArray(markers=[_marker(*shape, ns, frame) for shape in shapes])


def drawing(drawn: Drawing, ns: int, frame: str) -> MarkerArray:
    """What the controller has decided, in place of all that was shown of it before.

    Walls in black, the flock's route in green, and around each dog a disc that touches another
    when the two are as near as they may be. Where a command was changed, a grey line leads from
    the dog to where the plan would have led it, and a red arrow from there to where it is told to
    go.
    """
    black, green = ColorRGBA(a=1.0), ColorRGBA(r=0.1, g=0.6, b=0.2, a=1.0)
    grey, red = ColorRGBA(r=0.5, g=0.5, b=0.5, a=1.0), ColorRGBA(r=0.9, g=0.1, b=0.1, a=1.0)
    pale = ColorRGBA(r=0.9, g=0.1, b=0.1, a=0.2)
    asked, width = drawn.changes[:, :2], drawn.width
    shapes = (
        (WALLS, Marker.LINE_LIST, black, width, drawn.walls),
        (ROUTE, Marker.LINE_STRIP, green, width, drawn.route),
        ('asked', Marker.LINE_LIST, grey, width, asked),
        ('separation', Marker.SPHERE_LIST, pale, drawn.separation, drawn.dogs),
    )
    markers = [
        _marker(name, kind, color, size, points.reshape(-1, 2), ns, frame)
        for name, kind, color, size, points in shapes
        if len(points) and size
    ]
    for number, change in enumerate(drawn.changes):
        arrow = _marker('told', Marker.ARROW, red, 2.0 * width, change[1:], ns, frame, number)
        arrow.scale.x, arrow.scale.z = width, 0.0  # its shaft; a head as long as RViz likes
        markers.append(arrow)
    fresh = Marker(header=Header(stamp=stamp_of(ns), frame_id=frame), action=Marker.DELETEALL)
    return MarkerArray(markers=[fresh, *markers])


def _marker(
    name: str, kind: int, color: ColorRGBA, width: float, points: Array, ns: int, frame: str,
    number: int = 0,
) -> Marker:  # fmt: skip
    return Marker(
        header=Header(stamp=stamp_of(ns), frame_id=frame),
        ns=name,
        id=number,
        type=kind,
        action=Marker.ADD,
        pose=Pose(orientation=Quaternion(w=1.0)),
        scale=Vector3(x=width, y=width, z=width),
        color=color,
        points=[Point(x=x, y=y) for x, y in points.tolist()],
    )
