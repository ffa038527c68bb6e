# SPDX-License-Identifier: Apache-2.0
from dataclasses import dataclass
from functools import partial

from herding_ros.control.added_cost import AddedCost
from herding_ros.control.closed_loop import closed_loop
from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.costs.check import taylor_orders
from herding_ros.control.costs.cost import Cost, Derivatives
from herding_ros.control.costs.leash import Leash
from herding_ros.control.costs.tracking import Tracking
from herding_ros.control.parameter_extraction import ParameterExtraction
from herding_ros.control.parameters import Control, Horizon, Mapping, Weights
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.flock import centre
from herding_ros.model.motion import Holonomic
from herding_ros.model.scenario import initial_herd
from herding_ros.model.simulation import World
from herding_ros.model.state import Array, Trajectory
import numpy as np
import pytest

GOAL = np.array([0.5, 0.5])
LIMIT, GAMMA, INTERVALS, DOGS = 0.05, 1e-2, 40, 3
REFERENCE = np.zeros((2 * INTERVALS + 1, 2))
admissible = partial(Holonomic().project, max_speed=LIMIT)


@dataclass(frozen=True)
class Apart:
    """int w/6 sum_m,l max(r - |d_m - d_l|, 0)^3 dt: dogs should keep r [m] apart."""

    weight: float
    distance: float

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return the cost and its derivative by the positions of the dogs."""
        d = trajectory.ds[:, :2]
        offset = d[..., None] - d[:, :, None]
        length = np.sqrt(np.square(offset).sum(axis=1, keepdims=True))
        lacking = np.where(length > 0.0, np.maximum(self.distance - length, 0.0), 0.0)
        lacking[0] = 0.0
        scale = self.weight * trajectory.dt
        direction = np.divide(offset, length, out=np.zeros_like(offset), where=length > 0.0)
        derivative = np.zeros_like(trajectory.ds)
        derivative[:, :2] = -scale * (lacking**2 * direction).sum(axis=3)
        return scale / 6.0 * float((lacking**3).sum()), Derivatives(d=derivative)


def least_distance(d: Array) -> float:
    """Return the least distance [m] of two dogs along their path (T, M, 2) [m]."""
    pairs = [(m, k) for m in range(d.shape[1]) for k in range(m)]
    return min(float(np.linalg.norm(d[:, m] - d[:, k], axis=1).min()) for m, k in pairs)


@pytest.fixture
def coarse() -> CoarseModel:
    state = initial_herd(8, DOGS, GOAL, np.random.default_rng(0))
    return CoarseModel(Crowd(), state, 0.05, 2)


def plan(seed: int = 0) -> Array:
    return admissible(np.random.default_rng(seed).normal(0.0, 0.03, (INTERVALS, DOGS, 2)))


def test_the_cost_of_dogs_has_the_right_derivatives(coarse: CoarseModel) -> None:
    cost, u = Apart(30.0, 1.0), plan()
    trajectory = coarse.rollout(u)
    orders = taylor_orders(cost, trajectory, u, np.random.default_rng(1))
    assert orders[1] > 1.9
    value, gradient = coarse.value_and_gradient(cost, u)
    assert value > 0.1
    w, steps = plan(2), 1e-2 * 2.0 ** -np.arange(4.0)
    slope = coarse.inner(gradient, w)
    there = [coarse.value_and_gradient(cost, u + h * w)[0] for h in steps]
    left = np.abs(np.array(there) - value - steps * slope)
    assert np.log2(left[:-1] / left[1:]).min() > 1.9


@pytest.mark.parametrize('cost', [Leash(0.3, REFERENCE), Apart(30.0, 1.0)])
def test_added_cost_is_what_is_added_with_the_sheep_held(coarse: CoarseModel, cost: Cost) -> None:
    u, held = plan(), coarse.rollout(plan())
    added = AddedCost.to_plan(coarse, [Tracking(1.0, 1.0, REFERENCE), cost], u)
    assert added is not None
    value, gradient = added(u)
    assert (value, np.abs(gradient).max()) == (0.0, 0.0)
    before = cost.value_and_derivatives(held, u)[0]
    signs = set()
    for step in (-1.0, -0.3, -0.1, 0.1, 0.3, 1.0):
        other = u + step * plan(1)
        more = cost.value_and_derivatives(coarse.rollout(other), other)[0] - before
        signs.add(more > 0.0)
        value, gradient = added(other)
        assert max(more, 0.0) - 0.05 * before - 1e-15 <= value <= max(more, 0.0) + 1e-15
        h, w = 1e-4, plan(2)
        slope = (added(other + h * w)[0] - added(other - h * w)[0]) / (2.0 * h)
        assert coarse.inner(gradient, w) == pytest.approx(slope, rel=1e-4, abs=1e-10)
    assert signs == {True, False}


def test_costs_of_sheep_alone_add_nothing(coarse: CoarseModel) -> None:
    assert AddedCost.to_plan(coarse, [Tracking(1.0, 1.0, REFERENCE)], plan()) is None


@pytest.mark.parametrize('costs', [[], [Leash(0.3, REFERENCE)], [Apart(30.0, 1.0)]])
def test_without_a_defect_the_coarse_optimum_is_extracted(
    coarse: CoarseModel, costs: list[Cost]
) -> None:
    u = plan()
    extraction = ParameterExtraction(coarse, admissible, LIMIT, u, GAMMA, costs)
    target = centre(coarse.rollout(u).x)
    np.testing.assert_allclose(extraction.near(target, u, GAMMA), u, rtol=0, atol=1e-9)
    np.testing.assert_allclose(extraction.extract(target, u), u, rtol=0, atol=1e-9)


def test_out_of_time_a_search_ends_within_two_evaluations(coarse: CoarseModel) -> None:
    """By a clock on which an evaluation of an expensive cost takes a second, and nothing else."""
    now = 0

    class Expensive(Apart):
        def value_and_derivatives(
            self, trajectory: Trajectory, u: Array
        ) -> tuple[float, Derivatives]:
            nonlocal now
            now += 1
            return super().value_and_derivatives(trajectory, u)

    def seconds(limit: float) -> int:
        nonlocal now
        now = 0
        extraction = ParameterExtraction(
            coarse, admissible, LIMIT, plan(), GAMMA, [Expensive(300.0, 1.0)], lambda: now >= limit
        )
        u = extraction.extract(centre(coarse.rollout(plan(3)).x), plan())
        assert np.linalg.norm(u, axis=-1).max() <= LIMIT * (1.0 + 1e-12)
        return now

    assert seconds(np.inf) > 12
    for limit in range(2, 12):
        assert seconds(limit) <= limit + 2


def test_a_correction_pays_for_what_it_undoes() -> None:
    """A plan that keeps its dogs apart stays so when it is corrected for the noise."""
    state = initial_herd(30, 5, GOAL, np.random.default_rng(40))
    cost = Apart(300.0, 0.4)

    def planned(**mapping: int) -> tuple[float, float, float]:
        weights = Weights(centre=1.0, spread=1.0, terminal=0.0, distance=0.0, beyond=0.0)
        control = Control(weights=weights, mapping=Mapping(**mapping))
        window = RecedingHorizon(Crowd(noise=0.03), control, GOAL, 1, [cost]).solve(state, 0.0)
        report = window.report
        before, after = report.mapping_error_before, report.mapping_error_after
        return least_distance(window.dogs), before, after

    coarse, _, _ = planned(max_iterations=0)
    corrected, before, after = planned(max_iterations=4)
    assert corrected > coarse - 0.03
    assert after < 0.3 * before


def test_a_cost_that_sees_dogs_counts_in_closed_loop() -> None:
    control = Control(horizon=Horizon(length=8.0, accepted=4.0), mapping=Mapping(paths=20))
    near, apart = (
        least_distance(closed_loop(Crowd(), World(sheep=9), control, GOAL, 16.0, costs).d)
        for costs in ([], [Apart(3000.0, 0.3)])
    )
    assert near < 0.15
    assert apart > 0.25
