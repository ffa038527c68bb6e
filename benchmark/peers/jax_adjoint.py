# SPDX-License-Identifier: Apache-2.0
"""Value and gradient with JAX: jit, float64, lax.scan, value_and_grad.

Of the formulations that were tried this was the fastest on CPU: coordinates apart, the sum of
the pair forces as a matrix product, and `checkpoint`, so that the reverse sweep computes the
pair distances again instead of reading them from memory. Uses XLA's threads as they come.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmark.problem import Problem
from herding_ros.model.state import Array
import jax
from jax import lax
import jax.numpy as jnp
import numpy as np

jax.config.update('jax_enable_x64', True)


def _slope_over_r(r2: Any, p: tuple[float, float, float, float]) -> Any:
    apart = r2 > 0.0
    r = jnp.sqrt(jnp.where(apart, r2, 1.0))
    slope = p[2] * jnp.exp(-p[3] * r) - p[0] * jnp.exp(-p[1] * r)
    return jnp.where(apart, slope / r, 0.0)


def _force(x: Any, y: Any, p: tuple[float, float, float, float]) -> Any:
    """Sum over all y[2, M] of the gradient of P(|x_i - y_m|), (2, N)."""
    dx = x[0][:, None] - y[0]
    dy = x[1][:, None] - y[1]
    a = _slope_over_r(dx * dx + dy * dy, p)
    return x * a.sum(1) - y @ a.T


def _plain_force(x: Any, y: Any, p: tuple[float, float, float, float]) -> Any:
    """Do the same in a straightforward version."""
    s = x[:, :, None] - y[:, None, :]
    return (_slope_over_r(jnp.square(s).sum(0), p) * s).sum(2)


def value_and_gradient(problem: Problem, tuned: bool = True) -> Callable[[], tuple[float, Array]]:
    """Return a compiled function of nothing: value, and gradient in L2(0, T)."""
    force_of = _force if tuned else _plain_force
    coarse, tracking, gamma = problem.coarse, problem.tracking, problem.control_weight
    crowd, dt, n = coarse.crowd, coarse.dt, problem.sheep
    start = tuple(jnp.asarray(a.T) for a in (coarse.state.x, coarse.state.v, coarse.state.d))
    wanted = jnp.asarray(tracking.reference[1:])

    def step(state: Any, u: Any) -> tuple[Any, Any]:
        x, v, d = state
        force = force_of(x, x, crowd.sheep.coefficients) / n
        force += force_of(x, d, crowd.dog.coefficients)
        following = x + dt * v, v - dt * (force + crowd.friction * v), d + dt * u
        return following, following[0]

    def value(u: Any) -> Any:
        of_steps = jnp.repeat(jnp.swapaxes(u, 1, 2), coarse.substeps, axis=0)
        _, x = lax.scan(jax.checkpoint(step) if tuned else step, start, of_steps)
        centre = x.mean(2)
        distance = tracking.centre_weight * jnp.square(centre - wanted).sum()
        distance += tracking.spread_weight / n * jnp.square(x - centre[:, :, None]).sum()
        effort = jnp.square(u).sum()
        effort *= coarse.interval * gamma
        return 0.5 * (dt * distance + effort)

    compiled = jax.jit(jax.value_and_grad(value))

    def evaluate() -> tuple[float, Array]:
        value, gradient = compiled(problem.u)
        return float(value), np.asarray(gradient) / coarse.interval

    evaluate()
    return evaluate
