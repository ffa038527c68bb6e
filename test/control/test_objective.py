from collections.abc import Callable
import dataclasses

import numpy as np
import pytest

from herding_ros.control.costs.containment import Containment
from herding_ros.control.costs.cost import Cost
from herding_ros.control.costs.tracking import Tracking
from herding_ros.control.objective import Objective
from herding_ros.control.parameters import Weights
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.state import Array, HerdState, Trajectory

HerdMaker = Callable[..., HerdState]

DT, SUBSTEPS, INTERVALS, DOGS = 0.1, 4, 5, 2
STEPS = INTERVALS * SUBSTEPS
# of centre, spread, control, dogs and terminal
WEIGHTS = [
    Weights(1.0, 1.0, 1e-2, 0.0),
    Weights(3.0, 1.0, 1e-2, 3e-3),
    Weights(1.0, 0.0, 0.3, 0.0, terminal=5.0),
    Weights(0.0, 2.0, 1e-9, 0.7, terminal=0.3),
]
weights = pytest.mark.parametrize('weights', WEIGHTS)
sheep = pytest.mark.parametrize('n', [1, 8, 11])


@pytest.fixture
def played(random_herd: HerdMaker) -> Callable[[int], tuple[Trajectory, Array]]:
    def play(n: int) -> tuple[Trajectory, Array]:
        u = np.random.default_rng(n).normal(0.0, 0.05, (INTERVALS, DOGS, 2))
        return rollout(Crowd(), random_herd(n, DOGS), u, DT, SUBSTEPS), u

    return play


REFERENCE = np.random.default_rng(9).normal(0.0, 1.0, (STEPS + 1, 2))
CONTROL_REFERENCE = np.random.default_rng(10).normal(0.0, 0.05, (INTERVALS, DOGS, 2))


def random_objective(weights: Weights, *further: Cost) -> Objective:
    return Objective.weighted(weights, REFERENCE, CONTROL_REFERENCE, further)


@weights
@sheep
def test_cost_is_the_sum_it_says(
    played: Callable[[int], tuple[Trajectory, Array]],
    n: int,
    weights: Weights,
) -> None:
    trajectory, u = played(n)
    objective = random_objective(weights)
    a, b, gamma, c = weights.centre, weights.spread, weights.control, weights.dogs
    expected = 0.0
    for k in range(1, STEPS + 1):
        centre = sum(trajectory.x[k]) / n
        time = DT + (weights.terminal if k == STEPS else 0.0)
        expected += time * a / 2 * sum((centre - REFERENCE[k]) ** 2)
        for each in trajectory.x[k]:
            expected += time * b / (2 * n) * sum((each - centre) ** 2)
        for each in trajectory.d[k]:
            expected += DT * c / 2 * sum((each - REFERENCE[k]) ** 2)
    for k in range(INTERVALS):
        for m in range(DOGS):
            change = u[k, m] - CONTROL_REFERENCE[k, m]
            expected += DT * SUBSTEPS * gamma / 2 * sum(change**2)
    found, *_ = objective.value_and_derivatives(trajectory, u, DT * SUBSTEPS)
    assert found == pytest.approx(expected, rel=1e-13)


def test_costs_add_up(played: Callable[[int], tuple[Trajectory, Array]]) -> None:
    """Those that the weights ask for, and further ones."""
    trajectory, u = played(11)
    contained = Containment(2.0, 0.5, REFERENCE)
    weights = dataclasses.replace(WEIGHTS[1], containment=2.0, radius=0.5)
    plain, by_weight, further = (
        random_objective(*each).value_and_derivatives(trajectory, u, DT * SUBSTEPS)
        for each in ((WEIGHTS[1],), (weights,), (WEIGHTS[1], contained))
    )
    value, derivative = contained.value_and_derivative(trajectory)
    assert value > 0.1
    for found in (by_weight, further):
        assert found[0] == pytest.approx(plain[0] + value, rel=1e-13)
        np.testing.assert_allclose(found[1], plain[1] + derivative, rtol=0, atol=1e-14)
        np.testing.assert_array_equal(found[2], plain[2])


def test_weights_of_zero_leave_nothing_to_compute() -> None:
    weights = Weights(dogs=0.0)
    objective = random_objective(weights)
    assert [type(cost) for cost in objective.costs] == [Tracking]
    assert objective.leash is None


@weights
@sheep
def test_source_is_the_derivative_of_the_cost(
    played: Callable[[int], tuple[Trajectory, Array]],
    n: int,
    weights: Weights,
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
    weights: Weights,
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
    objective = random_objective(WEIGHTS[0])
    expected = objective.value_and_derivatives(trajectory, u, DT * SUBSTEPS)[0]
    trajectory.xs[:, :, 11:] = 1e3
    assert objective.value_and_derivatives(trajectory, u, DT * SUBSTEPS)[0] == expected
