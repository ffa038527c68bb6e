# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
import dataclasses

from herding_ros.control.solution import Budget, Status
from herding_ros.control.space_mapping import (
    aggressive_mapping,
    Broyden,
    MappingProblem,
    MappingResult,
    output_mapping,
)
from herding_ros.model.motion import Holonomic
from herding_ros.model.state import Array
import numpy as np
import pytest

project = Holonomic().project

SHAPE = (3, 1, 2)
SIZE = 6
INTERVAL = 0.1
LIMIT = 0.05


def inner(a: Array, b: Array) -> float:
    return INTERVAL * float(np.vdot(a, b))


def norm(a: Array) -> float:
    return float(np.sqrt(inner(a, a)))


def free(u: Array) -> Array:
    return u


def random_pairs(count: int, seed: int = 0) -> list[tuple[Array, Array]]:
    rng = np.random.default_rng(seed)
    return [(rng.normal(size=SHAPE), rng.normal(size=SHAPE)) for _ in range(count)]


def broyden_after(pairs: list[tuple[Array, Array]]) -> Broyden:
    broyden = Broyden(inner)
    for step, change in pairs:
        broyden.update(step, change)
    return broyden


def test_broyden_matrix_is_the_identity_at_first() -> None:
    h = random_pairs(1)[0][0]
    np.testing.assert_array_equal(Broyden(inner).times(h), h)
    np.testing.assert_array_equal(Broyden(inner).solve(h), h)


@pytest.mark.parametrize('count', [1, 2, 5, 8])
def test_broyden_matrix_is_the_sum_of_dyads(count: int) -> None:
    """The full matrix, built as in Broyden (1965), of the controls as plain vectors."""
    pairs, dense = random_pairs(count), np.eye(SIZE)
    for step, change in pairs:
        s, y = step.ravel(), change.ravel()
        dense += np.outer(y - dense @ s, s) / (s @ s)
    h = random_pairs(1, seed=1)[0][0]
    np.testing.assert_allclose(
        broyden_after(pairs).times(h).ravel(), dense @ h.ravel(), rtol=1e-11, atol=1e-12
    )


@pytest.mark.parametrize('count', [1, 2, 5])
def test_broyden_secant_and_inverse(count: int) -> None:
    pairs = random_pairs(count)
    broyden, (step, change) = broyden_after(pairs), pairs[-1]
    np.testing.assert_allclose(broyden.times(step), change, rtol=0, atol=1e-12)
    for h, _ in random_pairs(3, seed=1):
        np.testing.assert_allclose(broyden.solve(broyden.times(h)), h, rtol=0, atol=1e-10)
        np.testing.assert_allclose(broyden.times(broyden.solve(h)), h, rtol=0, atol=1e-10)
        across = h - inner(h, step) / inner(step, step) * step
        before = broyden_after(pairs[:-1]).times(across)
        np.testing.assert_allclose(broyden.times(across), before, rtol=0, atol=1e-12)


def test_step_of_no_length_teaches_nothing() -> None:
    broyden, h = broyden_after([(np.zeros(SHAPE), np.ones(SHAPE))]), np.ones(SHAPE)
    np.testing.assert_array_equal(broyden.times(h), h)


def test_singular_broyden_matrix_still_gives_a_step() -> None:
    step = np.ones(SHAPE)
    broyden = broyden_after([(step, np.zeros(SHAPE))])
    found = broyden.solve(random_pairs(1)[0][0])
    assert np.isfinite(found).all()
    assert norm(found) < 100.0


@dataclasses.dataclass
class Affine:
    """Fine model A u + b, whose coarse model is the identity: T(u) = A u + b.

    A u + b = u_c has one solution, u_f = A^-1 (u_c - b), which is what the mapping looks for.
    """

    rank: int
    strength: float
    seed: int = 0
    size: float = 1.0

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        left, right = (np.linalg.qr(rng.normal(size=(SIZE, SIZE)))[0] for _ in range(2))
        difference = self.strength * left[:, : self.rank] @ right[:, : self.rank].T
        self.a = np.eye(SIZE) + difference
        self.b = self.size * rng.normal(size=SIZE)
        self.u_coarse = self.size * rng.normal(size=SHAPE)
        self.solution = np.linalg.solve(self.a, self.u_coarse.ravel() - self.b).reshape(SHAPE)
        self.seen: list[Array] = []

    def fine(self, u: Array) -> Array:
        self.seen.append(u)
        return (self.a @ u.ravel() + self.b).reshape(SHAPE)

    def misfit(self, found: Array) -> float:
        return norm(found - self.u_coarse)

    def mapped(
        self,
        projection: Callable[[Array], Array] = free,
        tolerance: float = 1e-9,
        min_decrease: float = -1e9,
        max_iterations: int = 30,
        quasi_newton: bool = True,
    ) -> MappingResult:
        return aggressive_mapping(
            MappingProblem(self.fine, self.misfit, self.u_coarse),
            lambda found, start: found,
            projection,
            inner,
            Budget(max_iterations, tolerance),
            min_decrease,
            quasi_newton,
        )


@pytest.mark.parametrize(('rank', 'strength'), [(1, 1.7), (2, 1.7), (6, 0.9), (6, 1.7)])
@pytest.mark.parametrize('seed', range(3))
def test_affine_model_is_mapped_in_twice_as_many_steps_as_it_differs(
    rank: int, strength: float, seed: int
) -> None:
    """Broyden's method ends on affine systems after 2 n steps (Gay 1979), n the rank of A - I.

    Without Broyden's update, u - (T(u) - u_c) diverges here: A - I has norm above one.
    """
    problem = Affine(rank, strength, seed)
    found = problem.mapped()
    assert found.status is Status.CONVERGED
    assert found.iterations <= 2 * rank + 2
    np.testing.assert_allclose(found.u, problem.solution, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.output, problem.u_coarse, rtol=0, atol=1e-7)


def test_residuals_and_misfits_are_those_of_the_iterates() -> None:
    problem = Affine(6, 0.9)
    found = problem.mapped(max_iterations=3)
    expected = [problem.misfit(problem.fine(u)) for u in problem.seen[:]]
    np.testing.assert_allclose(found.misfits, expected, rtol=1e-14)
    # T is the fine model itself here, so that both measure the same.
    np.testing.assert_allclose(
        found.residuals, np.array(expected) / norm(problem.u_coarse), rtol=1e-14
    )
    assert found.iterations == 3
    assert found.status is Status.ITERATION_LIMIT


def test_without_quasi_newton_every_step_is_the_residual() -> None:
    problem = Affine(6, 0.5, 0)
    problem.mapped(max_iterations=4, quasi_newton=False)
    assert len(problem.seen) == 5
    for u, following in zip(problem.seen[:-1], problem.seen[1:], strict=True):
        expected = u - (problem.a @ u.ravel() + problem.b).reshape(SHAPE) + problem.u_coarse
        np.testing.assert_allclose(following, expected, rtol=0, atol=1e-15)


def test_with_active_limits_every_iterate_is_admissible_and_the_best_is_returned() -> None:
    for seed in range(5):
        problem = Affine(6, 0.9, seed, size=LIMIT)
        problem.u_coarse = project(10.0 * problem.u_coarse, LIMIT)
        found = problem.mapped(lambda u: project(u, LIMIT), max_iterations=6)
        speeds = np.linalg.norm(problem.seen, axis=-1)
        assert speeds.max() <= LIMIT * (1.0 + 1e-15)
        assert (speeds[1:] > LIMIT * (1.0 - 1e-12)).any()
        assert any(found.u is u for u in problem.seen)
        assert problem.misfit(problem.fine(found.u)) == min(found.misfits)
        np.testing.assert_array_equal(found.output, problem.fine(found.u))


def test_secant_is_that_of_the_step_taken() -> None:
    """In one dimension, a clipped first step still gives the exact slope: the next one hits."""
    slope, offset, wanted = 4.0, -0.03, 0.049

    def along(value: float) -> Array:
        return value * np.eye(SIZE)[0].reshape(SHAPE)

    problem = MappingProblem(
        lambda u: slope * u + along(offset),
        lambda result: norm(result - along(wanted)),
        along(wanted),
    )
    found = aggressive_mapping(
        problem,
        lambda result, start: result,
        lambda u: project(u, LIMIT),
        inner,
        Budget(5, 1e-12),
        -np.inf,
    )
    assert found.iterations == 2
    np.testing.assert_allclose(found.u, along((wanted - offset) / slope), rtol=0, atol=1e-15)


@pytest.mark.parametrize('u_coarse', [np.full(SHAPE, 0.03), np.zeros(SHAPE)])
def test_equal_models_need_no_aggressive_mapping(u_coarse: Array) -> None:
    problem = Affine(6, 0.0)
    problem.b[:] = 0.0
    problem.u_coarse = u_coarse
    found = problem.mapped(tolerance=1e-12)
    assert (found.status, found.iterations) == (Status.CONVERGED, 0)
    assert found.residuals == (0.0,)
    np.testing.assert_array_equal(found.u, u_coarse)


def test_aggressive_mapping_is_never_worse_than_the_coarse_optimum() -> None:
    for seed in range(5):
        problem = Affine(6, 5.0, seed)
        found = problem.mapped(max_iterations=2)
        assert problem.misfit(found.output) == min(found.misfits) <= found.misfits[0]
    only_worse = aggressive_mapping(
        MappingProblem(lambda u: u, norm, np.zeros(SHAPE)),
        lambda result, start: result**2 + 1.0,  # misleads: it is never zero
        free,
        inner,
        Budget(4),
        -np.inf,
    )
    np.testing.assert_array_equal(only_worse.u, np.zeros(SHAPE))
    assert only_worse.iterations == 4


def test_stops_when_the_residual_is_small_enough_or_falls_too_slowly() -> None:
    residuals = Affine(6, 0.9).mapped().residuals
    falls = -np.diff(residuals)
    assert falls[0] > 0.0
    early = Affine(6, 0.9).mapped(tolerance=residuals[2])
    first = next(k for k, each in enumerate(residuals) if each <= residuals[2])
    assert (early.status, early.iterations) == (Status.CONVERGED, first)
    slow = Affine(6, 0.9).mapped(min_decrease=1.001 * falls[0])
    assert (slow.status, slow.iterations) == (Status.STAGNATED, 1)


class Corrected:
    """Linear coarse model S u, fine model (S + E) u + c; `match` solves its problem exactly."""

    def __init__(self, strength: float, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        basis = np.linalg.qr(rng.normal(size=(SIZE, SIZE)))[0]
        self.s = basis * np.linspace(0.5, 1.0, SIZE)
        self.e = strength * np.linalg.qr(rng.normal(size=(SIZE, SIZE)))[0]
        self.c = strength * rng.normal(size=SIZE)
        self.u_coarse = rng.normal(size=SIZE)
        self.wanted = self.s @ self.u_coarse
        self.solution = np.linalg.solve(self.s + self.e, self.wanted - self.c)
        self.asked: list[tuple[Array, Array, float]] = []

    def coarse(self, u: Array) -> Array:
        return self.s @ u

    def fine(self, u: Array) -> Array:
        return (self.s + self.e) @ u + self.c

    def match(self, target: Array, u: Array, damping: float) -> Array:
        """Minimise |S w - target|^2 + damping |w - u|^2 over w."""
        self.asked.append((target, u, damping))
        normal = self.s.T @ self.s + damping * np.eye(SIZE)
        return np.linalg.solve(normal, self.s.T @ target + damping * u)

    def misfit(self, found: Array) -> float:
        return float(np.linalg.norm(found - self.wanted))

    def mapped(
        self, accuracy: float = 1e-10, max_iterations: int = 40, damping: float = 1e-2
    ) -> MappingResult:
        return output_mapping(
            MappingProblem(self.fine, self.misfit, self.u_coarse),
            self.coarse,
            self.match,
            damping,
            Budget(max_iterations, accuracy),
        )


@pytest.mark.parametrize('seed', range(3))
def test_output_mapping_finds_the_known_solution(seed: int) -> None:
    problem = Corrected(0.1, seed)
    found = problem.mapped()
    assert found.status is Status.CONVERGED
    assert found.misfits[-1] <= 1e-10 < found.misfits[-2]
    np.testing.assert_allclose(found.u, problem.solution, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.output, problem.wanted, rtol=0, atol=1e-9)


def test_defect_that_stays_the_same_is_corrected_in_one_step() -> None:
    problem = Corrected(0.1)
    problem.e[:] = 0.0
    found = problem.mapped(damping=0.0, accuracy=1e-12)
    assert found.iterations == 1
    expected = problem.u_coarse - np.linalg.solve(problem.s, problem.c)
    np.testing.assert_allclose(found.u, expected, rtol=0, atol=1e-12)


def test_match_is_asked_for_what_is_wanted_less_the_defect_near_the_best() -> None:
    problem = Corrected(0.3)
    found = problem.mapped(max_iterations=5)
    best, damping = problem.u_coarse, 1e-2
    for k, (target, u, asked) in enumerate(problem.asked):
        np.testing.assert_array_equal(u, best)
        defect = problem.e @ best + problem.c
        np.testing.assert_allclose(target, problem.wanted - defect, rtol=0, atol=1e-13)
        assert asked == pytest.approx(damping, rel=1e-12)
        if found.misfits[k + 1] < min(found.misfits[: k + 1]):
            best, damping = problem.match(target, u, asked), damping / 10.0
            problem.asked.pop()
        else:
            damping *= 10.0


def test_equal_models_need_no_output_mapping() -> None:
    problem = Corrected(0.0)
    found = problem.mapped(accuracy=1e-12)
    assert (found.status, found.iterations) == (Status.CONVERGED, 0)
    assert found.u is problem.u_coarse


def test_output_mapping_is_never_worse_than_the_coarse_optimum() -> None:
    problem = Corrected(0.1)
    wrong = output_mapping(
        MappingProblem(problem.fine, problem.misfit, problem.u_coarse),
        problem.coarse,
        lambda target, u, damping: u + 1.0,
        1e-2,
        Budget(4, 1e-10),
    )
    assert wrong.iterations == 4
    assert wrong.misfits[0] < min(wrong.misfits[1:])
    assert wrong.u is problem.u_coarse
    np.testing.assert_array_equal(wrong.output, problem.fine(problem.u_coarse))
    assert wrong.status is Status.ITERATION_LIMIT
