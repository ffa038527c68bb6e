from collections.abc import Callable
from dataclasses import replace
import math

import numpy as np
import pytest

from herding_ros.control.costs.containment import Containment
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.state import HerdState, Trajectory

HerdMaker = Callable[..., HerdState]
DT, STEPS = 0.1, 20


def played(random_herd: HerdMaker, n: int = 11) -> Trajectory:
    return rollout(Crowd(), random_herd(n, 2), np.zeros((STEPS, 2, 2)), DT)


def test_cost_is_the_sum_it_says(random_herd: HerdMaker) -> None:
    trajectory = played(random_herd)
    centres = np.random.default_rng(0).normal(0.0, 0.2, (STEPS + 1, 2))
    found, _ = Containment(5.0, 0.3, centres).value_and_derivative(trajectory)
    expected = sum(
        5.0 / (3.0 * 11) * max(math.dist(x, centres[k]) - 0.3, 0.0) ** 3 * DT
        for k in range(1, STEPS + 1)
        for x in trajectory.x[k]
    )
    assert found == pytest.approx(expected, rel=1e-13)


def test_inside_nothing_counts(random_herd: HerdMaker) -> None:
    trajectory = played(random_herd)
    cost = Containment(5.0, 10.0, np.zeros(2))
    value, derivative = cost.value_and_derivative(trajectory)
    assert value == 0.0
    assert not derivative.any()
    assert not cost.second_derivative(trajectory, np.ones_like(trajectory.xs)).any()


def test_turning_all_turns_the_derivative(random_herd: HerdMaker) -> None:
    trajectory = played(random_herd)
    cost, turn = Containment(5.0, 0.2, np.zeros(2)), np.array([[0.6, -0.8], [0.8, 0.6]])
    value, derivative = cost.value_and_derivative(trajectory)
    turned_value, turned = cost.value_and_derivative(replace(trajectory, xs=turn @ trajectory.xs))
    assert turned_value == pytest.approx(value, rel=1e-13)
    np.testing.assert_allclose(turned, turn @ derivative, rtol=0, atol=1e-16)


def test_derivatives_exist_at_the_centre_and_join_at_the_rim() -> None:
    """The second derivative rises from zero at the rim, and radially it is 2 e."""
    for radius in (0.0, 0.5):
        for excess in (0.0, 1e-9, 1e-3):
            xs = np.zeros((2, 2, 8))
            xs[1, 0, 0] = radius + excess
            cost = Containment(3.0, radius, np.zeros(2))
            trajectory = Trajectory(1.0, 1, xs, 0.0 * xs, np.zeros((2, 2, 1)))
            dx = np.zeros_like(xs)
            dx[1, 0, 0] = 1.0
            change = cost.second_derivative(trajectory, dx)
            assert change[1, 0, 0] == pytest.approx(6.0 * excess, abs=1e-15)
            assert not change[1, 1].any()
    at_centre = Trajectory(1.0, 1, np.zeros((2, 2, 8)), np.zeros((2, 2, 8)), np.zeros((2, 2, 1)))
    value, derivative = Containment(3.0, 0.0, np.zeros(2)).value_and_derivative(at_centre)
    assert value == 0.0
    assert not derivative.any()
