from collections.abc import Callable

import numpy as np
import pytest

from herding_ros.control.costs.tracking import Tracking
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.state import HerdState

HerdMaker = Callable[..., HerdState]


@pytest.mark.parametrize('n', [1, 8, 11])
def test_equal_weights_are_the_cost_of_the_paper(random_herd: HerdMaker, n: int) -> None:
    reference = np.random.default_rng(0).normal(0.0, 1.0, (21, 2))
    trajectory = rollout(Crowd(), random_herd(n, 2), np.zeros((20, 2, 2)), 0.1)
    found, _ = Tracking(1.0, 1.0, reference).value_and_derivative(trajectory)
    individuals = np.square(trajectory.x - reference[:, None])[1:].sum() / n
    assert found == pytest.approx(0.5 * 0.1 * individuals, rel=1e-13)


def test_a_flock_on_its_reference_costs_its_spread_alone(random_herd: HerdMaker) -> None:
    trajectory = rollout(Crowd(), random_herd(8, 2), np.zeros((20, 2, 2)), 0.1)
    offset = trajectory.x - trajectory.x.mean(axis=1, keepdims=True)
    tracking = Tracking(7.0, 2.0, trajectory.x.mean(axis=1))
    found, derivative = tracking.value_and_derivative(trajectory)
    assert found == pytest.approx(0.1 * np.square(offset[1:]).sum() / 8, rel=1e-13)
    # Nothing pulls at the flock as a whole.
    np.testing.assert_allclose(derivative.sum(axis=2), 0.0, atol=1e-15)
