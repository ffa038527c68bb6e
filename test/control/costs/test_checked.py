# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
from dataclasses import dataclass, replace
import re
from typing import Any

from herding_ros.control.closed_loop import closed_loop
from herding_ros.control.costs.check import taylor_orders
from herding_ros.control.costs.checked import Checked
from herding_ros.control.costs.cost import Derivatives
from herding_ros.control.parameters import Control, Horizon, Mapping
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.scenario import initial_herd
from herding_ros.model.simulation import World
from herding_ros.model.state import Array, Trajectory
import numpy as np
import pytest

GOAL = np.array([0.5, 0.5])


@dataclass(frozen=True)
class Mine:
    answer: Callable[[Trajectory, Array], tuple[Any, Any]]

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[Any, Any]:
        return self.answer(trajectory, u)


def a_trajectory() -> tuple[Trajectory, Array]:
    rng = np.random.default_rng(0)
    u = rng.normal(0.0, 0.05, (4, 3, 2))
    return rollout(Crowd(), initial_herd(5, 3, GOAL, rng), u, 0.1), u


FAULTS: list[tuple[Any, str]] = [
    (lambda r, u: (np.nan, Derivatives()), 'the value of Mine must be finite'),
    (lambda r, u: (None, Derivatives()), 'the value of Mine must be finite'),
    (lambda r, u: (u[0], Derivatives()), 'the value of Mine must have shape (), got (3, 2)'),
    (lambda r, u: (0.0, Derivatives(d=1.0)), 'by d must have shape (5, 2, 3), got ()'),  # type: ignore
    (lambda r, u: (0.0, Derivatives(d=r.ds[0])), 'by d must have shape (5, 2, 3), got (2, 3)'),
    (lambda r, u: (0.0, Derivatives(d=r.d)), 'by d must have shape (5, 2, 3), got (5, 3, 2)'),
    (lambda r, u: (0.0, Derivatives(x=r.x)), 'by x must have shape (5, 2, 8), got (5, 5, 2)'),
    (lambda r, u: (0.0, Derivatives(u=u[0])), 'by u must have shape (4, 3, 2), got (3, 2)'),
    (lambda r, u: (0.0, Derivatives(u=np.nan * u)), 'the derivative of Mine by u must be finite'),
]


@pytest.mark.parametrize(('answer', 'words'), FAULTS)
def test_what_is_no_cost_is_refused(answer: Any, words: str) -> None:
    """Where shapes can be broadcast a plan was made, of another cost."""
    with pytest.raises(ValueError, match=re.escape(words)):
        Checked(Mine(answer)).value_and_derivatives(*a_trajectory())


def test_a_wrong_derivative_does_not_pass_for_one_that_vanishes() -> None:
    trajectory, u = a_trajectory()
    cost = Mine(lambda r, u: (np.nan, Derivatives(d=np.nan * r.ds)))
    with pytest.raises(ValueError, match='the value of Mine must be finite'):
        taylor_orders(cost, trajectory, u, np.random.default_rng(1))


def test_single_precision_does_not_spread() -> None:
    """Otherwise the sum of all costs is in single precision, and the optimiser sees steps."""
    cost = Mine(lambda r, u: (np.float32(1.0), Derivatives(u=u.astype(np.float32))))
    trajectory, u = a_trajectory()
    value, by = Checked(cost).value_and_derivatives(trajectory, u)
    assert type(value) is float
    assert by.u is not None
    assert by.u.dtype == np.float64
    assert by.x is by.d is None


def test_of_a_herd_that_explodes_a_cost_need_not_be_finite() -> None:
    trajectory, u = a_trajectory()
    cost = Checked(Mine(lambda r, u: (r.xs.sum(), Derivatives(x=np.ones_like(r.xs)))))
    value, _ = cost.value_and_derivatives(
        replace(trajectory, xs=np.full_like(trajectory.xs, np.nan)), u
    )
    assert not np.isfinite(value)


def test_a_plan_is_made_of_sound_costs_alone() -> None:
    control = Control(horizon=Horizon(length=2.0, accepted=1.0), mapping=Mapping(max_iterations=0))
    cost = Mine(lambda r, u: (np.nan, Derivatives()))
    with pytest.raises(ValueError, match='the value of Mine must be finite'):
        closed_loop(Crowd(), World(sheep=3, dogs=2), control, GOAL, 0.3, [cost])
