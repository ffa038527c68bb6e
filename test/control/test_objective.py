from collections.abc import Callable
import dataclasses

import numpy as np
import pytest

from herding_ros.control.objective import Objective
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.state import Array, HerdState, Trajectory

HerdMaker = Callable[..., HerdState]

DT, SUBSTEPS, INTERVALS, DOGS = 0.1, 4, 5, 2
STEPS = INTERVALS * SUBSTEPS
# of centre, spread, control and dogs
WEIGHTS = [(1, 1, 1e-2, 0), (3, 1, 1e-2, 3e-3), (1, 0, 0.3, 0), (0, 2, 1e-9, 0.7)]
weights = pytest.mark.parametrize('weights', WEIGHTS)
sheep = pytest.mark.parametrize('n', [1, 8, 11])


@pytest.fixture
def played(random_herd: HerdMaker) -> Callable[[int], tuple[Trajectory, Array]]:
    def play(n: int) -> tuple[Trajectory, Array]:
        u = np.random.default_rng(n).normal(0.0, 0.05, (INTERVALS, DOGS, 2))
        return rollout(Crowd(), random_herd(n, DOGS), u, DT, SUBSTEPS), u

    return play


def random_objective(weights: tuple[float, float, float, float]) -> Objective:
    rng = np.random.default_rng(9)
    reference = rng.normal(0.0, 1.0, (STEPS + 1, 2))
    return Objective(
        *weights[:3], reference, rng.normal(0.0, 0.05, (INTERVALS, DOGS, 2)), weights[3]
    )


@weights
@sheep
def test_cost_is_the_sum_it_says(
    played: Callable[[int], tuple[Trajectory, Array]],
    n: int,
    weights: tuple[float, float, float, float],
) -> None:
    trajectory, u = played(n)
    objective = random_objective(weights)
    a, b, gamma, c = weights
    expected = 0.0
    for k in range(1, STEPS + 1):
        centre = sum(trajectory.x[k]) / n
        expected += DT * a / 2 * sum((centre - objective.reference[k]) ** 2)
        for each in trajectory.x[k]:
            expected += DT * b / (2 * n) * sum((each - centre) ** 2)
        for each in trajectory.d[k]:
            expected += DT * c / 2 * sum((each - objective.reference[k]) ** 2)
    for k in range(INTERVALS):
        for m in range(DOGS):
            change = u[k, m] - objective.control_reference[k, m]
            expected += DT * SUBSTEPS * gamma / 2 * sum(change**2)
    found, *_ = objective.value_and_derivatives(trajectory, u, DT * SUBSTEPS)
    assert found == pytest.approx(expected, rel=1e-13)


@sheep
def test_equal_weights_are_the_cost_of_the_paper(
    played: Callable[[int], tuple[Trajectory, Array]], n: int
) -> None:
    trajectory, u = played(n)
    objective = random_objective((1, 1, 1e-2, 0))
    individuals = np.square(trajectory.x - objective.reference[:, None])[1:].sum() / n
    change = np.square(u - objective.control_reference).sum()
    expected = 0.5 * DT * individuals + 0.5 * 1e-2 * DT * SUBSTEPS * change
    found, *_ = objective.value_and_derivatives(trajectory, u, DT * SUBSTEPS)
    assert found == pytest.approx(expected, rel=1e-13)


@weights
@sheep
def test_source_is_the_derivative_of_the_cost(
    played: Callable[[int], tuple[Trajectory, Array]],
    n: int,
    weights: tuple[float, float, float, float],
) -> None:
    trajectory, u = played(n)
    objective = random_objective(weights)
    _, source, _ = objective.value_and_derivatives(trajectory, u, DT * SUBSTEPS)
    assert source.shape == trajectory.xs.shape
    assert not source[:, :, n:].any()

    def value_with(index: tuple[int, ...], change: float) -> float:
        xs = trajectory.xs.copy()
        xs[index] += change
        moved = dataclasses.replace(trajectory, xs=xs)
        return objective.value_and_derivatives(moved, u, DT * SUBSTEPS)[0]

    for k in (0, 1, STEPS):
        for index in np.ndindex(2, n):
            # The cost is quadratic in x: central differences are exact but for round-off.
            expected = (value_with((k, *index), 0.5) - value_with((k, *index), -0.5)) / 1.0
            assert source[(k, *index)] == pytest.approx(expected, rel=1e-10, abs=1e-13)


@weights
def test_direct_gradient_is_the_derivative_by_controls_with_the_sheep_held_still(
    played: Callable[[int], tuple[Trajectory, Array]],
    weights: tuple[float, float, float, float],
) -> None:
    trajectory, u = played(3)
    objective = random_objective(weights)
    *_, direct = objective.value_and_derivatives(trajectory, u, DT * SUBSTEPS)

    def value_with(index: tuple[int, ...], change: float) -> float:
        changed = u.copy()
        changed[index] += change
        steps = DT * np.repeat(changed, SUBSTEPS, axis=0)
        d = trajectory.d[:1] + np.concatenate([0.0 * steps[:1], np.cumsum(steps, axis=0)])
        moved = dataclasses.replace(trajectory, ds=np.ascontiguousarray(d.transpose(0, 2, 1)))
        return objective.value_and_derivatives(moved, changed, DT * SUBSTEPS)[0]

    for index in np.ndindex(*u.shape):
        expected = (value_with(index, 0.5) - value_with(index, -0.5)) / (DT * SUBSTEPS)
        assert direct[index] == pytest.approx(expected, rel=1e-10, abs=1e-13)


def test_unused_lanes_cost_nothing(
    played: Callable[[int], tuple[Trajectory, Array]],
) -> None:
    trajectory, u = played(11)
    objective = random_objective((1, 1, 1e-2, 0))
    expected = objective.value_and_derivatives(trajectory, u, DT * SUBSTEPS)[0]
    trajectory.xs[:, :, 11:] = 1e3
    assert objective.value_and_derivatives(trajectory, u, DT * SUBSTEPS)[0] == expected
