# SPDX-License-Identifier: Apache-2.0
"""Rules by themselves, and that a plan never costs more than what a rule would do."""

from __future__ import annotations

from functools import partial

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.costs.control_effort import ControlEffort
from herding_ros.control.drift import Drift
from herding_ros.control.errands import Errands
from herding_ros.control.objective import Objective
from herding_ros.control.parameters import Control, Horizon, Mapping
from herding_ros.control.reach import Reach
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.rules.collect_and_drive import CollectAndDrive
from herding_ros.control.rules.surround import Surround
from herding_ros.control.rules.target_selection import TargetSelection
from herding_ros.control.solution import Status
from herding_ros.control.task import RULES, Task
from herding_ros.model.crowd import Crowd
from herding_ros.model.flock import centre
from herding_ros.model.state import HerdState
import numpy as np
import pytest

GOAL = np.array([1.0, 0.0])
CONTROL = Control(horizon=Horizon(length=8.0, accepted=4.0), mapping=Mapping(max_iterations=0))
REACH = Reach.of(Crowd(), CONTROL.max_speed)
assert REACH is not None


def herd(seed: int, sheep: int = 9, dogs: int = 3, away: float = 1.0) -> HerdState:
    rng = np.random.default_rng(seed)
    x = rng.normal(0.0, 0.3, (sheep, 2))
    x[0] *= 4.0
    return HerdState(x, np.zeros_like(x), away * rng.normal(0.0, 1.0, (dogs, 2)))


@pytest.mark.parametrize('seed', range(6))
def test_no_rule_costs_less_than_the_plan(seed: int) -> None:
    """Judged on the finest time grid of the window, and on the control's own of a feedback."""
    state, drift = herd(seed), Drift()
    planner = RecedingHorizon(Crowd(), CONTROL, GOAL)
    for look in (partial(planner.solve, state, 0.0), partial(planner.improve, herd(99), 1.0)):
        rule = next(iter(RULES))
        planner._turns = iter([rule])
        window = look()
        state = look.args[0]
        coarse = planner.coarse_model(state)
        model = coarse.on_grid(coarse.substeps if window.report.kind == 'window' else 1)
        times = model.dt * np.arange(len(window.centre))
        task = Task.of(CONTROL, coarse, GOAL)
        costs = task.costs(times, drift.path(Crowd(), times))
        objective = Objective([*costs, ControlEffort(CONTROL.weights.control)])
        names = RULES if window.report.kind == 'window' else [rule]
        plans = task.rule_plans(coarse.on_grid(1), list(names))
        assert set(plans) == set(names)
        found = model.value_and_gradient(objective, window.plan.u)[0]
        assert window.report.objective == pytest.approx(found, rel=1e-12)
        for u in plans.values():
            assert found <= model.value_and_gradient(objective, u)[0]
        error = centre(herd(99).x) - window.centre[window.index(1.0)]
        drift.learn(Crowd(), error, 1.0, CONTROL.horizon.accepted, CONTROL.max_speed)


@pytest.mark.parametrize('rule', RULES.values(), ids=RULES)
def test_rules_turn_with_the_world(rule: CollectAndDrive) -> None:
    state, angle = herd(1), 0.8
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = HerdState(state.x @ turn.T, state.v, state.d @ turn.T)
    posts, again = (
        rule.posts(each, Errands.of(REACH, each, goal), goal)
        for each, goal in ((state, GOAL), (turned, turn @ GOAL))
    )
    np.testing.assert_allclose(again, posts @ turn.T, atol=1e-9)


def test_target_selection_is_the_published_choice() -> None:
    x = np.array([[5.0, 0.0], [6.0, 0.5], [-5.0, 0.0], [-4.0, 1.0]])
    state = HerdState(x, np.zeros_like(x), np.array([[5.0, 1.0], [-5.0, 1.0], [0.0, 90.0]]))
    goal = np.zeros(2)
    posts = TargetSelection().posts(state, Errands.of(REACH, state, goal), goal)
    for post, target in zip(posts, (1, 2), strict=False):
        expected = x[target] * (1.0 + REACH.standoff / np.linalg.norm(x[target]))
        np.testing.assert_allclose(post, expected)
    np.testing.assert_array_equal(posts[2], state.d[2])  # nearest to no sheep


def test_surround_has_dogs_at_equal_angles_around_all_sheep() -> None:
    state = herd(2, dogs=4)
    posts = Surround().posts(state, Errands.of(REACH, state, GOAL), GOAL)
    off = posts - state.x.mean(axis=0)
    radius = np.linalg.norm(off, axis=1)
    assert np.ptp(radius) < 1e-12
    assert radius[0] > np.linalg.norm(state.x - state.x.mean(axis=0), axis=1).max()
    angles = np.sort(np.arctan2(off[:, 1], off[:, 0]))
    np.testing.assert_allclose(np.diff(angles), 0.5 * np.pi)


def test_dogs_that_cannot_influence_the_flock_say_so_and_go_there() -> None:
    state = herd(3, away=1e3)
    planner = RecedingHorizon(Crowd(), CONTROL, GOAL)
    window = planner.solve(state, 0.0)
    assert window.report.status is Status.NO_INFLUENCE
    heading = window.plan.u[0] / np.linalg.norm(window.plan.u[0], axis=1, keepdims=True)
    to_flock = -state.d / np.linalg.norm(state.d, axis=1, keepdims=True)
    assert (np.sum(heading * to_flock, axis=1) > 0.9).all()
    assert np.linalg.norm(window.plan.u, axis=2).min() > 0.9 * CONTROL.max_speed


def test_near_dogs_have_influence_and_dogs_at_home_need_none() -> None:
    near = RecedingHorizon(Crowd(), CONTROL, GOAL).solve(herd(3), 0.0)
    assert near.report.status is not Status.NO_INFLUENCE
    state = herd(3, away=1e3)
    home = RecedingHorizon(Crowd(), CONTROL, state.x.mean(axis=0)).solve(state, 0.0)
    assert home.report.status is not Status.NO_INFLUENCE


def test_a_model_that_is_not_touched_by_a_rule_is_as_it_was() -> None:
    state = herd(4)
    model = CoarseModel(Crowd(), state, 0.1)
    before = state.x.copy()
    assert Task.of(CONTROL, model, GOAL).rule_plans(model, list(RULES))
    np.testing.assert_array_equal(model.state.x, before)
