"""The compiled inner loops: one time step, its adjoint, and the sweeps over them.

Everything here works on plain arrays laid out for vector units: coordinates first, sheep
last and contiguous, padded with unused lanes to a multiple of LANES. A state is x[2, lanes],
v[2, lanes], d[2, M]. All kernels sit in one file because Numba's on-disk cache notices a
changed file, but not a changed import. They release the GIL.

Symbols are those of the paper: alpha friction, mu and lam the adjoints of v and x, nu the
adjoint of d.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numba import njit
import numpy as np

from .state import Array

LANES = 8
"""Sheep are padded to a multiple of this: one AVX-512 register of doubles, two of AVX2."""

# 'reassoc' lets the compiler sum rows in vector registers, 'contract' lets it fuse
# multiply-adds. NaN and infinity keep their meaning. The order of summation is fixed at
# compile time, so results repeat bit for bit.
_OPTIONS: dict[str, Any] = {'cache': True, 'nogil': True, 'error_model': 'numpy'}
_kernel = njit(**_OPTIONS, fastmath={'reassoc', 'contract', 'nsz'})
# What is called in an innermost loop has to be inlined, or the loop cannot be vectorised.
_inlined = njit(**_OPTIONS, fastmath={'reassoc', 'contract', 'nsz'}, forceinline=True)
# Argument reduction depends on the order of its operations: no reassociation here.
_exact = njit(**_OPTIONS, fastmath={'contract'}, forceinline=True)

MorseCoefficients = tuple[float, float, float, float]
"""(C_r / l_r, 1 / l_r, C_a / l_a, 1 / l_a) of a Morse potential."""


class Physics(NamedTuple):
    """What a step needs besides the state: numbers that stay the same along a rollout."""

    n: int
    dt: float
    sheep: MorseCoefficients
    dog: MorseCoefficients
    alpha: float


_LOG2_E = 1.0 / math.log(2.0)
# log(2) in two parts (as in fdlibm): n * _LN2_HIGH is exact for |n| < 2^20.
_LN2_HIGH = 6.93147180369123816490e-01
_LN2_LOW = 1.90821492927058770002e-10
_UNDERFLOW = -700.0


def lanes(n: int) -> int:
    """Return the padded number of lanes for n sheep."""
    return -(-n // LANES) * LANES


@_exact
def exp_neg(x: float) -> float:
    """e**x for x <= 0 in straight-line code, which the compiler vectorises.

    Relative error below 4e-16 for -700 <= x <= 0; e**-700 for anything smaller. Writes
    x = n log 2 + f with |f| <= log(2)/2, sums the Taylor series of e**f to degree 12
    (remainder f**13/13! < 2e-16) and puts n into the exponent bits.
    """
    x = max(x, _UNDERFLOW)
    n = math.floor(x * _LOG2_E + 0.5)
    f = (x - n * _LN2_HIGH) - n * _LN2_LOW
    p = 1.0 / 479001600.0
    p = p * f + 1.0 / 39916800.0
    p = p * f + 1.0 / 3628800.0
    p = p * f + 1.0 / 362880.0
    p = p * f + 1.0 / 40320.0
    p = p * f + 1.0 / 5040.0
    p = p * f + 1.0 / 720.0
    p = p * f + 1.0 / 120.0
    p = p * f + 1.0 / 24.0
    p = p * f + 1.0 / 6.0
    p = p * f + 0.5
    p = p * f + 1.0
    p = p * f + 1.0
    return p * np.int64((np.int64(np.int32(n)) + 1023) << 52).view(np.float64)


@_inlined
def slope_over_r(r2: float, p: MorseCoefficients) -> float:
    """P'(r) / r of the Morse potential at r**2 = r2, zero at r = 0.

    The gradient of P(|s|) is this times s.
    """
    r = math.sqrt(r2)
    slope = p[2] * exp_neg(-p[3] * r) - p[0] * exp_neg(-p[1] * r)
    return slope / r if r2 > 0.0 else 0.0


@_inlined
def hessian(r2: float, p: MorseCoefficients) -> tuple[float, float]:
    """(a, b) with a w + b (s.w) s = Hessian of P(|s|) times w, zero at s = 0.

    a = P'/r and b = (P'' - P'/r) / r**2, for r**2 = r2 = |s|**2 and p as in slope_over_r.
    """
    r = math.sqrt(r2)
    attraction = p[2] * exp_neg(-p[3] * r)
    repulsion = p[0] * exp_neg(-p[1] * r)
    a = (attraction - repulsion) / r
    b = (p[1] * repulsion - p[3] * attraction - a) / r2
    return (a, b) if r2 > 0.0 else (0.0, 0.0)


@_kernel
def _pull_of_flock(
    xi: float, yi: float, x: Array, y: Array, n: int, p: MorseCoefficients
) -> tuple[float, float]:
    """Sum over the n sheep of the gradient of P(|x_i - x_j|) with respect to x_i."""
    sum_x = 0.0
    sum_y = 0.0
    for j in range(x.shape[0]):
        dx = xi - x[j]
        dy = yi - y[j]
        a = slope_over_r(dx * dx + dy * dy, p)
        a = a if j < n else 0.0
        sum_x += a * dx
        sum_y += a * dy
    return sum_x, sum_y


@_kernel
def _subtract_pull_of_dog(
    ax: Array, ay: Array, x: Array, y: Array, dx: float, dy: float, p: MorseCoefficients
) -> None:
    """Subtract from each sheep's acceleration the gradient of P(|x_i - d|)."""
    for i in range(x.shape[0]):
        sx = x[i] - dx
        sy = y[i] - dy
        a = slope_over_r(sx * sx + sy * sy, p)
        ax[i] -= a * sx
        ay[i] -= a * sy


@_kernel
def acceleration(x: Array, d: Array, physics: Physics, out: Array) -> None:
    """Put the interaction forces on the sheep (paper, state system, no friction) in out."""
    n = physics.n
    out[:] = 0.0
    for i in range(n):
        gx, gy = _pull_of_flock(x[0, i], x[1, i], x[0], x[1], n, physics.sheep)
        out[0, i] = -gx / n
        out[1, i] = -gy / n
    for m in range(d.shape[1]):
        _subtract_pull_of_dog(out[0], out[1], x[0], x[1], d[0, m], d[1, m], physics.dog)
    out[:, n:] = 0.0


@_kernel
def _advance(
    x: Array, v: Array, a: Array, noise: Array, physics: Physics, x_next: Array, v_next: Array
) -> None:
    for i in range(x.shape[0]):
        x_next[i] = x[i] + physics.dt * v[i]
        v_next[i] = v[i] + physics.dt * (a[i] - physics.alpha * v[i]) + noise[i]


@_kernel
def step(
    x: Array,
    v: Array,
    d: Array,
    u: Array,
    noise: Array,
    physics: Physics,
    a: Array,
    x_next: Array,
    v_next: Array,
    d_next: Array,
) -> None:
    """One Euler-Maruyama step; u[M, 2] the control, noise[2, lanes] = sigma dB, a scratch."""
    acceleration(x, d, physics, a)
    for c in range(2):
        _advance(x[c], v[c], a[c], noise[c], physics, x_next[c], v_next[c])
        for m in range(d.shape[1]):
            d_next[c, m] = d[c, m] + physics.dt * u[m, c]


@_kernel
def rollout(
    x: Array, v: Array, d: Array, u: Array, substeps: int, noise: Array, physics: Physics
) -> None:
    """Fill x[K+1, 2, lanes], v, d[K+1, 2, M] from their first entries; noise[K, 2, lanes]."""
    a = np.empty_like(x[0])
    for k in range(noise.shape[0]):
        step(
            x[k], v[k], d[k], u[k // substeps], noise[k], physics, a, x[k + 1], v[k + 1], d[k + 1]
        )


@_kernel
def _add(total: Array, x: Array) -> None:
    for i in range(x.shape[0]):
        total[i] += x[i]


@_kernel
def add_paths(
    total: Array,
    x: Array,
    v: Array,
    d: Array,
    u: Array,
    substeps: int,
    noise: Array,
    physics: Physics,
) -> None:
    """Add the positions along each path to total[K+1, 2, lanes]; noise[paths, K, 2, lanes].

    All paths start from x[2, lanes], v, d[2, M]. No trajectory is stored.
    """
    a = np.empty_like(x)
    # Two states, the present one and the next, take turns.
    xs = np.empty((2, 2, x.shape[1]))
    vs = np.empty((2, 2, x.shape[1]))
    ds = np.empty((2, 2, d.shape[1]))
    steps = noise.shape[1]
    for path in range(noise.shape[0]):
        xs[0] = x
        vs[0] = v
        ds[0] = d
        for k in range(steps):
            i = k % 2
            j = 1 - i
            for c in range(2):
                _add(total[k, c], xs[i, c])
            step(
                xs[i], vs[i], ds[i], u[k // substeps], noise[path, k], physics, a,
                xs[j], vs[j], ds[j],
            )  # fmt: skip
        for c in range(2):
            _add(total[steps, c], xs[steps % 2, c])


@_kernel
def _sum(x: Array) -> float:
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i]
    return total


@_kernel
def _pull_to(
    x: Array, centre: float, error: float, centre_weight: float, spread_weight: float, out: Array
) -> float:
    """Put the derivative of the tracking cost of one coordinate in out; return the cost."""
    squares = 0.0
    for i in range(x.shape[0]):
        offset = x[i] - centre
        squares += offset * offset
        out[i] = centre_weight * error + spread_weight * offset
    return 0.5 * (x.shape[0] * centre_weight * error * error + spread_weight * squares)


@_kernel
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
            cost += _pull_to(
                sheep,
                centre,
                error,
                weight / n * centre_weight,
                weight / n * spread_weight,
                source[k, c, :n],
            )
    return cost


@_kernel
def times(matrix: Array, x: Array, out: Array) -> None:
    """Put matrix[m, n] x[n] in out[m].

    NumPy would hand this to a BLAS whose rounding depends on the number of its threads.
    """
    for i in range(matrix.shape[0]):
        out[i] = _dot(matrix[i], x)


@_kernel
def _dot(x: Array, y: Array) -> float:
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i] * y[i]
    return total


@_kernel
def transposed_times(matrix: Array, y: Array, out: Array) -> None:
    """Put y[m] matrix[m, n] in out[n]."""
    out[:] = 0.0
    for i in range(matrix.shape[0]):
        _add_multiple(y[i], matrix[i], out)


@_kernel
def _add_multiple(factor: float, x: Array, out: Array) -> None:
    for i in range(x.shape[0]):
        out[i] += factor * x[i]


@_kernel
def _hessian_of_flock(
    xi: float,
    yi: float,
    mu_xi: float,
    mu_yi: float,
    x: Array,
    y: Array,
    mu_x: Array,
    mu_y: Array,
    n: int,
    p: MorseCoefficients,
) -> tuple[float, float]:
    """Sum over the n sheep of the Hessian of P(|x_i - x_j|) times (mu_i - mu_j)."""
    sum_x = 0.0
    sum_y = 0.0
    for j in range(x.shape[0]):
        sx = xi - x[j]
        sy = yi - y[j]
        wx = mu_xi - mu_x[j]
        wy = mu_yi - mu_y[j]
        a, b = hessian(sx * sx + sy * sy, p)
        a = a if j < n else 0.0
        b = b if j < n else 0.0
        b *= sx * wx + sy * wy
        sum_x += a * wx + b * sx
        sum_y += a * wy + b * sy
    return sum_x, sum_y


@_kernel
def _subtract_hessian_of_dog(
    lam_x: Array,
    lam_y: Array,
    x: Array,
    y: Array,
    mu_x: Array,
    mu_y: Array,
    dx: float,
    dy: float,
    dt: float,
    p: MorseCoefficients,
) -> tuple[float, float]:
    """Subtract dt times the Hessian of P(|x_i - d|) times mu_i from lam_i; return the sum."""
    sum_x = 0.0
    sum_y = 0.0
    for i in range(x.shape[0]):
        sx = x[i] - dx
        sy = y[i] - dy
        a, b = hessian(sx * sx + sy * sy, p)
        b *= sx * mu_x[i] + sy * mu_y[i]
        hx = dt * (a * mu_x[i] + b * sx)
        hy = dt * (a * mu_y[i] + b * sy)
        lam_x[i] -= hx
        lam_y[i] -= hy
        sum_x += hx
        sum_y += hy
    return sum_x, sum_y


@_kernel
def adjoint(
    x: Array, d: Array, source: Array, substeps: int, physics: Physics, gradient: Array
) -> None:
    """Reverse sweep of rollout: the exact transpose of its linearisation.

    x[K+1, 2, lanes], d[K+1, 2, M] from rollout; source[K+1, 2, lanes] = partial derivative of
    the cost with respect to x, zero in the unused lanes. Adds to gradient[intervals, M, 2]
    the derivative with respect to the control of each interval of `substeps` steps.
    """
    n, dt, alpha = physics.n, physics.dt, physics.alpha
    steps = x.shape[0] - 1
    lam = source[steps].copy()
    lam_next = np.zeros_like(lam)
    mu = np.zeros_like(lam)
    nu = np.zeros((2, d.shape[2]))
    for k in range(steps - 1, -1, -1):
        for m in range(d.shape[2]):
            for c in range(2):
                gradient[k // substeps, m, c] += dt * nu[c, m]
        for i in range(n):
            hx, hy = _hessian_of_flock(
                x[k, 0, i], x[k, 1, i], mu[0, i], mu[1, i], x[k, 0], x[k, 1], mu[0], mu[1], n,
                physics.sheep,
            )  # fmt: skip
            lam_next[0, i] = lam[0, i] + source[k, 0, i] - dt / n * hx
            lam_next[1, i] = lam[1, i] + source[k, 1, i] - dt / n * hy
        for m in range(d.shape[2]):
            hx, hy = _subtract_hessian_of_dog(
                lam_next[0], lam_next[1], x[k, 0], x[k, 1], mu[0], mu[1], d[k, 0, m], d[k, 1, m],
                dt, physics.dog,
            )  # fmt: skip
            nu[0, m] += hx
            nu[1, m] += hy
        for c in range(2):
            for i in range(n):
                mu[c, i] = (1.0 - alpha * dt) * mu[c, i] + dt * lam[c, i]
                lam[c, i] = lam_next[c, i]
