"""The crowd's equations of motion in discrete time: Euler-Maruyama.

With x, v, d the sheep's positions and velocities and the dogs' positions, u the dogs'
velocities (the control), P_1 and P_2 the potentials of sheep and dogs (paper, state system):

    x_i' = x_i + dt v_i
    v_i' = v_i + dt (-1/N sum_j grad P_1(x_i - x_j) - sum_m grad P_2(x_i - d_m) - alpha v_i)
               + sigma dB_i
    d_m' = d_m + dt u_m

The noise sigma dB is an argument. Without it this is the paper's coarse model, with it the
fine one; there is no other difference.
"""

from __future__ import annotations

import numpy as np

from . import kernels
from .crowd import Crowd
from .state import Array, finite, HerdState, Trajectory


def physics(crowd: Crowd, n: int, dt: float) -> kernels.Physics:
    """Return what the kernels need to know about n sheep and steps of dt [s]."""
    if not (np.isfinite(dt) and dt > 0.0):
        raise ValueError(f'the time step dt is {dt!r}, allowed is a number above 0')
    repulsion, repulsion_rate, attraction, attraction_rate = crowd.sheep.coefficients
    sheep = (repulsion / n, repulsion_rate, attraction / n, attraction_rate)
    return kernels.Physics(n, float(dt), sheep, crowd.dog.coefficients, crowd.friction)


def to_lanes(points: Array) -> Array:
    """Return points (N, 2) as the kernels want them: (2, lanes), unused lanes zero."""
    out = np.zeros((2, kernels.lanes(len(points))))
    out[:, : len(points)] = points.T
    return out


def forces(crowd: Crowd, x: Array, d: Array) -> Array:
    """Interaction forces (N, 2) [m/s^2] on sheep at x (N, 2) [m] from each other and dogs d."""
    lanes = to_lanes(x)
    out = np.empty_like(lanes)
    ring = np.zeros((2, 2, 2 * lanes.shape[1]))
    constants = physics(crowd, len(x), 1.0)
    kernels.acceleration(lanes, np.ascontiguousarray(d.T), constants, ring, out)
    return out[:, : len(x)].T


def increments(rng: np.random.Generator, crowd: Crowd, n: int, dt: float, steps: int) -> Array:
    """Draw sigma dB for n sheep: (steps, 2, lanes) [m/s], dB ~ N(0, dt) each."""
    noise = np.zeros((steps, 2, kernels.lanes(n)))
    noise[..., :n] = rng.standard_normal((steps, 2, n))
    noise *= crowd.noise * np.sqrt(dt)
    return noise


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
) -> Trajectory:
    """Integrate the herd from state under the control u.

    u (intervals, M, 2) [m/s] is constant on intervals of `substeps` steps of dt [s]. noise
    (intervals * substeps, 2, lanes) [m/s] comes from `increments`; None is the coarse model.
    """
    n, m = len(state.x), len(state.d)
    u = check_control(u, m)
    steps = len(u) * substeps
    shape = (steps, 2, kernels.lanes(n))
    if noise is None:
        noise = np.zeros(shape)
    if noise.shape != shape:
        raise ValueError(f'noise has shape {noise.shape}, allowed is {shape}')
    xs = np.empty((steps + 1, *shape[1:]))
    vs = np.empty_like(xs)
    ds = np.empty((steps + 1, 2, m))
    xs[0], vs[0], ds[0] = to_lanes(state.x), to_lanes(state.v), state.d.T
    kernels.rollout(xs, vs, ds, u, substeps, noise, physics(crowd, n, dt))
    return Trajectory(dt, n, xs, vs, ds)
