# SPDX-License-Identifier: Apache-2.0
"""The shortest way from one point to another that goes round a disc."""

from __future__ import annotations

from herding_ros.model.state import Array
import numpy as np

_TINY = 1e-12


def detour(start: Array, end: Array, radius: Array | float) -> tuple[Array, Array, Array]:
    """Return the lengths (...) [m] of the shortest ways round a disc, and their gradients.

    start, end: (..., 2) [m], relative to the disc's centre; radius [m], one or (...). The gradients (..., 2)
    are with respect to start and end: minus the unit vector of the direction in which a way sets
    out, and plus that in which it arrives. Where the straight line misses the disc it is the way;
    else the way is a tangent, an arc and a tangent:

        L = sqrt(a^2 - R^2) + sqrt(b^2 - R^2) + R (theta - arccos R/a - arccos R/b)

    with a, b the distances of start and end from the centre and theta the angle between them. A
    disc that holds one of them is shrunk until that point is on its edge.
    """
    straight = end - start
    length = np.sqrt(np.square(straight).sum(axis=-1))
    heading = straight / np.maximum(length, _TINY)[..., None]
    a, b = (np.maximum(np.sqrt(np.square(p).sum(axis=-1)), _TINY) for p in (start, end))
    r = np.minimum(np.minimum(radius, a), b)
    cross = start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]
    theta = np.abs(np.arctan2(cross, (start * end).sum(axis=-1)))
    arc = theta - np.arccos(np.minimum(r / a, 1.0)) - np.arccos(np.minimum(r / b, 1.0))
    turn = np.where(cross >= 0.0, 1.0, -1.0)
    tangents = [np.sqrt(np.maximum(each**2 - r**2, 0.0)) for each in (a, b)]
    around = tangents[0] + tangents[1] + r * arc
    gradients = []
    for point, distance, tangent, sign, shrinks in (
        (start, a, tangents[0], -1.0, a <= b),
        (end, b, tangents[1], 1.0, b < a),
    ):
        unit = point / distance[..., None]
        across = np.stack([-unit[..., 1], unit[..., 0]], axis=-1)
        outwards = tangent / distance + np.where(shrinks & (distance <= radius), arc, 0.0)
        sideways = sign * turn * r / distance
        gradients.append(outwards[..., None] * unit + sideways[..., None] * across)
    bends = arc > 0.0
    by_start = np.where(bends[..., None], gradients[0], -heading)
    by_end = np.where(bends[..., None], gradients[1], heading)
    return np.where(bends, around, length), by_start, by_end
