# SPDX-License-Identifier: Apache-2.0
from dataclasses import dataclass

from herding_ros.control.gauss_newton import gauss_newton
from herding_ros.control.solution import Budget, Problem, Solution, Status
from herding_ros.model.motion import Holonomic
from herding_ros.model.state import Array
import numpy as np
import pytest

project = Holonomic().project

SHAPE, SIZE, INTERVAL, LIMIT = (5, 3, 2), 30, 0.1, 0.05


def inner(a: Array, b: Array) -> float:
    return INTERVAL * float(np.vdot(a, b))


def damped(weight: float, anchor: Array | float = 0.0) -> Problem:
    """Return weight / 2 |u - anchor|^2 over balls."""

    def regulariser(u: Array) -> tuple[float, Array]:
        change = u - anchor
        return 0.5 * weight * inner(change, change), weight * change

    return Problem(regulariser, lambda u: project(u, LIMIT), inner)


@dataclass
class Matrix:
    """A linearisation with its matrix at hand."""

    s: Array

    def times(self, du: Array) -> Array:
        return self.s @ du.ravel()

    def transposed(self, e: Array) -> Array:
        return (e @ self.s).reshape(SHAPE) / INTERVAL


class LeastSquares:
    """|S u - y|^2 / 2 + weight / 2 |u - anchor|^2 over balls, with known minimum u*.

    y solves S'(S u* - y) + weight dt (u* - anchor) + mu u* = 0 with mu >= 0, and mu = 0 where
    |u*| is within the limit: the Karush-Kuhn-Tucker conditions of a strictly convex problem.
    """

    weight = 1e-2

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        left, right = (np.linalg.qr(rng.normal(size=(SIZE, SIZE)))[0] for _ in range(2))
        self.s = left @ np.diag(np.linspace(0.5, 1.0, SIZE)) @ right
        u = rng.normal(size=SHAPE)
        active = rng.permutation(15).reshape(5, 3, 1) < 7
        speeds = np.where(active, 1.0, rng.uniform(0.1, 0.9, (5, 3, 1)))
        self.best = LIMIT * speeds * u / np.linalg.norm(u, axis=-1, keepdims=True)
        self.anchor = rng.uniform(-LIMIT, LIMIT, SHAPE)
        multiplier = np.where(active, rng.uniform(0.1, 2.0, (5, 3, 1)), 0.0)
        force = self.weight * INTERVAL * (self.best - self.anchor) + multiplier * self.best
        self.y = self.s @ self.best.ravel() + np.linalg.solve(self.s.T, force.ravel())
        self.start = rng.uniform(-LIMIT, LIMIT, SHAPE)
        self.residuals = 0

    def residual(self, u: Array) -> Array:
        self.residuals += 1
        return self.s @ u.ravel() - self.y

    def value(self, u: Array) -> float:
        change = u - self.anchor
        distance = self.weight * INTERVAL * np.square(change).sum()
        return 0.5 * float(np.square(self.residual(u)).sum() + distance)

    def solved(self, linearisation: Matrix, start: Array, iterations: int = 20) -> Solution:
        damping = damped(self.weight, self.anchor)
        budget = Budget(iterations, 1e-12)
        return gauss_newton(self.residual, lambda _: linearisation, damping, start, budget)


@pytest.mark.parametrize('seed', range(3))
def test_linear_least_squares_over_balls_are_minimised(seed: int) -> None:
    problem = LeastSquares(seed)
    found = problem.solved(Matrix(problem.s), problem.start)
    assert found.calls == problem.residuals
    np.testing.assert_allclose(found.u, problem.best, rtol=0, atol=1e-4 * LIMIT)
    assert found.value == pytest.approx(problem.value(problem.best), rel=1e-9)
    assert found.value == pytest.approx(problem.value(found.u), rel=1e-13)
    assert np.linalg.norm(found.u, axis=-1).max() <= LIMIT * (1.0 + 1e-15)
    assert found.iterations <= 3  # the model is exact


def test_result_does_not_depend_on_an_inadmissible_start() -> None:
    problem = LeastSquares(0)
    found = problem.solved(Matrix(problem.s), 100.0 * problem.start)
    np.testing.assert_allclose(found.u, problem.best, rtol=0, atol=1e-4 * LIMIT)


def test_fixed_linearisation_still_leads_to_the_root_of_a_curved_residual() -> None:
    """U + 3 u^2 = given, linearised at zero once and for all; the root is known."""
    root = np.random.default_rng(0).uniform(-0.03, 0.03, SHAPE)
    found = gauss_newton(
        lambda u: (u + 3.0 * u**2 - root - 3.0 * root**2).ravel(),
        lambda _: Matrix(np.eye(SIZE)),
        damped(0.0),
        np.zeros(SHAPE),
        Budget(50, 1e-6),
    )
    assert found.value < 1e-12
    np.testing.assert_allclose(found.u, root, rtol=0, atol=1e-6)


def test_linearising_anew_finds_the_minimum_where_the_residual_stays_large() -> None:
    """Each residual u + 3 u^2 - c is monotone on the ball, with c beyond reach for some."""
    wanted = np.random.default_rng(4).uniform(-0.2, 0.2, SHAPE)
    calls = []

    def linearise(u: Array) -> Matrix:
        calls.append(u)
        return Matrix(np.diag((1.0 + 6.0 * u).ravel()))

    found = gauss_newton(
        lambda u: (u + 3.0 * u**2 - wanted).ravel(),
        linearise,
        damped(0.0),
        np.zeros(SHAPE),
        Budget(50, 1e-10),
    )
    assert len(calls) > 2
    grid = LIMIT * np.linspace(-1.0, 1.0, 401)
    w = np.stack(np.meshgrid(grid, grid), axis=-1)
    w = w[np.linalg.norm(w, axis=-1) <= LIMIT]
    for u, c in zip(found.u.reshape(-1, 2), wanted.reshape(-1, 2), strict=True):
        best = np.square(w + 3.0 * w**2 - c).sum(axis=-1).min()
        assert np.square(u + 3.0 * u**2 - c).sum() <= best + 1e-9
    assert found.gradient_norm < 1e-3 * np.sqrt(inner(found.u, found.u))


def test_misleading_linearisation_leaves_the_start() -> None:
    problem = LeastSquares(1)
    found = problem.solved(Matrix(-problem.s), problem.start)
    assert found.status is Status.STAGNATED
    np.testing.assert_array_equal(found.u, project(problem.start, LIMIT))


def test_iteration_limit_is_a_status() -> None:
    problem = LeastSquares(2)
    found = problem.solved(Matrix(1.5 * problem.s), problem.start, iterations=1)
    assert found.status is Status.ITERATION_LIMIT
    assert found.value < problem.value(project(problem.start, LIMIT))
