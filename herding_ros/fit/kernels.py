# SPDX-License-Identifier: Apache-2.0
"""The compiled loop of a fit: a Kalman filter along a recording, and errors of its predictions.

In the layout of `model.kernels`: coordinates first, sheep last. Each coordinate of each sheep has
a covariance of position and velocity, with friction and random force; the forces change the
prediction, not the covariance (as in `control.estimator`).
"""

from __future__ import annotations

from herding_ros.model.jit import inlined, kernel
from herding_ros.model.kernels import acceleration, Physics, step
from herding_ros.model.potentials.forms import hessian, PotentialForm
from herding_ros.model.state import Array
import numpy as np


@inlined
def _doubt_of_pair(sx: float, sy: float, variance: float, p: PotentialForm) -> float:
    """Return the variance of the force at a distance (sx, sy) that has a variance [m^2/s^4]."""
    r2 = sx * sx + sy * sy
    a, b = hessian(r2, p)
    along = a + b * r2
    return 0.5 * variance * (a * a + along * along)


@kernel
def _doubt(x: Array, p: Array, d: Array, physics: Physics, out: Array) -> None:
    """Put in out[lanes] the variance of forces because positions are uncertain [m^2/s^4]."""
    n = physics.n
    out[:] = 0.0
    for i in range(n):
        for j in range(i):
            sx, sy = x[0, i] - x[0, j], x[1, i] - x[1, j]
            doubt = _doubt_of_pair(sx, sy, p[0, i] + p[0, j], physics.sheep)
            out[i] += doubt
            out[j] += doubt
        for m in range(d.shape[1]):
            sx, sy = x[0, i] - d[0, m], x[1, i] - d[1, m]
            out[i] += _doubt_of_pair(sx, sy, p[0, i], physics.dog)


@kernel
def _predict(
    x: Array, v: Array, p: Array, d: Array, dt: float, noise: float, constants: Physics,
    a: Array, ring: Array, still: Array,
) -> None:  # fmt: skip
    """Move on along the dogs' path d[steps + 1, 2, M] in steps of dt; p[3, lanes] covariance."""
    physics = Physics(
        constants.n, dt, constants.sheep, constants.dog, constants.alpha, constants.external,
        constants.order, constants.alignment,
    )  # fmt: skip
    alpha, variance = physics.alpha, noise * noise * dt
    for k in range(d.shape[0] - 1):
        acceleration(x, v, d[k], physics, ring, a)
        step(x, v, a, still, physics, x, v)
        for i in range(physics.n):
            if physics.order == 1:
                p[0, i] += variance / (alpha * alpha)
                p[1, i] = 0.0
                p[2, i] = 0.0
            else:
                kept = 1.0 - alpha * dt
                p[0, i] += dt * (2.0 * p[1, i] + dt * p[2, i])
                p[1, i] = kept * (p[1, i] + dt * p[2, i])
                p[2, i] = kept * kept * p[2, i] + variance


@kernel
def _compare(
    x: Array, v: Array, p: Array, seen: Array, sensor: Array, correct: bool, off: Array,
    variance: Array,
) -> None:  # fmt: skip
    """Put in off[2, 2, lanes] and variance[2, lanes] how far seen[2, 2, lanes] is off x and v.

    First the positions, then the velocities less what the positions say of them: each in turn,
    so that the two are independent. NaN where nothing is seen. sensor[2]: variances of positions
    and velocities. With `correct` x, v and p learn from what is seen.
    """
    for i in range(x.shape[1]):
        p0, p1, p2 = p[0, i], p[1, i], p[2, i]
        off[:, :, i] = np.nan
        variance[:, i] = np.nan
        x0, x1, v0, v1 = x[0, i], x[1, i], v[0, i], v[1, i]
        if not np.isnan(seen[0, 0, i]):
            s = p0 + sensor[0]
            e0, e1 = seen[0, 0, i] - x0, seen[0, 1, i] - x1
            off[0, 0, i], off[0, 1, i], variance[0, i] = e0, e1, s
            x0 += p0 / s * e0
            x1 += p0 / s * e1
            v0 += p1 / s * e0
            v1 += p1 / s * e1
            p0, p1, p2 = p0 - p0 * p0 / s, p1 - p0 * p1 / s, p2 - p1 * p1 / s
        if not np.isnan(seen[1, 0, i]):
            s = p2 + sensor[1]
            e0, e1 = seen[1, 0, i] - v0, seen[1, 1, i] - v1
            off[1, 0, i], off[1, 1, i], variance[1, i] = e0, e1, s
            x0 += p1 / s * e0
            x1 += p1 / s * e1
            v0 += p2 / s * e0
            v1 += p2 / s * e1
            p0, p1, p2 = p0 - p1 * p1 / s, p1 - p1 * p2 / s, p2 - p2 * p2 / s
        if correct:
            x[0, i], x[1, i], v[0, i], v[1, i] = x0, x1, v0, v1
            p[0, i], p[1, i], p[2, i] = p0, p1, p2


@kernel
def innovations(
    seen: Array, d: Array, dt: Array, x: Array, v: Array, p: Array, noise: float, sensor: Array,
    physics: Physics, leads: Array, stride: int, off: Array, variance: Array,
) -> None:  # fmt: skip
    """Filter a recording and note how far its predictions are off.

    seen[T, 2, 2, lanes]: observed positions and velocities, NaN where there are none; d[T - 1,
    steps + 1, 2, M]: the dogs in between, dt[T - 1] the length of a step [s]; x, v[2, lanes] and
    p[3, lanes]: the estimate at the first instant, with its variances of position, covariance,
    variance of velocity; it is overwritten. Every `stride` instants, what is seen at each of the
    `leads` (in observations, increasing) is predicted. Puts the differences in
    off[T, leads, 2, 2, lanes], their variances in variance[T, leads, 2, lanes], by the instant
    that was predicted from.
    """
    a = np.empty_like(x)
    still = np.zeros_like(x)
    ring = np.zeros((2, 2, 2 * x.shape[1]))
    last = seen.shape[0] - 1
    off[:] = np.nan
    variance[:] = np.nan
    scratch = np.empty((2, 2, x.shape[1])), np.empty((2, x.shape[1]))
    doubt = np.empty(x.shape[1])
    for k in range(last):
        _doubt(x, p, d[k, 0], physics, doubt)
        took = dt[k] * (d.shape[1] - 1)
        if physics.order == 1:
            p[0] += (took / physics.alpha) ** 2 * doubt
        else:
            p[2] += took**2 * doubt
        _predict(x, v, p, d[k], dt[k], noise, physics, a, ring, still)
        if k % stride == 0:
            xs, vs, ps = x.copy(), v.copy(), p.copy()
            reached = 1
            for q in range(leads.shape[0]):
                if k + leads[q] > last:
                    break
                while reached < leads[q]:
                    j = k + reached
                    _predict(xs, vs, ps, d[j], dt[j], noise, physics, a, ring, still)
                    reached += 1
                _compare(xs, vs, ps, seen[k + reached], sensor, False, off[k, q], variance[k, q])
        _compare(x, v, p, seen[k + 1], sensor, True, scratch[0], scratch[1])
