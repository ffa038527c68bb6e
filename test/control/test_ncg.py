# SPDX-License-Identifier: Apache-2.0
import itertools

from herding_ros.control.ncg import ncg
from herding_ros.control.solution import Budget, Problem, Solution, Status, ValueAndGradient
from herding_ros.model.state import Array
import numpy as np


def dot(a: Array, b: Array) -> float:
    return float(np.vdot(a, b))


def minimised(function: ValueAndGradient, start: Array, budget: Budget) -> Solution:
    return ncg(Problem(function, lambda u: u, dot), start, budget)


def valley(curvature: Array) -> ValueAndGradient:
    return lambda u: (0.5 * float(curvature @ u**2), curvature * u)


def test_accepted_values_only_fall() -> None:
    curvature, values = np.array([1.0, 300.0]), []
    for limit in range(1, 25):
        found = minimised(valley(curvature), np.array([300.0, 1.0]), Budget(limit))
        values.append(found.value)
    assert all(b < a for a, b in itertools.pairwise(values))


def test_conjugate_directions_beat_steepest_descent() -> None:
    """On condition number k the error falls by (sqrt(k) - 1) / (sqrt(k) + 1) an iteration.

    Steepest descent would need some k / 2 iterations for each factor of e: 3500 here.
    """
    curvature = np.logspace(0.0, 3.0, 20)
    found = minimised(valley(curvature), np.ones(20), Budget(3500, 1e-9))
    assert found.status is Status.CONVERGED
    assert found.iterations < 2000
    np.testing.assert_allclose(found.u, 0.0, atol=1e-4)


def test_stops_as_the_paper_does_when_a_step_is_short() -> None:
    iterates: list[Array] = []

    def bowl(u: Array) -> tuple[float, Array]:
        iterates.append(u)
        return 0.05 * float(u @ u), 0.1 * u

    found = minimised(bowl, np.array([30.0, 40.0]), Budget(1000, 0.5))
    assert found.status is Status.CONVERGED
    lengths = [np.linalg.norm(b - a) for a, b in itertools.pairwise(iterates)]
    assert lengths[-1] <= 0.5
    assert min(lengths[:-1]) > 0.5
