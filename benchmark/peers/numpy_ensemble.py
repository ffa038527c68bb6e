# SPDX-License-Identifier: Apache-2.0
"""The mean of an ensemble with plain NumPy, vectorised over paths and pairs.

Buffers are made once, coordinates are apart, and as many paths are taken at a time as were
found to be fastest. (A list of pairs, each taken once, is slower: it has to be gathered and
scattered.) One thread: NumPy is not threaded here.
"""

from __future__ import annotations

from benchmark.problem import Problem
from herding_ros.model.state import Array
import numpy as np

_PAIRS = 100_000
"""Entries of a buffer of pairs."""


class _Forces:
    """Sums over sources of the gradient of P(|x_i - y_j|), for some paths at once."""

    def __init__(self, shape: tuple[int, ...], p: tuple[float, float, float, float]) -> None:
        self._p = p
        self._dx, self._dy, self._r, self._a, self._b = np.empty((5, *shape))

    def __call__(self, x: Array, y: Array) -> Array:
        """Return (2, paths, N) [m/s^2] for x (2, paths, N) and y (2, paths or 1, M) [m]."""
        dx, dy, r, a, b, p = self._dx, self._dy, self._r, self._a, self._b, self._p
        np.subtract(x[0, :, :, None], y[0, :, None, :], out=dx)
        np.subtract(x[1, :, :, None], y[1, :, None, :], out=dy)
        np.multiply(dx, dx, out=r)
        np.multiply(dy, dy, out=a)
        r += a
        np.sqrt(r, out=r)
        np.exp(np.multiply(r, -p[3], out=a), out=a)
        np.exp(np.multiply(r, -p[1], out=b), out=b)
        a *= p[2]
        b *= p[0]
        a -= b
        r[r == 0.0] = np.inf
        a /= r
        dx *= a
        dy *= a
        return np.stack([dx.sum(2), dy.sum(2)])


def mean_centre(problem: Problem, noise: Array) -> Array:
    """Mean of the sheep's centre (K+1, 2) [m] over the paths of noise (paths, K, 2, N) [m/s]."""
    coarse, n = problem.coarse, problem.sheep
    crowd, dt = coarse.crowd, coarse.dt
    total = np.zeros((problem.steps + 1, 2))
    at_once = min(max(_PAIRS // n**2, 1), len(noise))
    for first in range(0, len(noise), at_once):
        of_paths = noise[first : first + at_once].transpose(1, 2, 0, 3)
        paths = of_paths.shape[2]
        force_of_flock = _Forces((paths, n, n), crowd.sheep.coefficients)
        force_of_dogs = _Forces((paths, n, problem.dogs), crowd.dog.coefficients)
        x = np.repeat(coarse.state.x.T[:, None], paths, axis=1)
        v = np.repeat(coarse.state.v.T[:, None], paths, axis=1)
        d = coarse.state.d.T[:, None].copy()
        for k in range(problem.steps):
            total[k] += x.sum((1, 2))
            force = force_of_flock(x, x) / n + force_of_dogs(x, d) + crowd.friction * v
            x += dt * v
            v += of_paths[k] - dt * force
            d += dt * problem.u[k // coarse.substeps].T[:, None]
        total[-1] += x.sum((1, 2))
    return total / (len(noise) * n)
