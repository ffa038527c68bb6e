# SPDX-License-Identifier: Apache-2.0
"""Value and gradient with CasADi: a step function, mapaccum over the steps, reverse mode.

Of the formulations that were tried this was the fastest: MX, whose operations run over whole
vectors, with each pair of sheep once and all dogs at once. `scalars` turns a step into SX, a
scalar at a time. One thread. CasADi interprets its graph; `compiler_flags` has it write C instead
and calls the C compiler.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmark.problem import Problem
import casadi as ca
from herding_ros.control.coarse_model import CoarseModel
from herding_ros.model.state import Array
import numpy as np

COMPILER_FLAGS = ('-O3', '-march=native', '-ffast-math')


def _slope_over_r(r2: Any, p: tuple[float, float, float, float]) -> Any:
    r = ca.sqrt(r2)
    return (p[2] * ca.exp(-p[3] * r) - p[0] * ca.exp(-p[1] * r)) / r


def _force_of_flock(x: Any, y: Any, p: tuple[float, float, float, float]) -> tuple[Any, Any]:
    n = x.numel()
    first, second = np.triu_indices(n, 1)
    pairs = range(len(first))
    signs = [1.0] * len(first) + [-1.0] * len(first)
    sum_over_pairs = ca.DM.triplet([*first, *second], [*pairs, *pairs], signs, n, len(first))
    dx = x[first.tolist()] - x[second.tolist()]
    dy = y[first.tolist()] - y[second.tolist()]
    a = _slope_over_r(dx * dx + dy * dy, p)
    return ca.mtimes(sum_over_pairs, a * dx) / n, ca.mtimes(sum_over_pairs, a * dy) / n


def _force_of_dogs(
    x: Any, y: Any, d: Any, p: tuple[float, float, float, float]
) -> tuple[Any, Any]:
    n, m = x.numel(), d.shape[0]
    dx = ca.repmat(x, 1, m) - ca.repmat(d[:, 0].T, n, 1)
    dy = ca.repmat(y, 1, m) - ca.repmat(d[:, 1].T, n, 1)
    a = _slope_over_r(dx * dx + dy * dy, p)
    return ca.sum2(a * dx), ca.sum2(a * dy)


def time_step(coarse: CoarseModel, n: int, m: int) -> Any:
    """Return the function of a state (4 n + 2 m,) and a control (2 m,) to the next state.

    x, v, d and u lie in a column each: first all x coordinates, then all y.
    """
    dt = coarse.dt
    x, v, d, u = (
        ca.MX.sym(name, size, 2) for name, size in zip('xvdu', (n, n, m, m), strict=True)
    )
    flock = _force_of_flock(x[:, 0], x[:, 1], coarse.crowd.sheep.coefficients)
    dogs = _force_of_dogs(x[:, 0], x[:, 1], d, coarse.crowd.dog.coefficients)
    force = ca.horzcat(flock[0] + dogs[0], flock[1] + dogs[1])
    following = x + dt * v, v - dt * (force + coarse.crowd.friction * v), d + dt * u
    return ca.Function('step', [ca.veccat(x, v, d), ca.vec(u)], [ca.veccat(*following)])


def running_cost(
    coarse: CoarseModel, n: int, m: int, centre_weight: float, spread_weight: float,
    leash_weight: float = 0.0,
) -> Any:  # fmt: skip
    """Return the function of a state and the reference (2,) to what a step costs."""
    x, v, d = (ca.MX.sym(name, size, 2) for name, size in zip('xvd', (n, n, m), strict=True))
    wanted = ca.MX.sym('wanted', 2)
    centre = ca.sum1(x) / n
    cost = centre_weight * ca.sumsqr(centre.T - wanted)
    cost += spread_weight / n * ca.sumsqr(x - ca.repmat(centre, n, 1))
    cost += leash_weight * ca.sumsqr(d - ca.repmat(wanted.T, m, 1))
    return ca.Function('cost', [ca.veccat(x, v, d), wanted], [0.5 * coarse.dt * cost])


def value_and_gradient(
    problem: Problem, compiler_flags: tuple[str, ...] = (), scalars: bool = False
) -> Callable[[], tuple[float, Array]]:
    """Return a function of nothing: value, and gradient in L2(0, T).

    With compiler_flags, C is written into the working directory and compiled by `gcc`.
    """
    coarse, tracking, gamma = problem.coarse, problem.tracking, problem.control_weight
    n, m = problem.sheep, problem.dogs
    step = time_step(coarse, n, m)
    if scalars:
        step = step.expand()
    weights = tracking.centre_weight, tracking.spread_weight
    cost_of_step = running_cost(coarse, n, m, *weights)

    steps = problem.steps
    control = ca.MX.sym('control', 2 * m, len(problem.u))
    of_steps = ca.reshape(ca.repmat(control, coarse.substeps, 1), 2 * m, steps)
    start = np.concatenate([a.T.ravel() for a in (coarse.state.x, coarse.state.v, coarse.state.d)])
    states = step.mapaccum(steps)(start, of_steps)
    effort = ca.sumsqr(control)
    value = ca.sum2(cost_of_step.map(steps)(states, tracking.reference[1:].T))
    value += 0.5 * coarse.interval * gamma * effort
    options: dict[str, Any] = {}
    if compiler_flags:
        jit = {'flags': list(compiler_flags), 'linker_flags': ['-lmvec', '-lm'], 'compiler': 'gcc'}
        options = {'jit': True, 'compiler': 'shell', 'jit_options': jit}
    function = ca.Function('f', [control], [value, ca.gradient(value, control)], options)

    def evaluate() -> tuple[float, Array]:
        value, gradient = function(_columns(problem.u))
        rows = np.asarray(gradient).reshape(2, m, -1)
        return float(value), rows.transpose(2, 1, 0) / coarse.interval

    evaluate()
    return evaluate


def _columns(u: Array) -> Array:
    """Return a control (intervals, M, 2) with a column per interval: all x, then all y."""
    return u.transpose(2, 1, 0).reshape(-1, len(u))
