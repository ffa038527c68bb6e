# SPDX-License-Identifier: Apache-2.0
"""The coarse problem by direct multiple shooting with CasADi and IPOPT.

States and controls are unknowns, and each time step is a constraint. IPOPT takes exact second
derivatives from CasADi, and MUMPS solves its linear systems.
"""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from benchmark.peers.casadi_adjoint import running_cost, time_step
from benchmark.race import Race
import casadi as ca
from herding_ros.model.state import Array
import numpy as np


class _Watch(ca.Callback):
    """Ends IPOPT once the control of an iterate is good enough, or time is over."""

    def __init__(self, sizes: tuple[int, int], value: Callable[[Array], float]) -> None:
        super().__init__()
        self._sizes, self._value = sizes, value
        self.least, self.target, self.end = np.inf, -np.inf, np.inf
        self.construct('watch', {})

    def get_n_in(self) -> int:
        return ca.nlpsol_n_out()

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> Any:
        unknowns, constraints = self._sizes
        size = {'x': unknowns, 'lam_x': unknowns, 'g': constraints, 'lam_g': constraints, 'f': 1}
        return ca.Sparsity.dense(size.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, arguments: list[Any]) -> list[int]:
        self.least = min(self.least, self._value(np.asarray(arguments[0])[:, 0]))
        return [int(self.least <= self.target or time.perf_counter() > self.end)]


def solver(race: Race) -> Callable[[float], float]:
    """Return a function of so many seconds to the objective that it ends with, the target or not.

    The problem is built, and its derivatives are, before the clock starts.
    """
    coarse, weights = race.coarse, race.control.weights
    n, m = len(coarse.state.x), len(coarse.state.d)
    intervals = len(race.start)
    steps = intervals * coarse.substeps
    step = time_step(coarse, n, m)
    cost = running_cost(coarse, n, m, weights.centre, weights.spread, weights.dogs)

    size = 4 * n + 2 * m
    states, control = ca.MX.sym('states', size, steps), ca.MX.sym('control', 2 * m, intervals)
    first = ca.vertcat(*(a.T.ravel() for a in (coarse.state.x, coarse.state.v, coarse.state.d)))
    of_steps = ca.reshape(ca.repmat(control, coarse.substeps, 1), 2 * m, steps)
    following = step.map(steps)(ca.horzcat(first, states[:, :-1]), of_steps)
    value = ca.sum2(cost.map(steps)(states, race.reference[1:].T))
    value += 0.5 * coarse.interval * weights.control * ca.sumsqr(control)
    squares = control[:m, :] ** 2 + control[m:, :] ** 2
    constraints = ca.veccat(following - states, squares)
    lower = np.concatenate([np.zeros(size * steps), np.full(m * intervals, -np.inf)])
    upper = np.concatenate(
        [np.zeros(size * steps), np.full(m * intervals, race.control.max_speed**2)]
    )

    def objective(unknowns: Array) -> float:
        u = unknowns[states.numel() :].reshape(intervals, 2, m).transpose(0, 2, 1)
        return race.value(race.project(u))

    unknowns = ca.veccat(states, control)
    watch = _Watch((unknowns.numel(), constraints.numel()), objective)
    watch.target = race.target
    options = {
        'iteration_callback': watch,
        'print_time': False,
        'ipopt': {'print_level': 0, 'sb': 'yes', 'max_iter': 1000},
    }
    problem = {'x': unknowns, 'f': value, 'g': constraints}
    ipopt = ca.nlpsol('ipopt', 'ipopt', problem, options)
    at_rest = coarse.rollout(race.start)
    flat = [at_rest.xs[1:, :, :n], at_rest.vs[1:, :, :n], at_rest.ds[1:]]
    guess = np.concatenate([a.reshape(steps, -1) for a in flat], axis=1)
    start = np.concatenate([guess.ravel(), race.start.transpose(0, 2, 1).ravel()])

    def solve(seconds: float) -> float:
        watch.least, watch.end = np.inf, time.perf_counter() + seconds
        ipopt(x0=start, lbg=lower, ubg=upper)
        return watch.least

    return solve
