# SPDX-License-Identifier: Apache-2.0
"""What every cost promises, and the sum that each of them is."""

from collections.abc import Callable
from dataclasses import dataclass, replace
import itertools
import math

from herding_ros.control.costs.check import taylor_orders
from herding_ros.control.costs.containment import Containment
from herding_ros.control.costs.control_effort import ControlEffort
from herding_ros.control.costs.cost import Cost, Derivatives
from herding_ros.control.costs.distance import Distance
from herding_ros.control.costs.leash import Leash
from herding_ros.control.costs.spacing import Spacing
from herding_ros.control.costs.terminal import Terminal
from herding_ros.control.costs.tracking import Tracking
from herding_ros.control.costs.walls import Walls
from herding_ros.control.objective import Objective, weighted_costs
from herding_ros.control.parameters import Weights
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.state import Array, HerdState, Trajectory
import numpy as np
import pytest

HerdMaker = Callable[..., HerdState]
Played = tuple[Trajectory, Array]

DT, SUBSTEPS, INTERVALS, DOGS = 0.1, 3, 4, 2
STEPS = INTERVALS * SUBSTEPS
ROUTE = np.random.default_rng(9).normal(0.0, 0.3, (STEPS + 1, 2))
CONTROL = np.random.default_rng(10).normal(0.0, 0.05, (INTERVALS, DOGS, 2))
COSTS: dict[str, Cost] = {
    'tracking': Tracking(3.0, 1.0, ROUTE),
    'distance': Distance(2.0, 0.05, ROUTE),
    'terminal': Terminal(5.0, [Tracking(3.0, 1.0, ROUTE[-2:]), Distance(2.0, 0.05, ROUTE[-2:])]),
    'disc': Containment(2.0, 0.3, np.array([0.5, 0.5])),
    'moving disc': Containment(2.0, 0.3, ROUTE),
    'point': Containment(2.0, 0.0, ROUTE),
    'leash': Leash(0.7, ROUTE),
    'spacing': Spacing(0.7, 1.5),
    'walls': Walls(0.7, 1.5, np.array([[-1.0, 0.3, 1.0, 0.4, 0.0], [0.1, 0.8, 0.1, 0.8, 0.2]])),
    'control effort': ControlEffort(0.3, CONTROL),
}
COSTS['all'] = Objective(list(COSTS.values()))
costs = pytest.mark.parametrize('cost', COSTS.values(), ids=COSTS)


@pytest.fixture(params=[1, 8, 11])
def played(random_herd: HerdMaker, request: pytest.FixtureRequest) -> Played:
    n = request.param
    u = np.random.default_rng(n).normal(0.0, 0.05, (INTERVALS, DOGS, 2))
    return rollout(Crowd(), random_herd(n, DOGS), u, DT, SUBSTEPS), u


@costs
def test_derivatives_are_those_of_the_value(played: Played, cost: Cost) -> None:
    trajectory, u = played
    assert min(taylor_orders(cost, trajectory, u, np.random.default_rng(3))) > 1.9
    _, by = cost.value_and_derivatives(trajectory, u)
    for part, like in ((by.x, trajectory.xs), (by.d, trajectory.ds), (by.u, u)):
        if part is not None:
            assert part.shape == like.shape
            assert np.abs(part).max() > 1e-4  # there is something to get wrong


@costs
def test_unused_lanes_and_the_start_cost_nothing(played: Played, cost: Cost) -> None:
    trajectory, u = played
    value, by = cost.value_and_derivatives(trajectory, u)
    xs, ds = trajectory.xs.copy(), trajectory.ds.copy()
    xs[:, :, trajectory.n :] = 1e3
    xs[0] += 1.0
    ds[0] += 1.0
    again, by_again = cost.value_and_derivatives(replace(trajectory, xs=xs, ds=ds), u)
    assert again == value
    for part, part_again in ((by.x, by_again.x), (by.d, by_again.d)):
        if part is not None:
            np.testing.assert_array_equal(part, part_again)
            assert not part[0].any()
    if by.x is not None:
        assert not by.x[:, :, trajectory.n :].any()


def test_costs_are_the_sums_they_say(played: Played) -> None:
    """All that weights can ask for, written out as in the paper and the README."""
    trajectory, u = played
    n = trajectory.n
    w = Weights(
        distance=1.5, centre=3.0, spread=2.0, control=0.3, dogs=0.7, terminal=5.0,
        containment=2.0, radius=0.4,
    )  # fmt: skip
    expected = 0.0
    for k in range(1, STEPS + 1):
        centre = sum(trajectory.x[k]) / n
        time = DT + (w.terminal if k == STEPS else 0.0)
        expected += time * w.centre / 2 * sum((centre - ROUTE[k]) ** 2)
        expected += time * w.distance * (math.hypot(*(centre - ROUTE[k]), 0.05) - 0.05)
        for each in trajectory.x[k]:
            expected += time * w.spread / (2 * n) * sum((each - centre) ** 2)
            beyond = max(math.dist(each, ROUTE[k]) - w.radius, 0.0)
            expected += DT * w.containment / (3 * n) * beyond**3
        for each in trajectory.d[k]:
            expected += DT * w.dogs / 2 * sum((each - ROUTE[k]) ** 2)
    expected += DT * SUBSTEPS * w.control / 2 * float(np.square(u - CONTROL).sum())
    objective = Objective([*weighted_costs(w, ROUTE, 0.05), ControlEffort(w.control, CONTROL)])
    assert objective.value_and_derivatives(trajectory, u)[0] == pytest.approx(expected, rel=1e-12)


def test_spacing_is_the_sum_it_says(random_herd: HerdMaker) -> None:
    u = np.random.default_rng(1).normal(0.0, 0.05, (INTERVALS, 5, 2))
    trajectory = rollout(Crowd(), random_herd(3, 5), u, DT, SUBSTEPS)
    expected = 0.0
    for d in trajectory.d[1:]:
        for one, other in itertools.combinations(d, 2):
            expected += DT * 0.7 * max(1.0 - (math.dist(one, other) / 1.2) ** 2, 0.0) ** 2
    assert expected > 0.0
    cost = Spacing(0.7, 1.2)
    assert cost.value_and_derivatives(trajectory, u)[0] == pytest.approx(expected, rel=1e-12)
    assert min(taylor_orders(cost, trajectory, u, np.random.default_rng(3))) > 1.9


def test_equal_weights_are_the_cost_of_the_paper(played: Played) -> None:
    trajectory, u = played
    found, _ = Tracking(1.0, 1.0, ROUTE).value_and_derivatives(trajectory, u)
    individuals = np.square(trajectory.x - ROUTE[:, None])[1:].sum() / trajectory.n
    assert found == pytest.approx(0.5 * DT * individuals, rel=1e-13)


def test_weights_of_zero_leave_nothing_to_compute() -> None:
    found = weighted_costs(Weights(distance=0.0, dogs=0.0, terminal=0.0), ROUTE, 0.05)
    assert [type(cost) for cost in found] == [Tracking]


def test_a_cost_has_derivatives_where_it_has_a_kink() -> None:
    """A sheep at the centre of the disc, and one on the rim."""
    xs = np.zeros((2, 2, 8))
    for radius in (0.0, 0.5):
        xs[1, 0, 0] = radius
        trajectory = Trajectory(1.0, 1, xs, 0.0 * xs, np.zeros((2, 2, 1)))
        cost = Containment(3.0, radius, np.zeros(2))
        value, by = cost.value_and_derivatives(trajectory, np.zeros((1, 1, 2)))
        assert value == 0.0
        assert by.x is not None
        assert not by.x.any()


@dataclass(frozen=True)
class Skewed:
    """All costs, with a mistake of one part in a hundred in one of the derivatives."""

    wrong: str

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        value, by = COSTS['all'].value_and_derivatives(trajectory, u)
        return value, replace(by, **{self.wrong: 1.01 * getattr(by, self.wrong)})


@pytest.mark.parametrize('wrong', ['x', 'd', 'u'])
def test_a_wrong_derivative_is_found(random_herd: HerdMaker, wrong: str) -> None:
    trajectory = rollout(Crowd(), random_herd(11, DOGS), CONTROL, DT, SUBSTEPS)
    orders = taylor_orders(Skewed(wrong), trajectory, 10.0 * CONTROL, np.random.default_rng(0))
    assert [order < 1.5 for order in orders] == [each == wrong for each in 'xdu']
