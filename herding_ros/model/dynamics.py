# SPDX-License-Identifier: Apache-2.0
"""The crowd's equations of motion in discrete time: Euler-Maruyama.

With x, v the sheep's positions and velocities, d the dogs' positions, and P_1 and P_2 the
potentials of sheep and dogs (paper, state system):

    x_i' = x_i + dt v_i
    v_i' = v_i + dt (-1/N sum_j grad P_1(x_i - x_j) - sum_m grad P_2(x_i - d_m) + g(x_i)
                     + beta/N sum_j w(x_i - x_j) (v_j - v_i) - alpha v_i) + sigma f(t, x_i) dB_i

with g the external force and beta the rate of `alignment`, none by default. A crowd of first order
has no inertia: with F_i the sum of all forces but friction,

    x_i' = x_i + (dt F_i + sigma f(t, x_i) dB_i) / alpha,    v_i' = F_i / alpha,

the limit of the above for short relaxation times 1 / alpha. What its v holds has no effect.

The dogs' path follows from their commands alone, see `motion`. The noise sigma dB is an argument,
see `noise`. Without it this is the paper's coarse model, with it the fine one; there is no other
difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
import os

import numpy as np

from . import fast_forces, kernels
from .crowd import Crowd
from .external_form import Form
from .motion import Holonomic, MotionModel, returned
from .noise import is_uniform, random_force
from .potentials.forms import divided
from .state import Array, finite, HerdState, Trajectory


def physics(crowd: Crowd, n: int, dt: float) -> kernels.Physics:
    """Return the constants that the kernels need for n sheep and steps of dt [s].

    Raises ValueError unless dt is above 0 and the crowd's forces have forms.
    """
    if not (np.isfinite(dt) and dt > 0.0):
        raise ValueError(f'time step dt must be a number above 0, got {dt!r}')
    sheep = divided(crowd.sheep.kernel_form(), n)
    dog, external = crowd.dog.kernel_form(), crowd.external.kernel_form()
    if not isinstance(external, Form) and not (isinstance(external, tuple) and not external):
        raise ValueError(
            f'{type(crowd.external).__name__}.kernel_form must return what `register` made, '
            f'got {external!r}'
        )
    alignment = crowd.alignment.kernel_form(n)
    return kernels.Physics(
        n, float(dt), sheep, dog, crowd.friction, external, crowd.order, alignment
    )


def to_lanes(points: Array) -> Array:
    """Return points (N, 2) as the kernels want them: (2, lanes), unused lanes zero."""
    out = np.zeros((2, kernels.lanes(len(points))))
    out[:, : len(points)] = points.T
    return out


def forces(crowd: Crowd, x: Array, d: Array, accuracy: float = fast_forces.ACCURACY) -> Array:
    """Forces (N, 2) [m/s^2] on sheep at x (N, 2) [m] from each other, from dogs d and the world.

    They are what the places of sheep make: without alignment and friction.
    With many sheep the error is up to `accuracy`, relative in the Euclidean norm over all.
    """
    lanes, dogs = to_lanes(x), np.ascontiguousarray(d.T)
    with _summation(crowd, len(x), accuracy) as sums:
        still = np.zeros_like(lanes)
        out = _acceleration(sums(0, lanes), lanes, still, dogs, physics(crowd, len(x), 1.0))
    return out[:, : len(x)].T


def alignment_rates(crowd: Crowd, x: Array) -> Array:
    """Rates (N,) [1/s] at which sheep at x (N, 2) [m] lose a velocity that no other has."""
    out = np.zeros(len(x))
    if crowd.alignment.rate:
        kernels.alignment_rates(to_lanes(x), len(x), crowd.alignment.kernel_form(len(x)), out)
    return out


def relative_friction(crowd: Crowd, x: Array) -> float:
    """Friction [1/s] on how sheep at x (N, 2) [m] move relative to their flock, on average."""
    return crowd.friction + float(alignment_rates(crowd, x).mean())


def spreading(crowd: Crowd, x: Array) -> float:
    """Return how fast noise alone moves free sheep at x (N, 2) [m] apart [m^2/s].

    By that the mean square of their distance from their centre grows: 2 (sigma / alpha)^2
    (diffusion in the plane), but for the noise that all have in common; alignment adds to their
    friction alpha. 0 without friction, where it does not grow like time.
    """
    friction = relative_friction(crowd, x)
    if not friction:
        return 0.0
    return 2.0 * (crowd.noise**2 * (1.0 - crowd.common_noise)) / friction**2


@contextmanager
def _summation(
    crowd: Crowd, n: int, accuracy: float = fast_forces.ACCURACY
) -> Iterator[Callable[[int, Array], fast_forces.Sums]]:
    """Provide the `fast_forces.summation` of n sheep, on all cores."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        yield fast_forces.summation(crowd.sheep, n, accuracy, pool.map)


def _acceleration(
    sums: fast_forces.Sums, x: Array, v: Array, d: Array, constants: kernels.Physics
) -> Array:
    """Do what `kernels.acceleration` does, with forces between sheep from `sums`."""
    out = -sums.gradients(x)
    kernels.add_outer_forces(*out, *x, d, constants)
    kernels.add_alignment(x, v, constants, out)
    out[:, constants.n :] = 0.0
    return out


def check_control(u: Array, dogs: int) -> Array:
    """Return the control as a contiguous array (intervals, M, 2), or raise ValueError."""
    return np.ascontiguousarray(finite('control u', u, (None, dogs, 2)))


def positions(ds: Array) -> Array:
    """Return the positions (K+1, 2, M) of the dogs, as the kernels want them, from states."""
    return np.ascontiguousarray(ds[:, :2])


def rollout(
    crowd: Crowd,
    state: HerdState,
    u: Array,
    dt: float,
    substeps: int = 1,
    noise: Array | None = None,
    t: float = 0.0,
    motion: MotionModel = Holonomic(),
) -> Trajectory:
    """Integrate the herd from state under the control u.

    u (intervals, M, 2) [m/s] is constant on intervals of `substeps` steps of dt [s]. noise
    (intervals * substeps, 2, lanes) [m/s] comes from `increments`; None is the coarse model. The
    rollout starts at t [s], which counts when the noise depends on time.
    """
    u = check_control(u, len(state.d))
    shape = (len(u) * substeps + 1, *state.d.T.shape)
    ds = returned(motion, 'rollout', motion.rollout(state.d, u, dt, substeps), shape)
    return follow(crowd, state, ds, dt, noise, t)


def follow(
    crowd: Crowd,
    state: HerdState,
    ds: Array,
    dt: float,
    noise: Array | None = None,
    t: float = 0.0,
) -> Trajectory:
    """Integrate the sheep from state while the dogs go along ds (K+1, S, M); else as `rollout`."""
    n, steps = len(state.x), len(ds) - 1
    shape = (steps, 2, kernels.lanes(n))
    sigma_db = np.zeros(shape) if noise is None else noise
    if sigma_db.shape != shape:
        raise ValueError(f'noise must have shape {shape}, got {sigma_db.shape}')
    d, constants = positions(ds), physics(crowd, n, dt)
    xs, vs = np.empty((steps + 1, *shape[1:])), np.empty((steps + 1, *shape[1:]))
    xs[0], vs[0] = to_lanes(state.x), to_lanes(state.v)
    field = noise is not None and not is_uniform(crowd.noise_field)
    if n < fast_forces.CROSSOVER and not field:
        kernels.rollout(xs, vs, d, sigma_db, constants)
        return Trajectory(dt, n, xs, vs, ds)

    def noise_at(k: int, x: Array) -> Array:
        if not field:
            return sigma_db[k]
        out = np.zeros_like(x)
        out[:, :n] = random_force(crowd, t + k * dt, x[:, :n], sigma_db[k, :, :n])
        return out

    with _summation(crowd, n) as sums:

        def acceleration_at(k: int, x: Array, v: Array) -> Array:
            return _acceleration(sums(k, x), x, v, d[k], constants)

        path = march(xs[0], vs[0], steps, constants, acceleration_at, noise_at)
        for k, (x, v) in enumerate(path):
            xs[k], vs[k] = x, v
    return Trajectory(dt, n, xs, vs, ds)


def march(
    x: Array,
    v: Array,
    steps: int,
    constants: kernels.Physics,
    acceleration: Callable[[int, Array, Array], Array],
    noise: Callable[[int, Array], Array],
) -> Iterator[tuple[Array, Array]]:
    """Yield positions and velocities (2, ...) of the sheep after 0, 1, ... steps.

    `acceleration` (k, x, v) and `noise` (k, x) return what acts during step k on sheep at x.
    """
    yield x, v
    for k in range(steps):
        following = np.empty_like(x), np.empty_like(v)
        kernels.step(x, v, acceleration(k, x, v), noise(k, x), constants, *following)
        x, v = following
        yield x, v


def reverse_sweep(crowd: Crowd, trajectory: Trajectory, source: Array) -> Array:
    """Return the derivative of a cost with respect to the dogs' path, (K+1, 2, M).

    It is per unit of time, as `MotionModel.transpose` wants it. source (K+1, 2, lanes) is the
    cost's partial derivative with respect to the trajectory's xs, zero in the unused lanes.
    Exact for the scheme and the forces of the rollout.
    """
    n, xs, vs, d = trajectory.n, trajectory.xs, trajectory.vs, positions(trajectory.ds)
    constants = physics(crowd, n, trajectory.dt)
    dogs = np.zeros_like(d)
    if n < fast_forces.CROSSOVER:
        kernels.adjoint(xs, vs, d, source, constants, dogs)
        return dogs
    lam, mu = source[-1].copy(), np.zeros_like(xs[0])
    with _summation(crowd, n) as sums:
        prepared = [sums(k, x) for k, x in enumerate(xs[:-1])]
        for k in range(len(xs) - 2, -1, -1):
            kernels.follow_positions(lam, mu, constants)
            h = prepared[k].hessian_products(xs[k], mu)
            kernels.adjoint_step(xs[k], vs[k], d[k], source[k], constants, h, lam, mu, dogs[k])
    return dogs
