# SPDX-License-Identifier: Apache-2.0
import itertools

from herding_ros.control.solution import Budget, Problem, Status
from herding_ros.control.spg import spg
from herding_ros.model.state import Array
import numpy as np


def dot(a: Array, b: Array) -> float:
    return float(np.vdot(a, b))


def free(u: Array) -> Array:
    return u


def test_value_may_rise_on_the_way_but_the_best_point_is_returned() -> None:
    """On an ill-conditioned valley Barzilai-Borwein steps are not monotone."""
    curvature = np.array([1.0, 300.0])
    seen: list[tuple[float, Array]] = []

    def valley(u: Array) -> tuple[float, Array]:
        value = 0.5 * float(curvature @ u**2)
        seen.append((value, u))
        return value, curvature * u

    rose = False
    for limit in range(1, 25):
        seen.clear()
        found = spg(Problem(valley, free, dot), np.array([300.0, 1.0]), Budget(limit))
        values = [value for value, _ in seen]
        rose = rose or any(b > a for a, b in itertools.pairwise(values))
        assert found.value == min(values)
        assert found.value == valley(found.u)[0]
    assert rose


def test_quadratic_of_one_curvature_takes_a_single_spectral_step() -> None:
    """After one step the Barzilai-Borwein length is the inverse curvature: Newton's step."""
    aim = np.array([3.0, -4.0])

    def bowl(u: Array) -> tuple[float, Array]:
        return 0.05 * float((u - aim) @ (u - aim)), 0.1 * (u - aim)

    found = spg(Problem(bowl, free, dot), np.zeros(2), Budget(10, 1e-12))
    assert found.status is Status.CONVERGED
    assert (found.iterations, found.calls) == (2, 3)
    np.testing.assert_allclose(found.u, aim, rtol=1e-14)


def test_converged_means_the_projected_gradient_is_small() -> None:
    """The gradient itself is not: the minimum of a linear function lies on the boundary."""
    slope = np.array([1.0, 2.0])
    problem = Problem(lambda u: (float(slope @ u), slope), lambda u: np.clip(u, -1.0, 1.0), dot)
    found = spg(problem, np.zeros(2), Budget(10, 1e-12))
    assert found.status is Status.CONVERGED
    assert found.gradient_norm == 0.0
    np.testing.assert_array_equal(found.u, [-1.0, -1.0])
