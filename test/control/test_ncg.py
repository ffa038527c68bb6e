import itertools

import numpy as np

from herding_ros.control.ncg import ncg
from herding_ros.control.solution import Status
from herding_ros.model.state import Array


def dot(a: Array, b: Array) -> float:
    return float(np.vdot(a, b))


def recorded(curvature: Array, seen: list[float]) -> object:
    def valley(u: Array) -> tuple[float, Array]:
        value = 0.5 * float(curvature @ u**2)
        seen.append(value)
        return value, curvature * u

    return valley


def test_accepted_values_only_fall() -> None:
    curvature, values = np.array([1.0, 300.0]), []
    for limit in range(1, 25):
        found = ncg(recorded(curvature, []), lambda u: u, np.array([300.0, 1.0]), dot, 0.0, limit)
        values.append(found.value)
    assert all(b < a for a, b in itertools.pairwise(values))


def test_conjugate_directions_beat_steepest_descent() -> None:
    """On condition number k the error falls by (sqrt(k) - 1) / (sqrt(k) + 1) an iteration.

    Steepest descent would need some k / 2 iterations for each factor of e: 3500 here.
    """
    curvature = np.logspace(0.0, 3.0, 20)
    found = ncg(recorded(curvature, []), lambda u: u, np.ones(20), dot, 1e-9, 3500)
    assert found.status is Status.CONVERGED
    assert found.iterations < 2000
    np.testing.assert_allclose(found.u, 0.0, atol=1e-4)


def test_stops_as_the_paper_does_when_a_step_is_short() -> None:
    iterates: list[Array] = []

    def bowl(u: Array) -> tuple[float, Array]:
        iterates.append(u)
        return 0.05 * float(u @ u), 0.1 * u

    found = ncg(bowl, lambda u: u, np.array([30.0, 40.0]), dot, 0.5, 1000)
    assert found.status is Status.CONVERGED
    lengths = [np.linalg.norm(b - a) for a, b in itertools.pairwise(iterates)]
    assert lengths[-1] <= 0.5
    assert min(lengths[:-1]) > 0.5
