# SPDX-License-Identifier: Apache-2.0
"""Products of a matrix whose rounding does not depend on the number of threads, as BLAS's does."""

from __future__ import annotations

from .jit import kernel
from .state import Array


@kernel
def times(matrix: Array, x: Array, out: Array) -> None:
    """Put matrix[m, n] x[n] in out[m]."""
    for i in range(matrix.shape[0]):
        out[i] = _dot(matrix[i], x)


@kernel
def transposed_times(matrix: Array, y: Array, out: Array) -> None:
    """Put y[m] matrix[m, n] in out[n]."""
    out[:] = 0.0
    for i in range(matrix.shape[0]):
        _add_multiple(y[i], matrix[i], out)


@kernel
def _add_multiple(factor: float, x: Array, out: Array) -> None:
    for i in range(x.shape[0]):
        out[i] += factor * x[i]


@kernel
def _dot(x: Array, y: Array) -> float:
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i] * y[i]
    return total
