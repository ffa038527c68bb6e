from collections.abc import Callable

import numpy as np
import pytest

from herding_ros.control.costs.leash import Leash
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.state import Array, HerdState

HerdMaker = Callable[..., HerdState]
DT, SUBSTEPS, INTERVALS = 0.1, 4, 5


def test_gradient_is_the_derivative_by_the_control(random_herd: HerdMaker) -> None:
    rng = np.random.default_rng(0)
    leash = Leash(0.7, rng.normal(0.0, 1.0, (INTERVALS * SUBSTEPS + 1, 2)))
    state, u = random_herd(3, 2), rng.normal(0.0, 0.05, (INTERVALS, 2, 2))

    def cost(u: Array) -> tuple[float, Array]:
        return leash.value_and_gradient(rollout(Crowd(), state, u, DT, SUBSTEPS), INTERVALS)

    _, gradient = cost(u)
    for index in np.ndindex(*u.shape):
        e = np.zeros_like(u)
        e[index] = 0.5
        expected = (cost(u + e)[0] - cost(u - e)[0]) / (DT * SUBSTEPS)  # quadratic: exact
        assert gradient[index] == pytest.approx(expected, rel=1e-10, abs=1e-13)


def test_a_dog_on_the_reference_costs_nothing(random_herd: HerdMaker) -> None:
    u = np.full((INTERVALS, 1, 2), 0.03)
    trajectory = rollout(Crowd(), random_herd(3, 1), u, DT, SUBSTEPS)
    value, gradient = Leash(2.0, trajectory.d[:, 0]).value_and_gradient(trajectory, INTERVALS)
    assert value == 0.0
    assert not gradient.any()
