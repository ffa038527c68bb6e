# SPDX-License-Identifier: Apache-2.0
"""The roof over the kernels: nothing but the exponentials and the square root of each pair.

A pair force needs two exponentials and one square root. The bare loop does just these, with
the package's own exponential, on an array that fits in the first-level cache, and sums up.
"""

from __future__ import annotations

import math
from typing import Any

from herding_ros.model.kernels import exp_neg
from herding_ros.model.state import Array
from numba import njit
import numpy as np

SIZE = 1024
"""Entries of the array: 8 KiB."""

_loop = njit(nogil=True, error_model='numpy', fastmath={'reassoc', 'contract', 'nsz'})


@_loop
def bare(r2: Array, rates: Array) -> float:
    """Two exponentials and a square root for each of r2 and each row of rates[repeats, 2]."""
    total = 0.0
    for k in range(rates.shape[0]):
        first, second = -rates[k, 0], -rates[k, 1]
        for i in range(r2.shape[0]):
            r = math.sqrt(r2[i])
            total += exp_neg(first * r) - exp_neg(second * r)
    return total


@_loop
def bare_with_division(r2: Array, rates: Array) -> float:
    """Do the same with the division by r that the force needs as well."""
    total = 0.0
    for k in range(rates.shape[0]):
        first, second = -rates[k, 0], -rates[k, 1]
        for i in range(r2.shape[0]):
            r = math.sqrt(r2[i])
            total += (exp_neg(first * r) - exp_neg(second * r)) / r
    return total


def arguments(evaluations: int) -> tuple[Array, Array]:
    """Return what the loops take to do this many evaluations, rounded up to whole arrays.

    The rates differ slightly from repeat to repeat, so that no repeat can be left out.
    """
    r2 = np.linspace(0.01, 1.0, SIZE) ** 2
    repeats = -(-evaluations // SIZE)
    slightly = np.linspace(1.0, 1.01, repeats)
    return r2, np.stack([100.0 * slightly, 0.5 * slightly], axis=1)


def is_vectorised(loop: Any) -> bool:
    """Whether the compiled loop takes square roots of whole vectors."""
    loop(*arguments(1))
    return all('sqrtpd' in code for code in loop.inspect_asm().values())
