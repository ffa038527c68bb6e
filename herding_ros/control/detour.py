# SPDX-License-Identifier: Apache-2.0
"""The shortest way from one point to another that goes round a disc."""

from __future__ import annotations

from herding_ros.model.state import Array
import numpy as np


def detour(start: Array, end: Array, radius: float) -> tuple[Array, Array, Array]:
    """Return the lengths (...) [m] of the shortest ways round a disc, and their gradients.

    start, end: (..., 2) [m], relative to the disc's centre; radius [m]. The gradients (..., 2)
    are with respect to start and end: minus the unit vector of the direction in which a way sets
    out, and plus that in which it arrives. Where the straight line misses the disc it is the way;
    else the way is a tangent, an arc and a tangent:

        L = sqrt(a^2 - R^2) + sqrt(b^2 - R^2) + R (theta - arccos R/a - arccos R/b)

    with a, b the distances of start and end from the centre and theta the angle between them. A
    disc that holds one of them is shrunk until that point is on its edge.
    """
    # A program's help needs no Numba.
    from herding_ros.model.errand_kernels import detours

    shape = np.broadcast_shapes(start.shape, end.shape)
    # Copies, for Numba compiles another kernel for what may not be written.
    ends = (np.array(np.broadcast_to(p, shape), order='C').reshape(-1, 2) for p in (start, end))
    length, by_start, by_end = np.empty(shape[:-1]), np.empty(shape), np.empty(shape)
    detours(*ends, radius, length.reshape(-1), by_start.reshape(-1, 2), by_end.reshape(-1, 2))
    return length, by_start, by_end
