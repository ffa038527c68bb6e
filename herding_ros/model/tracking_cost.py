# SPDX-License-Identifier: Apache-2.0
"""The compiled tracking cost of a flock, with its derivative."""

from __future__ import annotations

from .jit import kernel
from .state import Array


@kernel
def _sum(x: Array) -> float:
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i]
    return total


@kernel
def _of_coordinate(
    x: Array, centre: float, error: float, centre_weight: float, spread_weight: float, out: Array
) -> float:
    """Put the derivative of the tracking cost of one coordinate in out; return the cost."""
    squares = 0.0
    for i in range(x.shape[0]):
        offset = x[i] - centre
        squares += offset * offset
        out[i] = centre_weight * error + spread_weight * offset
    return 0.5 * (x.shape[0] * centre_weight * error * error + spread_weight * squares)


@kernel
def tracking_cost(
    x: Array,
    reference: Array,
    n: int,
    centre_weight: float,
    spread_weight: float,
    weight: float,
    source: Array,
) -> float:
    """Sum the tracking cost over all steps but the start.

    weight sum_k a/2 |xc - Z|^2 + b/(2n) sum_i |x_i - xc|^2

    for x[K+1, 2, lanes] with centres xc, Z = reference[K+1, 2], a = centre_weight,
    b = spread_weight; put its derivative with respect to x in source[K+1, 2, lanes].
    """
    cost = 0.0
    source[:] = 0.0
    for k in range(1, x.shape[0]):
        for c in range(2):
            sheep = x[k, c, :n]
            centre = _sum(sheep) / n
            error = centre - reference[k, c]
            cost += _of_coordinate(
                sheep,
                centre,
                error,
                weight / n * centre_weight,
                weight / n * spread_weight,
                source[k, c, :n],
            )
    return cost
