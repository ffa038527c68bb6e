# SPDX-License-Identifier: Apache-2.0
"""Targets without cohesion move by the published equations, and the published rule herds them."""

from __future__ import annotations

from dataclasses import replace

from herding_ros.control.closed_loop import play
from herding_ros.model.state import HerdState
from herding_ros.studies.experiments.lama import drift, MAIN, Rule, Setting, SMALL, Targets
import numpy as np
import pytest

STILL = replace(SMALL, herders=1, targets=1, diffusion=0.0)


def herd(x: list[list[float]], d: list[list[float]]) -> HerdState:
    return HerdState(np.array(x), np.zeros((len(x), 2)), np.array(d))


def rule(**changes: float) -> Rule:
    return Rule(**{'radius': 5.0, 'max_speed': 1e6, 'selectivity': 1e3} | changes)


@pytest.mark.parametrize(('distance', 'speed'), [(1.0, 4.5), (2.4, 0.3), (2.5, 0.0), (9.0, 0.0)])
def test_a_target_flees_a_herder_as_from_a_spring_that_ends_at_its_reach(
    distance: float, speed: float
) -> None:
    x, d = np.array([[3.0, 4.0]]), np.array([[3.0, 4.0 - distance]])
    np.testing.assert_allclose(drift(x, d, 3.0, 2.5), [[0.0, speed]], rtol=0, atol=1e-12)


def test_pushes_of_herders_add_up_and_targets_do_not_notice_each_other() -> None:
    x = np.array([[0.0, 0.0], [0.1, 0.0]])
    d = np.array([[-2.0, 0.0], [0.0, -1.0], [0.0, 0.0]])
    r = np.array([1.0, np.hypot(0.1, 1.0), 0.1])
    expected = [3.0 * 0.5 + 3.0 * 0.0, 3.0 * 1.5]
    np.testing.assert_allclose(drift(x, d, 3.0, 2.5)[0], expected, rtol=0, atol=1e-12)
    other = 3.0 * np.array([0.4 + (2.5 - r[1]) * 0.1 / r[1] + 2.4, (2.5 - r[1]) / r[1]])
    np.testing.assert_allclose(drift(x, d, 3.0, 2.5)[1], other, rtol=0, atol=1e-12)


def test_a_control_period_is_so_many_steps_of_euler() -> None:
    plant = Targets(STILL, 0)
    plant.state = herd([[10.0, 0.0]], [[11.0, 0.0]])
    plant.advance(np.array([[-1.0, 0.0]]))
    x, d = 10.0, 11.0
    for _ in range(5):
        x, d = x - 0.01 * 3.0 * (2.5 - (d - x)), d - 0.01
    np.testing.assert_allclose(plant.state.x, [[x, 0.0]], rtol=1e-14)
    np.testing.assert_allclose(plant.state.d, [[d, 0.0]], rtol=1e-14)
    assert plant.control_period == pytest.approx(0.05)


def test_targets_diffuse_by_2_d_t_in_each_direction() -> None:
    plant = Targets(replace(MAIN, targets=4000, herders=1), 1)
    plant.state = replace(plant.state, d=np.array([[1e3, 0.0]]))
    start = plant.state.x
    for _ in range(10):
        plant.advance(np.zeros((1, 2)))
    moved = (plant.state.x - start).ravel()
    assert moved.var() == pytest.approx(2.0 * 1.0 * 0.5, rel=4.0 * np.sqrt(2.0 / len(moved)))
    assert abs(moved.mean()) < 4.0 / np.sqrt(len(moved))


def test_no_herder_is_faster_than_its_limit() -> None:
    plant = Targets(SMALL, 0)
    plant.advance(np.array([[30.0, 40.0], [3.0, 4.0]]))
    np.testing.assert_allclose(plant.dog_velocities, [[4.8, 6.4], [3.0, 4.0]], rtol=1e-14)


def test_all_start_uniformly_in_the_field() -> None:
    r = np.linalg.norm(Targets(replace(SMALL, targets=4000), 3).state.x, axis=1)
    assert r.max() <= 25.0
    assert (r <= 12.5).mean() == pytest.approx(0.25, abs=4.0 * np.sqrt(0.25 * 0.75 / 4000))


@pytest.mark.parametrize(('targets', 'out', 'gathered'), [(7, 0, 1), (7, 1, 0), (100, 1, 1)])
def test_gathered_is_99_percent_in_the_goal_region(targets: int, out: int, gathered: int) -> None:
    plant = Targets(replace(SMALL, targets=targets), 0)
    x = np.tile([4.9, 0.0], (targets, 1))
    x[:out] = [5.1, 0.0]
    plant.state = replace(plant.state, x=x)
    assert plant.arrived == bool(gathered)


def test_a_herder_runs_to_behind_its_farthest_target() -> None:
    u = rule()(herd([[12.0, 0.0], [0.0, 13.0]], [[8.0, 8.0]]), 0.0)
    np.testing.assert_allclose(u, [[5.0 * -8.0, 5.0 * (13.0 + 1.25 - 8.0)]], rtol=1e-12)


def test_a_finite_selectivity_weighs_targets_that_are_as_far() -> None:
    """Two targets 0.1 m apart in distance: weights 1 and e^-1 at gamma = 10."""
    u = rule(selectivity=10.0)(herd([[10.0, 0.0], [9.9, 0.0]], [[0.0, 0.0]]), 0.0)
    middle = (10.0 + 9.9 * np.exp(-1.0)) / (1.0 + np.exp(-1.0))
    np.testing.assert_allclose(u, [[5.0 * (middle + 1.25), 0.0]], rtol=1e-12)


def test_each_target_is_minded_by_the_nearest_herder_alone_and_an_idle_one_goes_home() -> None:
    state = herd([[12.0, 0.0], [20.0, 0.0]], [[13.0, 0.0], [0.0, 9.0], [0.0, 3.0]])
    u = rule(max_speed=7.5)(state, 0.0)
    np.testing.assert_allclose(u, [[7.5, 0.0], [0.0, -7.5], [0.0, 0.0]], rtol=0, atol=1e-12)


def test_a_target_beyond_the_sensing_radius_is_not_seen() -> None:
    state = herd([[12.0, 0.0], [30.0, 0.0]], [[13.0, 0.0]])
    u = rule(sensing=10.0)(state, 0.0)
    np.testing.assert_allclose(u, [[5.0 * 0.25, 0.0]], rtol=1e-12)


def test_same_seed_same_run() -> None:
    runs = [
        play(Targets(SMALL, seed), Rule(SMALL.radius, SMALL.max_speed), 1.0) for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(runs[0].x, runs[1].x)
    assert not np.array_equal(runs[0].x[0], runs[2].x[0])


@pytest.mark.parametrize(
    ('setting', 'seeds', 'gathered'),
    [
        (SMALL, [5], 1),
        pytest.param(SMALL, range(6), 6, marks=pytest.mark.statistics),
        pytest.param(MAIN, [0, 5], 2, marks=pytest.mark.statistics),
    ],
)
def test_the_rule_gathers_the_targets(setting: Setting, seeds: range, gathered: int) -> None:
    policy = Rule(setting.radius, setting.max_speed)
    runs = [play(Targets(setting, seed), policy, 100.0) for seed in seeds]
    assert sum(run.arrived for run in runs) == gathered
