# SPDX-License-Identifier: Apache-2.0
"""What all optimisers promise; what is special to one stands in its own file."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.costs.control_effort import ControlEffort
from herding_ros.control.costs.tracking import Tracking
from herding_ros.control.ncg import ncg
from herding_ros.control.objective import Objective
from herding_ros.control.pqn import pqn
from herding_ros.control.solution import Budget, Problem, Solution, Status
from herding_ros.control.spg import spg
from herding_ros.model.crowd import CROWDS
from herding_ros.model.motion import Holonomic
from herding_ros.model.scenario import initial_herd
from herding_ros.model.state import Array
import numpy as np
import pytest
from scipy.optimize import minimize

project = Holonomic().project

Optimiser = Callable[..., Solution]

optimisers = pytest.mark.parametrize('optimise', [pqn, spg, ncg])
seeds = pytest.mark.parametrize('seed', range(4))


@dataclass
class Quadratic:
    """u.A u / 2 - b.u + constant over |u_km| <= limit, with its minimum known by construction.

    u* lies on the limit for half of the commands and within it for the others. With b = A u* +
    mu u*, mu >= 0 and zero within the limit, u* satisfies the Karush-Kuhn-Tucker conditions
    A u* - b + mu u* = 0, and as A is positive definite it is the only minimum.
    """

    seed: int
    interval: float = 0.1
    limit: float = 0.05
    calls: int = 0

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        self.shape = (5, 3, 2)
        size = int(np.prod(self.shape))
        basis = np.linalg.qr(rng.standard_normal((size, size)))[0]
        self.a = basis @ np.diag(np.logspace(-1.0, 1.0, size)) @ basis.T
        directions = rng.standard_normal((5, 3, 2))
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        self.active = rng.permutation(15).reshape(5, 3) < 7
        speeds = np.where(self.active, 1.0, rng.uniform(0.1, 0.9, (5, 3)))
        self.best = self.limit * speeds[..., None] * directions
        multipliers = np.where(self.active, rng.uniform(0.1, 2.0, (5, 3)), 0.0)[..., None]
        self.b = self.a @ self.best.ravel() + (multipliers * self.best).ravel()
        self.start = rng.uniform(-0.05, 0.05, self.shape)

    @property
    def problem(self) -> Problem:
        return Problem(self, self.project, self.inner, self.limit)

    def inner(self, a: Array, b: Array) -> float:
        return self.interval * float(np.vdot(a, b))

    def project(self, u: Array) -> Array:
        return project(u, self.limit)

    def __call__(self, u: Array) -> tuple[float, Array]:
        self.calls += 1
        z = u.ravel()
        gradient = (self.a @ z - self.b).reshape(self.shape)
        return float(0.5 * z @ self.a @ z - self.b @ z), gradient / self.interval


def of_method(optimise: Optimiser, length: float) -> float:
    """Return the tolerance for a step of this length: pqn's is one of the value instead."""
    return length**2 if optimise is pqn else length


def solved(
    optimise: Optimiser,
    problem: Quadratic,
    start: Array | None = None,
    tolerance: float = 1e-10,
    max_iterations: int = 5000,
) -> Solution:
    start = problem.start if start is None else start
    return optimise(problem.problem, start, Budget(max_iterations, of_method(optimise, tolerance)))


@optimisers
@seeds
def test_quadratic_over_balls_is_minimised(optimise: Optimiser, seed: int) -> None:
    problem = Quadratic(seed)
    found = solved(optimise, problem)
    assert found.status is Status.CONVERGED
    np.testing.assert_allclose(found.u, problem.best, rtol=0, atol=1e-6 * problem.limit)
    assert found.value == pytest.approx(problem(problem.best)[0], rel=1e-11)
    assert found.gradient_norm < 1e-7
    speeds = np.linalg.norm(found.u, axis=-1)
    np.testing.assert_array_equal(speeds > problem.limit * (1.0 - 1e-9), problem.active)


@optimisers
def test_calls_are_the_evaluations(optimise: Optimiser) -> None:
    problem = Quadratic(0)
    found = solved(optimise, problem)
    assert found.calls == problem.calls
    assert found.iterations <= found.calls


@optimisers
def test_minimum_does_not_depend_on_the_unit_of_time(optimise: Optimiser) -> None:
    """The gradient is that of L2(0, T): another inner product, the same minimum."""
    coarse, fine = (solved(optimise, Quadratic(1, interval)).u for interval in (1.0, 0.01))
    np.testing.assert_allclose(coarse, fine, rtol=0, atol=1e-7)


@optimisers
def test_inadmissible_start_is_projected(optimise: Optimiser) -> None:
    problem = Quadratic(2)
    found = solved(optimise, problem, 100.0 * problem.start)
    np.testing.assert_allclose(found.u, problem.best, rtol=0, atol=1e-7)


@optimisers
def test_iteration_limit_is_a_status_and_the_result_is_admissible(optimise: Optimiser) -> None:
    problem = Quadratic(0)
    found = solved(optimise, problem, max_iterations=3)
    assert found.status is Status.ITERATION_LIMIT
    assert found.iterations == 3
    assert found.value < problem(problem.start)[0]
    assert np.linalg.norm(found.u, axis=-1).max() <= problem.limit * (1.0 + 1e-15)
    step = problem.project(found.u - problem(found.u)[1]) - found.u
    assert found.gradient_norm == pytest.approx(np.sqrt(problem.inner(step, step)), rel=1e-12)


@optimisers
@pytest.mark.parametrize('evaluations', range(8))
def test_out_of_time_is_an_early_iteration_limit(optimise: Optimiser, evaluations: int) -> None:
    """Asked before each evaluation but the first, those of a line search too."""
    problem = Quadratic(0)
    asked = iter(range(1000))
    out_of_time = Budget(1000, out_of_time=lambda: next(asked) >= evaluations)
    hurried = optimise(problem.problem, problem.start, out_of_time)
    limited = optimise(problem.problem, problem.start, Budget(hurried.iterations))
    assert hurried.status is Status.OUT_OF_TIME
    assert limited.status is Status.ITERATION_LIMIT
    assert hurried.calls == 1 + evaluations
    assert np.array_equal(hurried.u, limited.u)


@optimisers
def test_start_at_the_minimum_stays_there(optimise: Optimiser) -> None:
    problem = Quadratic(3)
    found = solved(optimise, problem, problem.best, tolerance=1e-8)
    assert found.status is Status.CONVERGED
    np.testing.assert_allclose(found.u, problem.best, rtol=0, atol=1e-9)


@optimisers
@pytest.mark.parametrize('tolerance', [1e-8, 0.0])
def test_start_where_the_gradient_vanishes_stays_there(
    optimise: Optimiser, tolerance: float
) -> None:
    problem = Quadratic(3)
    problem.b[:] = 0.0
    found = solved(optimise, problem, np.zeros(problem.shape), tolerance)
    assert found.status is Status.CONVERGED
    assert not found.u.any()


@optimisers
def test_wrong_gradient_ends_without_descent(optimise: Optimiser) -> None:
    problem = Quadratic(0)

    def uphill(u: Array) -> tuple[float, Array]:
        value, gradient = problem(u)
        return value, -gradient

    wrong = replace(problem.problem, value_and_gradient=uphill)
    found = optimise(wrong, problem.best * 0.0, Budget(50, 1e-9))
    assert found.status is not Status.CONVERGED
    assert found.value <= problem(problem.best * 0.0)[0]


@pytest.fixture(scope='module', params=[3, 4])
def herding(request: pytest.FixtureRequest) -> tuple[CoarseModel, Objective, float]:
    """Eight sheep, two dogs, 100 steps in ten intervals; and the optimum scipy finds."""
    goal, limit = np.array([0.5, 0.5]), 0.05
    state = initial_herd(8, 2, goal, np.random.default_rng(request.param))
    coarse = CoarseModel(CROWDS['cohesive'], state, 0.1, 10)
    centre = state.x.mean(axis=0)
    reference = centre + np.linspace(0.0, 1.0, 101)[:, None] * (goal - centre)
    shape = (10, 2, 2)
    objective = Objective([Tracking(1.0, 1.0, reference), ControlEffort(1e-2)])

    def scaled(z: Array) -> tuple[float, Array]:
        value, gradient = coarse.value_and_gradient(objective, limit * z.reshape(shape))
        return value, limit * coarse.interval * gradient.ravel()

    def slack(z: Array) -> Array:
        return 1.0 - np.square(z.reshape(-1, 2)).sum(axis=1)

    def slack_jacobian(z: Array) -> Array:
        return -2.0 * np.kron(np.eye(20), np.ones(2)) * z

    found = minimize(
        scaled,
        np.zeros(40),
        jac=True,
        method='SLSQP',
        constraints={'type': 'ineq', 'fun': slack, 'jac': slack_jacobian},
        options={'maxiter': 500, 'ftol': 1e-12},
    )
    assert found.success
    assert slack(found.x).min() > -1e-9
    return coarse, objective, found.fun


def solved_herding(
    optimise: Optimiser, coarse: CoarseModel, objective: Objective, tolerance: float
) -> Solution:
    problem = Problem(
        partial(coarse.value_and_gradient, objective),
        partial(Holonomic().project, max_speed=0.05),
        coarse.inner,
        scale=0.05,
    )
    return optimise(problem, np.zeros((10, 2, 2)), Budget(4000, of_method(optimise, tolerance)))


def test_herding_problem_is_solved_by_all_as_well_as_by_scipy(
    herding: tuple[CoarseModel, Objective, float],
) -> None:
    coarse, objective, best = herding
    gain = coarse.value_and_gradient(objective, np.zeros((10, 2, 2)))[0] - best
    assert gain > 0.05 * best  # the dogs can do something
    plans = []
    for optimise in (pqn, spg, ncg):
        found = solved_herding(optimise, coarse, objective, 1e-8)
        assert found.value - best <= 1e-6 * gain
        speeds = np.linalg.norm(found.u, axis=-1)
        assert 0.0499 < speeds.max() <= 0.05 * (1.0 + 1e-15)
        plans.append(found.u)
    for plan in plans[1:]:
        np.testing.assert_allclose(plan, plans[0], rtol=0, atol=1e-3 * 0.05)
