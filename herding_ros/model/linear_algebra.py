# SPDX-License-Identifier: Apache-2.0
"""Products of matrices, and a quadratic function of a control, compiled.

The rounding of the products does not depend on the number of threads, as that of BLAS does. The
Hessian of the quadratic function is smoothing but for few directions:

    B = theta (S + MU) + W^T Q W

S integrates a control over time twice, forwards and then backwards, with the window as the unit of
time: h.S h is the sum of |int_0^t h|^2 over all instants. A control acts by where it takes the
dogs, so its curvature is like this to begin with: much larger for slow changes than for fast
ones. MU is what is left for fast ones. Controls are h[intervals, components] here.
"""

from __future__ import annotations

import numpy as np

from .jit import kernel
from .state import Array

MU = 0.02


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


@kernel
def _add_multiples(a: float, x: Array, b: float, y: Array, out: Array) -> None:
    for i in range(x.shape[0]):
        out[i] += a * x[i] + b * y[i]


@kernel
def smoothed(h: Array, out: Array) -> None:
    """Put (S + MU) h in out[intervals, components]."""
    n, components = h.shape
    square = 1.0 / (n * n)
    out[0] = h[0]
    for k in range(1, n):
        for c in range(components):
            out[k, c] = out[k - 1, c] + h[k, c]
    integral = np.zeros(components)
    for k in range(n - 1, -1, -1):
        for c in range(components):
            integral[c] += out[k, c]
            out[k, c] = square * integral[c] + MU * h[k, c]


@kernel
def hessian_times(h: Array, theta: float, w: Array, q: Array, out: Array) -> None:
    """Put B h in out[intervals, components]; w[2 n, intervals * components], q[2 n, 2 n]."""
    smoothed(h, out)
    flat, flat_out = h.reshape(h.size), out.reshape(h.size)
    for i in range(h.size):
        flat_out[i] *= theta
    products = np.empty(w.shape[0])
    times(w, flat, products)
    for j in range(0, w.shape[0], 2):
        _add_multiples(_dot(q[j], products), w[j], _dot(q[j + 1], products), w[j + 1], flat_out)


@kernel
def advance(
    trial: Array, x: Array, slope: Array, theta: float, w: Array, q: Array, short: bool
) -> tuple[float, float]:
    """Move x towards trial, at most all the way, to where the quadratic function is least.

    slope is its gradient at x, and is kept up to date. Leaves a step against the slope from there,
    to be projected, in trial: the long or the short one of Barzilai and Borwein. Returns
    |trial - x|^2 and the same in the norm of B, as they were.
    """
    step = trial - x
    product = np.empty_like(step)
    hessian_times(step, theta, w, q, product)
    size = x.size
    flat, along, s = step.reshape(size), product.reshape(size), slope.reshape(size)
    squared, curvature = _dot(flat, flat), _dot(flat, along)
    descent = _dot(s, flat)
    if curvature > 0.0:
        fraction = min(max(-descent / curvature, 0.0), 1.0)
        length = curvature / _dot(along, along) if short else squared / curvature
        flat_x, flat_trial = x.reshape(size), trial.reshape(size)
        for i in range(size):
            flat_x[i] += fraction * flat[i]
            s[i] += fraction * along[i]
            flat_trial[i] = flat_x[i] - length * s[i]
    return squared, curvature
