# SPDX-License-Identifier: Apache-2.0
"""The coarse problem by differential dynamic programming with crocoddyl's FDDP.

Second derivatives are those of Gauss and Newton, which crocoddyl is made for. Its box of controls
is no disc, so the disc is the image of the plane, as for L-BFGS-B. Dynamics and derivatives are
NumPy's; the recursion over time, which takes most of the time, is crocoddyl's.
"""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from benchmark.peers.scipy_lbfgsb import disc
from benchmark.race import Race
import crocoddyl
from herding_ros.model.potentials.forms import pair_terms
from herding_ros.model.state import Array
import numpy as np


class _Terminal(crocoddyl.ActionModelAbstract):
    """The end costs nothing: what a step costs is counted with the step."""

    def __init__(self, state: Any) -> None:
        super().__init__(state, 0, 0)

    def calc(self, data: Any, x: Array, u: Array | None = None) -> None:
        data.cost = 0.0

    def calcDiff(self, data: Any, x: Array, u: Array | None = None) -> None:  # noqa: N802
        pass


class _Interval(crocoddyl.ActionModelAbstract):
    """One command of all dogs: as many time steps as it is held."""

    def __init__(self, state: Any, race: Race, number: int) -> None:
        self.n, self.m = len(race.coarse.state.x), len(race.coarse.state.d)
        super().__init__(state, 2 * self.m, 0)
        self.race = race
        first = number * race.coarse.substeps
        self.targets = race.reference[first + 1 : first + race.coarse.substeps + 1]
        n, m = self.n, self.m
        weights, dt = race.control.weights, race.coarse.dt
        mean = np.kron(np.full((n, n), 1.0 / n), np.eye(2))
        of_sheep = weights.centre * mean / n + weights.spread / n * (np.eye(2 * n) - mean)
        self.curvature = np.zeros((4 * n + 2 * m, 4 * n + 2 * m))
        self.curvature[: 2 * n, : 2 * n] = dt * of_sheep
        self.curvature[4 * n :, 4 * n :] = dt * weights.dogs * np.eye(2 * m)

    def _forces(self, z: Array) -> tuple[Array, Array, Array]:
        """Return the gradient of all potentials (2 n,), by sheep and by dogs."""
        n, crowd = self.n, self.race.coarse.crowd
        x, d = z[: 2 * n].reshape(n, 2), z[4 * n :].reshape(-1, 2)
        from_sheep, by_sheep = _pairs(x, x, crowd.sheep.coefficients)
        from_dogs, by_dogs = _pairs(x, d, crowd.dog.coefficients)
        own = by_sheep.sum(1) / n + by_dogs.sum(1)
        jacobian = -by_sheep / n
        jacobian[np.arange(n), np.arange(n)] += own
        gradient = from_sheep.sum(1) / n + from_dogs.sum(1)
        return gradient.ravel(), _matrix(jacobian), _matrix(-by_dogs)

    def _steps(self, z: Array, w: Array) -> tuple[float, Array, list[Array]]:
        coarse, n = self.race.coarse, self.n
        u = self.race.control.max_speed * disc(w.reshape(-1, 2))[0].ravel()
        cost = 0.5 * coarse.interval * self.race.control.weights.control * float(u @ u)
        seen = [z]
        for target in self.targets:
            x, v, d = np.split(z, [2 * n, 4 * n])
            force = self._forces(z)[0] + coarse.crowd.friction * v
            z = np.concatenate([x + coarse.dt * v, v - coarse.dt * force, d + coarse.dt * u])
            seen.append(z)
            offset = z - self._at(target)
            cost += 0.5 * float(offset @ self.curvature @ offset)
        return cost, u, seen

    def _at(self, target: Array) -> Array:
        return np.concatenate(
            [np.tile(target, self.n), np.zeros(2 * self.n), np.tile(target, self.m)]
        )

    def calc(self, data: Any, x: Array, u: Array | None = None) -> None:
        data.cost, _, seen = self._steps(x, u)
        data.xnext = seen[-1]

    def calcDiff(self, data: Any, x: Array, u: Array | None = None) -> None:  # noqa: N802
        coarse, n, m = self.race.coarse, self.n, self.m
        dt, gamma = coarse.dt, self.race.control.weights.control
        _, velocity, seen = self._steps(x, u)
        unit, stretch, direction = disc(u.reshape(-1, 2))
        along = direction[:, :, None] * direction[:, None, :]
        radial = 1.0 - np.square(unit).sum(-1)
        blocks = stretch[:, None] * (np.eye(2) - along) + radial[:, None, None] * along
        by_w = np.zeros((2 * m, 2 * m))
        for i, block in enumerate(self.race.control.max_speed * blocks):
            by_w[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = block
        size = len(x)
        to_x, to_w = np.eye(size), np.zeros((size, 2 * m))
        effort = coarse.interval * gamma
        lx, lu = np.zeros(size), effort * by_w.T @ velocity
        lxx, lxu, luu = np.zeros((size, size)), np.zeros((size, 2 * m)), effort * by_w.T @ by_w
        for z, following, target in zip(seen, seen[1:], self.targets, strict=False):
            _, by_sheep, by_dogs = self._forces(z)
            step = np.eye(size)
            step[: 2 * n, 2 * n : 4 * n] = dt * np.eye(2 * n)
            step[2 * n : 4 * n, : 2 * n] = -dt * by_sheep
            step[2 * n : 4 * n, 2 * n : 4 * n] -= dt * coarse.crowd.friction * np.eye(2 * n)
            step[2 * n : 4 * n, 4 * n :] = -dt * by_dogs
            to_x, to_w = step @ to_x, step @ to_w
            to_w[4 * n :] += dt * by_w
            slope = self.curvature @ (following - self._at(target))
            lx, lu = lx + to_x.T @ slope, lu + to_w.T @ slope
            bent_x, bent_w = self.curvature @ to_x, self.curvature @ to_w
            lxx, lxu, luu = lxx + to_x.T @ bent_x, lxu + to_x.T @ bent_w, luu + to_w.T @ bent_w
        data.Fx, data.Fu = to_x, to_w
        data.Lx, data.Lu, data.Lxx, data.Lxu, data.Luu = lx, lu, lxx, lxu, luu


def _pairs(x: Array, y: Array, p: tuple[float, float, float, float]) -> tuple[Array, Array]:
    """Return gradients (n, k, 2) and Hessians (n, k, 2, 2) of P(|x_i - y_j|)."""
    s = x[:, None] - y[None]
    r2 = np.square(s).sum(-1)
    apart = r2 > 0.0
    a, b = pair_terms(np.where(apart, r2, 1.0), p)
    a, b = np.where(apart, a, 0.0), np.where(apart, b, 0.0)
    hessians = (
        a[..., None, None] * np.eye(2) + b[..., None, None] * s[..., :, None] * s[..., None, :]
    )
    return a[..., None] * s, hessians


def _matrix(blocks: Array) -> Array:
    n, k, _, _ = blocks.shape
    return blocks.transpose(0, 2, 1, 3).reshape(2 * n, 2 * k)


def solver(race: Race) -> Callable[[float], float]:
    """Return a function of so many seconds to the objective that it ends with."""
    start = race.coarse.state
    z = np.concatenate([start.x.ravel(), start.v.ravel(), start.d.ravel()])
    state = crocoddyl.StateVector(len(z))
    running = [_Interval(state, race, k) for k in range(len(race.start))]
    problem = crocoddyl.ShootingProblem(z, running, _Terminal(state))

    def solve(seconds: float) -> float:
        end = time.perf_counter() + seconds
        ddp = crocoddyl.SolverFDDP(problem)
        us = [np.zeros(2 * len(start.d)) for _ in running]
        xs, least, regularisation = problem.rollout(us), np.inf, 1e-9
        while least > race.target and time.perf_counter() < end:
            ddp.solve(xs, us, 1, True, regularisation)
            xs, us, regularisation = list(ddp.xs), list(ddp.us), ddp.preg
            u = race.control.max_speed * disc(np.array(us).reshape(race.start.shape))[0]
            least = min(least, race.value(u))
        return least

    return solve
