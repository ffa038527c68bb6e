# SPDX-License-Identifier: Apache-2.0
"""A quadratic function of a control whose Hessian is smoothing but for few directions, compiled.

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
def _dot(x: Array, y: Array) -> float:
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i] * y[i]
    return total


@kernel
def _add_multiple(factor: float, x: Array, out: Array) -> None:
    for i in range(x.shape[0]):
        out[i] += factor * x[i]


@kernel
def smoothed(h: Array, out: Array) -> None:
    """Put (S + MU) h in out[intervals, components]."""
    n, components = h.shape
    square = 1.0 / (n * n)
    for c in range(components):
        integral = 0.0
        for k in range(n):
            integral += h[k, c]
            out[k, c] = integral
        integral = 0.0
        for k in range(n - 1, -1, -1):
            integral += out[k, c]
            out[k, c] = square * integral + MU * h[k, c]


@kernel
def hessian_times(h: Array, theta: float, w: Array, q: Array, out: Array) -> None:
    """Put B h in out[intervals, components]; w[n, intervals * components], q[n, n]."""
    smoothed(h, out)
    flat, flat_out = h.reshape(h.size), out.reshape(h.size)
    for i in range(h.size):
        flat_out[i] *= theta
    products = np.empty(w.shape[0])
    for j in range(w.shape[0]):
        products[j] = _dot(w[j], flat)
    for j in range(w.shape[0]):
        _add_multiple(_dot(q[j], products), w[j], flat_out)


@kernel
def advance(
    trial: Array, x: Array, slope: Array, theta: float, w: Array, q: Array
) -> tuple[float, float]:
    """Move x towards trial, at most all the way, to where the quadratic function is least.

    slope is its gradient at x, and is kept up to date. Returns |trial - x|^2, and the same in the
    norm of B.
    """
    step = trial - x
    product = np.empty_like(step)
    hessian_times(step, theta, w, q, product)
    flat, flat_product = step.reshape(x.size), product.reshape(x.size)
    descent = _dot(slope.reshape(x.size), flat)
    curvature = _dot(flat, flat_product)
    fraction = 1.0 if -descent >= curvature else max(-descent, 0.0) / curvature
    _add_multiple(fraction, flat, x.reshape(x.size))
    _add_multiple(fraction, flat_product, slope.reshape(x.size))
    return _dot(flat, flat), curvature
