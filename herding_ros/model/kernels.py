# SPDX-License-Identifier: Apache-2.0
"""The compiled inner loops: one time step of the sheep, its adjoint, and the sweeps over them.

Everything here works on plain arrays laid out for vector units: coordinates first, sheep
last and contiguous, padded with unused lanes to a multiple of LANES. Sheep are x[2, lanes] and
v[2, lanes], dogs d[2, M]; dogs do not depend on sheep, so their path is an argument. Kernels
that call each other sit in one file because Numba's on-disk cache notices a changed file, but
not a changed import.

Symbols are those of the paper: alpha friction, mu and lam the adjoints of v and x.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .alignment import AlignmentForm
from .external_force import (
    add_external_forces,
    add_external_products,
    add_external_products_of_sweeps,
    ExternalForm,
)
from .jit import inlined, kernel
from .potentials.forms import exp_neg, hessian, PotentialForm, slope_over_r
from .state import Array

LANES = 8
"""Sheep are padded to a multiple of this: one AVX-512 register of doubles, two of AVX2."""

PATHS = 16
"""Paths, or reverse sweeps, that are done at once, side by side in memory.

Loops over them have a fixed length that the compiler sees. With 8 it would unroll them before
it vectorises.
"""


@inlined
def lanes(n: int) -> int:
    """Return the padded number of lanes for n sheep."""
    return -(-n // LANES) * LANES


class Physics(NamedTuple):
    """What a step needs besides the state: numbers that stay the same along a rollout.

    The potential of the sheep is divided by n, their number. external is the form of an
    `ExternalForce`, (): none. order is that of the motion in time: 2, or 1 without inertia, which
    takes an alpha above 0, and an alignment of rate 0: none. Numba tells its type without
    asking Python, which would take a fifth of the time of a small flock's rollout.
    """

    n: int
    dt: float
    sheep: PotentialForm
    dog: PotentialForm
    alpha: float
    external: ExternalForm = ()
    order: int = 2
    alignment: AlignmentForm = (0.0, 0.0)


@inlined
def _exchange_forces(
    ax: Array,
    ay: Array,
    bx: Array,
    by: Array,
    x: Array,
    y: Array,
    xs: Array,
    ys: Array,
    count: int,
    p: PotentialForm,
) -> None:
    """Subtract the gradients of P(|x_i - xs_i|) from a_i and add them to b_i, for i < count."""
    for i in range(x.shape[0]):
        sx = x[i] - xs[i]
        sy = y[i] - ys[i]
        a = slope_over_r(sx * sx + sy * sy, p)
        a = a if i < count else 0.0
        ax[i] -= a * sx
        ay[i] -= a * sy
        bx[i] += a * sx
        by[i] += a * sy


@kernel
def _forces_round(
    ax: Array,
    ay: Array,
    bx: Array,
    by: Array,
    x: Array,
    y: Array,
    xs: Array,
    ys: Array,
    n: int,
    p: PotentialForm,
) -> None:
    """Exchange forces with the next in the ring, the second next, ... up to half-way round.

    xs, ys are the positions twice one after the other, bx, by take the reactions. Rows come as
    arguments, since every slice in a caller costs two atomic reference counts.
    """
    for s in range(1, n // 2 + 1):
        count = n if 2 * s < n else s  # half-way round, one force of two
        m = lanes(count)
        _exchange_forces(
            ax[:m], ay[:m], bx[s : s + m], by[s : s + m],
            x[:m], y[:m], xs[s : s + m], ys[s : s + m], count, p,
        )  # fmt: skip


@inlined
def _subtract_gradients_of_one(
    ax: Array, ay: Array, x: Array, y: Array, dx: float, dy: float, p: PotentialForm
) -> None:
    """Subtract from each sheep's acceleration the gradient of P(|x_i - d|)."""
    for i in range(x.shape[0]):
        sx = x[i] - dx
        sy = y[i] - dy
        a = slope_over_r(sx * sx + sy * sy, p)
        ax[i] -= a * sx
        ay[i] -= a * sy


@kernel
def subtract_gradients(
    ax: Array, ay: Array, x: Array, y: Array, d: Array, p: PotentialForm
) -> None:
    """Subtract from each sheep's acceleration the gradients of P(|x_i - d_m|), d[2, M]."""
    for m in range(d.shape[1]):
        _subtract_gradients_of_one(ax, ay, x, y, d[0, m], d[1, m], p)


@kernel
def add_outer_forces(ax: Array, ay: Array, x: Array, y: Array, d: Array, physics: Physics) -> None:
    """Add to each sheep's acceleration the forces of the dogs d[2, M] and of the world."""
    subtract_gradients(ax, ay, x, y, d, physics.dog)
    add_external_forces(ax, ay, x, y, physics.external)


@inlined
def _alignment_weight(r2: float, form: AlignmentForm) -> float:
    return form[0] * exp_neg(-form[1] * r2)


@inlined
def _exchange_velocities(
    ax: Array, ay: Array, x: Array, y: Array, vx: Array, vy: Array, i: int, form: AlignmentForm
) -> None:
    """Align sheep i and those before it."""
    xi, yi, vxi, vyi = x[i], y[i], vx[i], vy[i]
    sum_x = 0.0
    sum_y = 0.0
    for j in range(i):
        sx = xi - x[j]
        sy = yi - y[j]
        w = _alignment_weight(sx * sx + sy * sy, form)
        bx = w * (vxi - vx[j])
        by = w * (vyi - vy[j])
        ax[j] += bx
        ay[j] += by
        sum_x += bx
        sum_y += by
    ax[i] -= sum_x
    ay[i] -= sum_y


@kernel
def _align(
    ax: Array, ay: Array, x: Array, y: Array, vx: Array, vy: Array, n: int, form: AlignmentForm
) -> None:
    for i in range(n):
        _exchange_velocities(ax, ay, x, y, vx, vy, i, form)


@kernel
def add_alignment(x: Array, v: Array, physics: Physics, out: Array) -> None:
    """Add sum_j w(|x_i - x_j|) (v_j - v_i) to the accelerations, see `alignment`."""
    if physics.alignment[0] > 0.0:
        _align(out[0], out[1], x[0], x[1], v[0], v[1], physics.n, physics.alignment)


@kernel
def alignment_rates(x: Array, n: int, form: AlignmentForm, out: Array) -> None:
    """Put sum_{j != i} w(|x_i - x_j|) in out[n]."""
    out[:] = 0.0
    for i in range(n):
        for j in range(i):
            sx = x[0, i] - x[0, j]
            sy = x[1, i] - x[1, j]
            weight = _alignment_weight(sx * sx + sy * sy, form)
            out[i] += weight
            out[j] += weight


@kernel
def _fill(x: Array, first: int, value: float) -> None:
    """Put value in x[2, first:]."""
    for c in range(2):
        for i in range(first, x.shape[1]):
            x[c, i] = value


@kernel
def _repeat(x: Array, n: int, out: Array) -> None:
    """Put x[2, :n], twice one after the other, in out[2, :]."""
    for c in range(2):
        for i in range(n):
            out[c, i] = x[c, i]
            out[c, n + i] = x[c, i]


@kernel
def _fold(b: Array, n: int, out: Array) -> None:
    """Add b[2, :2 n], laid over itself after n, to out[2, :n]."""
    for c in range(2):
        for i in range(n):
            out[c, i] += b[c, i] + b[c, n + i]


@kernel
def acceleration(x: Array, v: Array, d: Array, physics: Physics, ring: Array, out: Array) -> None:
    """Put the forces on the sheep (paper, state system) and their alignment, not friction, in out.

    Action and reaction are opposite, so each pair is evaluated once: each sheep of a ring acts on
    the next, the second next, ... up to half-way round. ring[2, 2, 2 lanes] is scratch.
    """
    n = physics.n
    _fill(out, 0, 0.0)
    twice, reaction = ring[0], ring[1]
    _repeat(x, n, twice)
    _fill(reaction, 0, 0.0)
    _forces_round(
        out[0], out[1], reaction[0], reaction[1], x[0], x[1], twice[0], twice[1], n, physics.sheep
    )
    _fold(reaction, n, out)
    add_outer_forces(out[0], out[1], x[0], x[1], d, physics)
    add_alignment(x, v, physics, out)
    _fill(out, n, 0.0)


@inlined
def _subtract_gradients_of_pair(
    ax: Array, ay: Array, x: Array, y: Array, i: int, j: int, p: PotentialForm
) -> None:
    """Subtract the gradient of P(|x_i - x_j|) from both accelerations, in PATHS paths."""
    for path in range(PATHS):
        sx = x[i + path] - x[j + path]
        sy = y[i + path] - y[j + path]
        a = slope_over_r(sx * sx + sy * sy, p)
        ax[i + path] -= a * sx
        ay[i + path] -= a * sy
        ax[j + path] += a * sx
        ay[j + path] += a * sy


@kernel
def _subtract_gradients_in_paths(
    ax: Array, ay: Array, x: Array, y: Array, p: PotentialForm
) -> None:
    for i in range(0, x.shape[0], PATHS):
        for j in range(0, i, PATHS):
            _subtract_gradients_of_pair(ax, ay, x, y, i, j, p)


@inlined
def _align_pair(
    ax: Array, ay: Array, x: Array, y: Array, vx: Array, vy: Array, i: int, j: int,
    form: AlignmentForm,
) -> None:  # fmt: skip
    for path in range(PATHS):
        sx = x[i + path] - x[j + path]
        sy = y[i + path] - y[j + path]
        w = _alignment_weight(sx * sx + sy * sy, form)
        bx = w * (vx[i + path] - vx[j + path])
        by = w * (vy[i + path] - vy[j + path])
        ax[i + path] -= bx
        ay[i + path] -= by
        ax[j + path] += bx
        ay[j + path] += by


@kernel
def _align_in_paths(
    ax: Array, ay: Array, x: Array, y: Array, vx: Array, vy: Array, form: AlignmentForm
) -> None:
    for i in range(0, x.shape[0], PATHS):
        for j in range(0, i, PATHS):
            _align_pair(ax, ay, x, y, vx, vy, i, j, form)


@kernel
def acceleration_in_paths(x: Array, v: Array, d: Array, physics: Physics, out: Array) -> None:
    """Do what `acceleration` does for PATHS paths at once: x, v, out[2, sheep * PATHS].

    The paths of a sheep lie side by side, so that a vector unit takes the same pair in many
    paths. Then each pair is evaluated once: action and reaction are opposite. With more than
    physics.n sheep, each group of n, one after the other, is a flock of its own.
    """
    out[:] = 0.0
    group = physics.n * PATHS
    if physics.n > 1:
        for first in range(0, x.shape[1], group):
            # Seen from the start of the group no index is negative.
            _subtract_gradients_in_paths(
                out[0, first : first + group], out[1, first : first + group],
                x[0, first : first + group], x[1, first : first + group], physics.sheep,
            )  # fmt: skip
            if physics.alignment[0] > 0.0:
                _align_in_paths(
                    out[0, first : first + group], out[1, first : first + group],
                    x[0, first : first + group], x[1, first : first + group],
                    v[0, first : first + group], v[1, first : first + group], physics.alignment,
                )  # fmt: skip
    add_outer_forces(out[0], out[1], x[0], x[1], d, physics)


@inlined
def step(
    x: Array, v: Array, a: Array, noise: Array, physics: Physics, x_next: Array, v_next: Array
) -> None:
    """One Euler-Maruyama step of the sheep; a the acceleration, noise = sigma dB.

    All are [2, lanes]. x_next and v_next may be x and v themselves. Without inertia v has no
    effect, and v_next is the velocity a / alpha that a alone gives.
    """
    dt, alpha = physics.dt, physics.alpha
    for c in range(2):
        if physics.order == 1:
            for i in range(x.shape[1]):
                velocity = a[c, i] / alpha
                x_next[c, i] = x[c, i] + dt * velocity + noise[c, i] / alpha
                v_next[c, i] = velocity
        else:
            for i in range(x.shape[1]):
                velocity = v[c, i]
                x_next[c, i] = x[c, i] + dt * velocity
                v_next[c, i] = velocity + dt * (a[c, i] - alpha * velocity) + noise[c, i]


@kernel
def rollout(x: Array, v: Array, d: Array, noise: Array, physics: Physics) -> None:
    """Fill x[K+1, 2, lanes] and v from their first entries.

    d[K+1, 2, M] is the path of the dogs, noise[K, 2, lanes] as in `step`.
    """
    a = np.empty_like(x[0])
    ring = np.zeros((2, 2, 2 * x.shape[2]))
    for k in range(noise.shape[0]):
        acceleration(x[k], v[k], d[k], physics, ring, a)
        step(x[k], v[k], a, noise[k], physics, x[k + 1], v[k + 1])


@inlined
def _add_over_sheep(x: Array, paths: int, factor: float, out: Array) -> None:
    """Add factor times the sum over the sheep in x[sheep * paths] to out[paths]."""
    for i in range(0, x.shape[0], paths):
        for path in range(paths):
            out[path] += factor * x[i + path]


@kernel
def centres(x: Array, v: Array, d: Array, noise: Array, physics: Physics, out: Array) -> None:
    """Put the sheep's centres in some paths in out[K+1, 2, paths].

    x, v[2, sheep] is the start of all paths, d[K+1, 2, M] the dogs, noise[K, 2, sheep * paths]
    has a sheep's paths side by side. Each group of physics.n sheep is a flock of its own; with
    n > 1 there have to be PATHS paths.
    """
    sheep, paths = x.shape[1], out.shape[2]
    xs = np.empty((2, sheep * paths))
    vs = np.empty_like(xs)
    a = np.empty_like(xs)
    for c in range(2):
        for i in range(sheep):
            xs[c, i * paths : (i + 1) * paths] = x[c, i]
            vs[c, i * paths : (i + 1) * paths] = v[c, i]
    out[:] = 0.0
    for k in range(out.shape[0]):
        for c in range(2):
            _add_over_sheep(xs[c], paths, 1.0 / sheep, out[k, c])
        if k < noise.shape[0]:
            acceleration_in_paths(xs, vs, d[k], physics, a)
            step(xs, vs, a, noise[k], physics, xs, vs)


@kernel
def free_centres(noise: Array, sheep: int, physics: Physics, out: Array) -> None:
    """Put what noise[K, 2, sheep * paths] does to the centre of free sheep in out[K+1, 2, paths].

    Besides the noise only friction acts on free sheep; they start at rest in the origin.
    """
    paths = out.shape[2]
    x = np.zeros((2, paths))
    v = np.zeros_like(x)
    no_force = np.zeros_like(x)
    mean = np.empty_like(x)
    out[0] = 0.0
    for k in range(noise.shape[0]):
        mean[:] = 0.0
        for c in range(2):
            _add_over_sheep(noise[k, c], paths, 1.0 / sheep, mean[c])
        step(x, v, no_force, mean, physics, x, v)
        out[k + 1] = x


@inlined
def _exchange_hessians(
    hx: Array,
    hy: Array,
    gx: Array,
    gy: Array,
    x: Array,
    y: Array,
    xs: Array,
    ys: Array,
    mu_x: Array,
    mu_y: Array,
    mu_xs: Array,
    mu_ys: Array,
    count: int,
    p: PotentialForm,
) -> None:
    """Add the Hessians of P(|x_i - xs_i|) times (mu_i - mus_i) to h_i, subtract them from g_i."""
    for i in range(x.shape[0]):
        sx = x[i] - xs[i]
        sy = y[i] - ys[i]
        wx = mu_x[i] - mu_xs[i]
        wy = mu_y[i] - mu_ys[i]
        a, b = hessian(sx * sx + sy * sy, p)
        a = a if i < count else 0.0
        b = b if i < count else 0.0
        b *= sx * wx + sy * wy
        ax = a * wx + b * sx
        ay = a * wy + b * sy
        hx[i] += ax
        hy[i] += ay
        gx[i] -= ax
        gy[i] -= ay


@kernel
def _hessians_round(
    hx: Array,
    hy: Array,
    gx: Array,
    gy: Array,
    x: Array,
    y: Array,
    xs: Array,
    ys: Array,
    mu_x: Array,
    mu_y: Array,
    mu_xs: Array,
    mu_ys: Array,
    n: int,
    p: PotentialForm,
) -> None:
    """Go round the ring as `_forces_round` does."""
    for s in range(1, n // 2 + 1):
        count = n if 2 * s < n else s
        m = lanes(count)
        _exchange_hessians(
            hx[:m], hy[:m], gx[s : s + m], gy[s : s + m],
            x[:m], y[:m], xs[s : s + m], ys[s : s + m],
            mu_x[:m], mu_y[:m], mu_xs[s : s + m], mu_ys[s : s + m],
            count, p,
        )  # fmt: skip


@inlined
def _add_hessian_of_dog(
    hx: Array,
    hy: Array,
    x: Array,
    y: Array,
    mu_x: Array,
    mu_y: Array,
    dx: float,
    dy: float,
    p: PotentialForm,
) -> tuple[float, float]:
    """Add the Hessian of P(|x_i - d|) times mu_i to h_i; return the sum over i."""
    sum_x = 0.0
    sum_y = 0.0
    for i in range(x.shape[0]):
        sx = x[i] - dx
        sy = y[i] - dy
        a, b = hessian(sx * sx + sy * sy, p)
        b *= sx * mu_x[i] + sy * mu_y[i]
        ax = a * mu_x[i] + b * sx
        ay = a * mu_y[i] + b * sy
        hx[i] += ax
        hy[i] += ay
        sum_x += ax
        sum_y += ay
    return sum_x, sum_y


@kernel
def add_hessians_of_dogs(
    hx: Array,
    hy: Array,
    x: Array,
    y: Array,
    mu_x: Array,
    mu_y: Array,
    d: Array,
    source: Array,
    p: PotentialForm,
) -> None:
    """Add Hessians of P(|x_i - d_m|) times mu_i to h_i, and put their sums in source[2, M]."""
    for m in range(d.shape[1]):
        source[0, m], source[1, m] = _add_hessian_of_dog(
            hx, hy, x, y, mu_x, mu_y, d[0, m], d[1, m], p
        )


@kernel
def hessian_products(
    x: Array, mu: Array, n: int, p: PotentialForm, ring: Array, out: Array
) -> None:
    """Put sum_j Hessian P(|x_i - x_j|) (mu_i - mu_j) in out, visiting pairs as `acceleration`.

    ring[3, 2, 2 lanes] is scratch.
    """
    twice, mu_twice, reaction = ring[0], ring[1], ring[2]
    _fill(out, 0, 0.0)
    _repeat(x, n, twice)
    _repeat(mu, n, mu_twice)
    _fill(reaction, 0, 0.0)
    _hessians_round(
        out[0], out[1], reaction[0], reaction[1], x[0], x[1], twice[0], twice[1],
        mu[0], mu[1], mu_twice[0], mu_twice[1], n, p,
    )  # fmt: skip
    _fold(reaction, n, out)


@kernel
def adjoint(x: Array, v: Array, d: Array, source: Array, physics: Physics, dogs: Array) -> None:
    """Reverse sweep of rollout: the exact transpose of its linearisation.

    x[K+1, 2, lanes] and v from rollout along the path d[K+1, 2, M] of the dogs;
    source[K+1, 2, lanes] = partial derivative of the cost with respect to x, zero in the unused
    lanes. Puts the derivative with respect to d, per unit of time, in dogs[K+1, 2, M]. Visits the
    pairs as `acceleration` does.
    """
    steps = x.shape[0] - 1
    lam = source[steps].copy()
    mu = np.zeros_like(lam)
    h = np.empty_like(lam)
    ring = np.zeros((3, 2, 2 * x.shape[2]))
    dogs[steps] = 0.0
    for k in range(steps - 1, -1, -1):
        follow_positions(lam, mu, physics)
        hessian_products(x[k], mu, physics.n, physics.sheep, ring, h)
        adjoint_step(x[k], v[k], d[k], source[k], physics, h, lam, mu, dogs[k])


@inlined
def follow_positions(lam: Array, mu: Array, physics: Physics) -> None:
    """Put lam / alpha in mu if sheep have no inertia: their velocities are no state of their own.

    lam and mu are [2, ...]; of mu only as much as lam has is written.
    """
    if physics.order == 1:
        for c in range(2):
            for i in range(lam.shape[1]):
                mu[c, i] = lam[c, i] / physics.alpha


@inlined
def _align_adjoints(
    hx: Array, hy: Array, gx: Array, gy: Array, x: Array, y: Array, vx: Array, vy: Array,
    mu_x: Array, mu_y: Array, i: int, form: AlignmentForm,
) -> None:  # fmt: skip
    """Do what `_add_alignment_products` says for sheep i and those before it."""
    xi, yi, vxi, vyi, mu_xi, mu_yi = x[i], y[i], vx[i], vy[i], mu_x[i], mu_y[i]
    sum_hx = 0.0
    sum_hy = 0.0
    sum_gx = 0.0
    sum_gy = 0.0
    for j in range(i):
        sx = xi - x[j]
        sy = yi - y[j]
        wx = mu_xi - mu_x[j]
        wy = mu_yi - mu_y[j]
        weight = _alignment_weight(sx * sx + sy * sy, form)
        b = 2.0 * form[1] * weight * ((vxi - vx[j]) * wx + (vyi - vy[j]) * wy)
        hx[j] += b * sx
        hy[j] += b * sy
        gx[j] += weight * wx
        gy[j] += weight * wy
        sum_hx += b * sx
        sum_hy += b * sy
        sum_gx += weight * wx
        sum_gy += weight * wy
    hx[i] -= sum_hx
    hy[i] -= sum_hy
    gx[i] -= sum_gx
    gy[i] -= sum_gy


@kernel
def _add_alignment_products(
    hx: Array, hy: Array, gx: Array, gy: Array, x: Array, y: Array, vx: Array, vy: Array,
    mu_x: Array, mu_y: Array, n: int, form: AlignmentForm,
) -> None:  # fmt: skip
    """Add the transposed derivative of alignment by v, times mu, to g; subtract that by x from h.

    With s = x_i - x_j and w = w(|s|) the first is sum_j w (mu_j - mu_i), the alignment of mu, and
    the second, since grad w = -w s / l^2, sum_j w / l^2 (v_i - v_j).(mu_i - mu_j) s.
    """
    for i in range(n):
        _align_adjoints(hx, hy, gx, gy, x, y, vx, vy, mu_x, mu_y, i, form)


@kernel
def _add_times(factor: float, g: Array, out: Array) -> None:
    """Add factor times g[2, ...] to as much of out[2, ...]."""
    for c in range(2):
        for i in range(g.shape[1]):
            out[c, i] += factor * g[c, i]


@inlined
def adjoint_step(
    x: Array, v: Array, d: Array, source: Array, physics: Physics, h: Array, lam: Array,
    mu: Array, dogs: Array,
) -> None:  # fmt: skip
    """One step back in time, as in `adjoint`; h holds the `hessian_products` of the sheep.

    It takes the mu of `follow_positions`.
    """
    n = physics.n
    add_hessians_of_dogs(h[0], h[1], x[0], x[1], mu[0], mu[1], d, dogs, physics.dog)
    add_external_products(h, x, mu, physics.external)
    aligned = np.zeros((2, n if physics.alignment[0] > 0.0 else 0))
    if physics.alignment[0] > 0.0:
        _add_alignment_products(
            h[0], h[1], aligned[0], aligned[1], x[0], x[1], v[0], v[1], mu[0], mu[1], n,
            physics.alignment,
        )  # fmt: skip
    for c in range(2):
        _step_back(lam[c, :n], mu[c, :n], h[c, :n], source[c, :n], physics.dt, physics.alpha)
    _add_times(physics.dt, aligned, mu)


@inlined
def _step_back(lam: Array, mu: Array, h: Array, source: Array, dt: float, alpha: float) -> None:
    """The transpose of `step`; h the products of all Hessians with mu.

    Without inertia the next `follow_positions` replaces mu.
    """
    for i in range(lam.shape[0]):
        mu_i = mu[i]
        mu[i] = (1.0 - alpha * dt) * mu_i + dt * lam[i]
        lam[i] += source[i] - dt * h[i]


@kernel
def _hessians_at(
    source_x: float, source_y: float, x: Array, y: Array, p: PotentialForm,
    xx: Array, xy: Array, yy: Array,
) -> None:  # fmt: skip
    for i in range(x.shape[0]):
        sx = x[i] - source_x
        sy = y[i] - source_y
        a, b = hessian(sx * sx + sy * sy, p)
        xx[i] = a + b * sx * sx
        xy[i] = b * sx * sy
        yy[i] = a + b * sy * sy


@kernel
def _hessians(sources: Array, x: Array, p: PotentialForm, out: Array) -> None:
    """Put xx, xy and yy of the Hessians of P(|x_i - source_j|) in out[j, 3, i]."""
    for j in range(sources.shape[1]):
        _hessians_at(sources[0, j], sources[1, j], x[0], x[1], p, out[j, 0], out[j, 1], out[j, 2])


@inlined
def _add_product_of_pair(
    hx: Array, hy: Array, mu_x: Array, mu_y: Array, i: int, j: int, xx: float, xy: float,
    yx: float, yy: float,
) -> None:  # fmt: skip
    """Add a matrix times (mu_i - mu_j) to h_i, and its opposite to h_j, in PATHS sweeps."""
    for k in range(PATHS):
        wx = mu_x[i + k] - mu_x[j + k]
        wy = mu_y[i + k] - mu_y[j + k]
        gx = xx * wx + xy * wy
        gy = yx * wx + yy * wy
        hx[i + k] += gx
        hy[i + k] += gy
        hx[j + k] -= gx
        hy[j + k] -= gy


@kernel
def _add_hessians_of_pairs(
    hx: Array, hy: Array, mu_x: Array, mu_y: Array, n: int, flock: Array, dog: Array
) -> None:
    """Add all Hessians times the differences of mu[(n + M) * PATHS] to h.

    flock[n, 3, lanes] and dog[M, 3, lanes] are from `_hessians`. Dogs come after the sheep.
    """
    for i in range(n):
        for j in range(i):
            xx, xy, yy = flock[i, 0, j], flock[i, 1, j], flock[i, 2, j]
            _add_product_of_pair(hx, hy, mu_x, mu_y, i * PATHS, j * PATHS, xx, xy, xy, yy)
        for m in range(dog.shape[0]):
            xx, xy, yy = dog[m, 0, i], dog[m, 1, i], dog[m, 2, i]
            _add_product_of_pair(hx, hy, mu_x, mu_y, i * PATHS, (n + m) * PATHS, xx, xy, xy, yy)


@kernel
def _add_alignment_products_of_sweeps(
    hx: Array, hy: Array, gx: Array, gy: Array, x: Array, v: Array, mu_x: Array, mu_y: Array,
    n: int, form: AlignmentForm,
) -> None:  # fmt: skip
    """Do so for PATHS mu of each of n sheep, side by side in mu, h and g."""
    for i in range(n):
        for j in range(i):
            sx, sy = x[0, i] - x[0, j], x[1, i] - x[1, j]
            vx, vy = v[0, i] - v[0, j], v[1, i] - v[1, j]
            w = _alignment_weight(sx * sx + sy * sy, form)
            b = -2.0 * form[1] * w
            _add_product_of_pair(
                hx, hy, mu_x, mu_y, i * PATHS, j * PATHS,
                b * sx * vx, b * sx * vy, b * sy * vx, b * sy * vy,
            )  # fmt: skip
            _add_product_of_pair(gx, gy, mu_x, mu_y, i * PATHS, j * PATHS, -w, 0.0, 0.0, -w)


@kernel
def centre_adjoints(
    x: Array, v: Array, d: Array, nodes: Array, physics: Physics, dogs: Array
) -> None:
    """Do PATHS reverse sweeps at once, each as `adjoint` does: for the centre at some steps.

    Lane 2 q + c is for coordinate c of the sheep's centre at step nodes[q] >= 1, with
    PATHS / 2 nodes; zeros fill up. Puts the derivatives with respect to the path of the dogs,
    per unit of time, in dogs[K+1, 2, M * PATHS].
    """
    n = physics.n
    flock = np.empty((n, 3, x.shape[2]))
    dog = np.empty((d.shape[2], 3, x.shape[2]))
    # Sheep, then dogs, whose mu is zero: velocities do not depend on the controls.
    sheep = n * PATHS
    lam = np.zeros((2, sheep))
    no_source = np.zeros(sheep)
    mu = np.zeros((2, sheep + d.shape[2] * PATHS))
    h = np.empty_like(mu)
    aligned = np.zeros((2, sheep if physics.alignment[0] > 0.0 else 0))
    last = nodes.max()
    dogs[last:] = 0.0
    for k in range(last, -1, -1):
        if k < last:
            follow_positions(lam, mu, physics)
            _hessians(x[k, :, :n], x[k], physics.sheep, flock)
            _hessians(d[k], x[k], physics.dog, dog)
            h[:] = 0.0
            _add_hessians_of_pairs(h[0], h[1], mu[0], mu[1], n, flock, dog)
            np.negative(h[:, sheep:], dogs[k])
            add_external_products_of_sweeps(h, x[k], mu, n, PATHS, physics.external)
            if physics.alignment[0] > 0.0:
                aligned[:] = 0.0
                _add_alignment_products_of_sweeps(
                    h[0], h[1], aligned[0], aligned[1], x[k], v[k], mu[0], mu[1], n,
                    physics.alignment,
                )  # fmt: skip
            for c in range(2):
                _step_back(
                    lam[c], mu[c, :sheep], h[c, :sheep], no_source, physics.dt, physics.alpha
                )
            _add_times(physics.dt, aligned, mu)
        for q in range(nodes.shape[0]):
            if nodes[q] == k:
                for c in range(2):
                    lam[c, 2 * q + c :: PATHS] += 1.0 / n
