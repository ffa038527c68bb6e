from collections.abc import Callable

import numpy as np
import pytest

from herding_ros.control.costs.terminal import Terminal
from herding_ros.control.costs.tracking import Tracking
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import centre, spread
from herding_ros.model.state import HerdState

HerdMaker = Callable[..., HerdState]


def test_only_the_last_instant_counts(random_herd: HerdMaker) -> None:
    reference = np.random.default_rng(0).normal(0.0, 1.0, (21, 2))
    trajectory = rollout(Crowd(), random_herd(11, 2), np.zeros((20, 2, 2)), 0.1)
    cost = Terminal(7.0, Tracking(3.0, 2.0, reference))
    value, derivative = cost.value_and_derivative(trajectory)
    x = trajectory.x[-1]
    away = np.square(centre(x) - reference[-1]).sum()
    assert value == pytest.approx(7.0 * 0.5 * (3.0 * away + 2.0 * spread(x) ** 2), rel=1e-13)
    assert derivative[-1].any()
    assert not derivative[:-1].any()


def test_it_does_not_depend_on_the_time_step(random_herd: HerdMaker) -> None:
    """A running cost is worth its integral, a terminal one its value."""
    reference = np.ones((41, 2))
    state = random_herd(8, 2)
    values = [
        Terminal(2.0, Tracking(1.0, 1.0, reference[: steps + 1])).value_and_derivative(
            rollout(Crowd(), state, np.zeros((steps, 2, 2)), 0.4 / steps)
        )[0]
        for steps in (20, 40)
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-2)
