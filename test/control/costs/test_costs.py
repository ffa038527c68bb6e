"""What every cost promises; what is special to one stands in its own file."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from herding_ros.control.costs.check import taylor_orders
from herding_ros.control.costs.containment import Containment
from herding_ros.control.costs.cost import Cost
from herding_ros.control.costs.terminal import Terminal
from herding_ros.control.costs.tracking import Tracking
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.state import Array, HerdState, Trajectory

HerdMaker = Callable[..., HerdState]

STEPS, DT = 12, 0.1
ROUTE = np.random.default_rng(9).normal(0.0, 0.3, (STEPS + 1, 2))
COSTS: dict[str, Cost] = {
    'centre': Tracking(3.0, 0.0, ROUTE),
    'spread': Tracking(0.1, 2.0, ROUTE),
    'tracking': Tracking(3.0, 1.0, ROUTE),
    'terminal': Terminal(5.0, Tracking(3.0, 1.0, ROUTE)),
    'disc': Containment(2.0, 0.3, np.array([0.5, 0.5])),
    'moving disc': Containment(2.0, 0.3, ROUTE),
    'point': Containment(2.0, 0.0, ROUTE),
}
costs = pytest.mark.parametrize('cost', COSTS.values(), ids=COSTS)
sheep = pytest.mark.parametrize('n', [1, 8, 11])


def played(random_herd: HerdMaker, n: int) -> Trajectory:
    u = np.random.default_rng(n).normal(0.0, 0.05, (STEPS, 2, 2))
    return rollout(Crowd(), random_herd(n, 2), u, DT)


def direction(trajectory: Trajectory, seed: int) -> Array:
    w = np.zeros_like(trajectory.xs)
    w[:, :, : trajectory.n] = np.random.default_rng(seed).normal(size=(STEPS + 1, 2, trajectory.n))
    return w


@costs
@sheep
def test_taylor_remainders_of_value_and_derivative_are_of_second_order(
    random_herd: HerdMaker, cost: Cost, n: int
) -> None:
    trajectory = played(random_herd, n)
    w = direction(trajectory, 3)
    slope = (cost.value_and_derivative(trajectory)[1] * w).sum()
    curvature = (cost.second_derivative(trajectory, w) * w).sum()
    assert abs(slope) > 1e-3  # there is something to get wrong
    assert abs(curvature) > 1e-3
    assert min(taylor_orders(cost, trajectory, np.random.default_rng(3))) > 1.9


@costs
@sheep
def test_derivatives_agree_with_central_differences_at_every_step(
    random_herd: HerdMaker, cost: Cost, n: int
) -> None:
    trajectory, h = played(random_herd, n), 1e-5
    _, derivative = cost.value_and_derivative(trajectory)
    for k in (0, 1, STEPS - 1, STEPS):
        for index in np.ndindex(2, n):
            e = np.zeros_like(trajectory.xs)
            e[(k, *index)] = h
            there, back = (
                cost.value_and_derivative(replace(trajectory, xs=trajectory.xs + each))
                for each in (e, -e)
            )
            slope = (there[0] - back[0]) / (2.0 * h)
            assert derivative[(k, *index)] == pytest.approx(slope, rel=1e-6, abs=1e-9)
            change = cost.second_derivative(trajectory, e)
            np.testing.assert_allclose(change, 0.5 * (there[1] - back[1]), rtol=0, atol=1e-10)


@costs
def test_second_derivative_is_symmetric(random_herd: HerdMaker, cost: Cost) -> None:
    trajectory = played(random_herd, 11)
    v, w = (direction(trajectory, seed) for seed in (1, 2))
    there = (v * cost.second_derivative(trajectory, w)).sum()
    back = (w * cost.second_derivative(trajectory, v)).sum()
    assert abs(there) > 1e-3
    assert there == pytest.approx(back, rel=1e-12)


@costs
@sheep
def test_unused_lanes_and_the_start_cost_nothing(
    random_herd: HerdMaker, cost: Cost, n: int
) -> None:
    trajectory = played(random_herd, n)
    value, derivative = cost.value_and_derivative(trajectory)
    w = direction(trajectory, 1)
    change = cost.second_derivative(trajectory, w)
    assert value > 0.0 or n == 1
    for each in (derivative, change):
        assert each.shape == trajectory.xs.shape
        assert not each[:, :, n:].any()
        assert not each[0].any()
    trajectory.xs[:, :, n:] = 1e3
    trajectory.xs[0] += 1.0
    again, derivative_again = cost.value_and_derivative(trajectory)
    assert again == value
    np.testing.assert_array_equal(derivative_again, derivative)
    np.testing.assert_array_equal(cost.second_derivative(trajectory, w), change)


@costs
def test_derivative_is_an_array_of_its_own(random_herd: HerdMaker, cost: Cost) -> None:
    """The objective adds other derivatives to it."""
    trajectory = played(random_herd, 8)
    _, derivative = cost.value_and_derivative(trajectory)
    expected = derivative.copy()
    derivative += 1.0
    np.testing.assert_array_equal(cost.value_and_derivative(trajectory)[1], expected)


@dataclass(frozen=True)
class Skewed:
    """A cost with a mistake of one part in a hundred in one of its derivatives."""

    first: float
    second: float

    def value_and_derivative(self, trajectory: Trajectory) -> tuple[float, Array]:
        value, derivative = COSTS['moving disc'].value_and_derivative(trajectory)
        return value, self.first * derivative

    def second_derivative(self, trajectory: Trajectory, dx: Array) -> Array:
        return self.second * COSTS['moving disc'].second_derivative(trajectory, dx)


@pytest.mark.parametrize(('first', 'second'), [(1.01, 1.01), (1.0, 0.99)])
def test_a_wrong_derivative_is_found(random_herd: HerdMaker, first: float, second: float) -> None:
    trajectory = played(random_herd, 11)
    orders = taylor_orders(Skewed(first, second), trajectory, np.random.default_rng(0))
    right = (first == 1.0, first == second)
    assert [order > 1.9 for order in orders] == list(right)
    assert min(orders) < 1.5
