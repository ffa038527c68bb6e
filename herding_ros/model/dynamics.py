"""The crowd's equations of motion in discrete time: Euler-Maruyama.

With x, v, d the sheep's positions and velocities and the dogs' positions, u the dogs'
velocities (the control), P_1 and P_2 the potentials of sheep and dogs (paper, state system):

    x_i' = x_i + dt v_i
    v_i' = v_i + dt (-1/N sum_j grad P_1(x_i - x_j) - sum_m grad P_2(x_i - d_m) - alpha v_i)
               + sigma f(t, x_i) dB_i
    d_m' = d_m + dt u_m

The noise sigma dB is an argument, see `noise`. Without it this is the paper's coarse model, with
it the fine one; there is no other difference.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import os

import numpy as np

from . import fast_forces, kernels
from .crowd import Crowd
from .noise import factor, is_uniform
from .state import Array, finite, HerdState, Trajectory


def physics(crowd: Crowd, n: int, dt: float) -> kernels.Physics:
    """Return what the kernels need to know about n sheep and steps of dt [s]."""
    if not (np.isfinite(dt) and dt > 0.0):
        raise ValueError(f'the time step dt is {dt!r}, allowed is a number above 0')
    sheep = kernels.divided(crowd.sheep.kernel_form(), n)
    return kernels.Physics(n, float(dt), sheep, crowd.dog.kernel_form(), crowd.friction)


def to_lanes(points: Array) -> Array:
    """Return points (N, 2) as the kernels want them: (2, lanes), unused lanes zero."""
    out = np.zeros((2, kernels.lanes(len(points))))
    out[:, : len(points)] = points.T
    return out


def forces(crowd: Crowd, x: Array, d: Array, accuracy: float = fast_forces.ACCURACY) -> Array:
    """Interaction forces (N, 2) [m/s^2] on sheep at x (N, 2) [m] from each other and dogs d.

    With many sheep the error is up to `accuracy`, relative in the Euclidean norm over all.
    """
    n, lanes = len(x), to_lanes(x)
    dogs, constants = np.ascontiguousarray(d.T), physics(crowd, n, 1.0)
    if n < fast_forces.CROSSOVER:
        out = np.empty_like(lanes)
        kernels.acceleration(lanes, dogs, constants, np.zeros((2, 2, 2 * lanes.shape[1])), out)
    else:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            sums = fast_forces.plan(crowd.sheep, lanes, n, accuracy, pool.map)
            out = _acceleration(sums, lanes, dogs, constants)
    return out[:, :n].T


def _acceleration(sums: fast_forces.Sums, x: Array, d: Array, constants: kernels.Physics) -> Array:
    """Do what `kernels.acceleration` does, with forces of sheep from `sums`."""
    out = -sums.gradients(x)
    kernels.subtract_pulls(*out, *x, d, constants.dog)
    out[:, constants.n :] = 0.0
    return out


def check_control(u: Array, dogs: int) -> Array:
    """Return the control as a contiguous array (intervals, M, 2), or raise ValueError."""
    return np.ascontiguousarray(finite('control u', u, (None, dogs, 2)))


def rollout(
    crowd: Crowd,
    state: HerdState,
    u: Array,
    dt: float,
    substeps: int = 1,
    noise: Array | None = None,
    t: float = 0.0,
) -> Trajectory:
    """Integrate the herd from state under the control u.

    u (intervals, M, 2) [m/s] is constant on intervals of `substeps` steps of dt [s]. noise
    (intervals * substeps, 2, lanes) [m/s] comes from `increments`; None is the coarse model. The
    rollout starts at t [s], which counts when the noise depends on time.
    """
    n, m = len(state.x), len(state.d)
    u = check_control(u, m)
    steps = len(u) * substeps
    shape = (steps, 2, kernels.lanes(n))
    uniform = noise is None or is_uniform(crowd.noise_field)
    if noise is None:
        noise = np.zeros(shape)
    if noise.shape != shape:
        raise ValueError(f'noise has shape {noise.shape}, allowed is {shape}')
    xs = np.empty((steps + 1, *shape[1:]))
    vs = np.empty_like(xs)
    ds = np.empty((steps + 1, 2, m))
    xs[0], vs[0], ds[0] = to_lanes(state.x), to_lanes(state.v), state.d.T
    constants = physics(crowd, n, dt)

    def noise_of(k: int) -> Array:
        if uniform:
            return noise[k]
        scaled = np.zeros(shape[1:])
        scaled[:, :n] = factor(crowd, t + k * dt, xs[k, :, :n]) * noise[k, :, :n]
        return scaled

    if n >= fast_forces.CROSSOVER:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for k, sums in enumerate(fast_forces.plans(crowd.sheep, xs[:-1], n, pool.map)):
                held, a = u[k // substeps], _acceleration(sums, xs[k], ds[k], constants)
                then = xs[k + 1], vs[k + 1], ds[k + 1]
                kernels.step(xs[k], vs[k], ds[k], held, a, noise_of(k), constants, *then)
    elif uniform:
        kernels.rollout(xs, vs, ds, u, substeps, noise, constants)
    else:
        for k in range(steps):
            here, held = slice(k, k + 2), u[k // substeps, None]
            kernels.rollout(xs[here], vs[here], ds[here], held, 1, noise_of(k)[None], constants)
    return Trajectory(dt, n, xs, vs, ds)


def reverse_sweep(crowd: Crowd, trajectory: Trajectory, source: Array, substeps: int) -> Array:
    """Return the derivative of a cost with respect to the control, (intervals, M, 2).

    source (K+1, 2, lanes) is its partial derivative with respect to the trajectory's xs, zero
    in the unused lanes; substeps as in `rollout`. Exact for the scheme and the forces of the
    rollout.
    """
    n, dt, xs, ds = trajectory.n, trajectory.dt, trajectory.xs, trajectory.ds
    constants = physics(crowd, n, dt)
    steps = len(xs) - 1
    gradient = np.zeros((steps // substeps, ds.shape[2], 2))
    if n < fast_forces.CROSSOVER:
        kernels.adjoint(xs, ds, source, substeps, constants, gradient)
        return gradient
    lam, mu, nu = source[steps].copy(), np.zeros_like(xs[0]), np.zeros_like(ds[0])
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        plans = list(fast_forces.plans(crowd.sheep, xs[:-1], n, pool.map))
        for k in range(steps - 1, -1, -1):
            gradient[k // substeps] += dt * nu.T
            h = plans[k].hessian_products(xs[k], mu)
            kernels.add_hessians_of_dogs(*h, *xs[k], *mu, ds[k], dt, nu, constants.dog)
            for c in range(2):
                kernels.retreat(
                    lam[c, :n], mu[c, :n], h[c, :n], source[k, c, :n], dt, crowd.friction
                )
    return gradient
