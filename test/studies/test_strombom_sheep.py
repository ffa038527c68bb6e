# SPDX-License-Identifier: Apache-2.0
"""Sheep move by the published rules, and the published heuristic herds them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from herding_ros.control.closed_loop import play
from herding_ros.model.state import Array, HerdState
from herding_ros.studies.experiments.strombom import Strombom
from herding_ros.studies.experiments.strombom_sheep import Flock, MAX_SPEED, Sheep, steps
import numpy as np
import pytest

KIND = Sheep()


def step(x: list[list[float]], v: Array, d: list[list[float]], random: Array) -> Array:
    state = HerdState(np.array(x), v, np.array(d))
    return steps(KIND, state, random, np.zeros(len(x), dtype=bool))


def test_a_heading_is_the_sum_of_the_published_terms() -> None:
    """Two sheep a metre apart, one dog: all directions are known."""
    v = np.array([[0.0, 0.7], [0.0, 0.0]])
    random = np.array([[1.0, 0.0], [0.0, -1.0]])
    found = step([[0.0, 0.0], [1.0, 0.0]], v, [[0.0, -5.0]], random)
    first = np.array([1.05 - 2.0 + 0.3, 0.5 + 1.0])  # together, apart and at random; on and away
    away = np.array([1.0, 5.0]) / np.hypot(1.0, 5.0)
    second = np.array([-1.05 + 2.0, 0.0]) + away + [0.0, -0.3]
    expected = [each / np.linalg.norm(each) for each in (first, second)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(('gap', 'sign'), [(1.99, -1.0), (2.01, 1.0)])
def test_sheep_nearer_than_r_a_part_and_others_meet(gap: float, sign: float) -> None:
    kind = replace(KIND, noise=0.0, fear=0.0)
    state = HerdState(np.array([[0.0, 0.0], [gap, 0.0]]), np.zeros((2, 2)), np.zeros((1, 2)))
    found = steps(kind, state, np.zeros((2, 2)), np.zeros(2, dtype=bool))
    np.testing.assert_allclose(found, [[sign, 0.0], [-sign, 0.0]], rtol=0, atol=1e-14)


def test_a_sheep_that_sees_no_dog_grazes() -> None:
    """Every twentieth takes a random step; the others stay."""
    flock = Flock(0, sheep=25)
    flock.state = replace(flock.state, d=np.array([[-1e3, 0.0]]))
    xs = [flock.state.x]
    for _ in range(200):
        flock.advance(np.zeros((1, 2)))
        xs.append(flock.state.x)
    moved = np.array([np.linalg.norm(b - a, axis=1) for a, b in pairwise(xs)])
    assert set(np.round(moved.ravel(), 9)) == {0.0, 1.0}
    assert (moved > 0.5).mean() == pytest.approx(0.05, abs=4.0 * np.sqrt(0.05 * 0.95 / 5000))


@pytest.mark.parametrize(('gap', 'flees'), [(64.9, True), (65.1, False)])
def test_a_dog_is_noticed_within_65_m(gap: float, flees: bool) -> None:
    found = step([[0.0, 0.0]], np.zeros((1, 2)), [[-gap, 0.0]], np.zeros((1, 2)))
    np.testing.assert_allclose(found, [[float(flees), 0.0]], rtol=0, atol=1e-14)


def test_they_start_in_the_far_quarter_and_arrive_all_within_f_of_n() -> None:
    flock = Flock(0)
    assert ((flock.state.x >= 75.0) & (flock.state.x <= 150.0)).all()
    limit = 2.0 * 25.0 ** (2.0 / 3.0)
    x = np.tile([limit - 0.01, 0.0], (25, 1))
    flock.state = replace(flock.state, x=x)
    assert flock.arrived
    x[3] = [0.0, limit + 0.01]
    flock.state = replace(flock.state, x=x)
    assert not flock.arrived


@pytest.mark.parametrize(
    'seeds', [[3], pytest.param(range(5), marks=pytest.mark.statistics)], ids=['one', 'five']
)
def test_the_heuristic_brings_them_home_within_700_steps(seeds: range) -> None:
    for seed in seeds:
        policy = Strombom(np.zeros(2), np.random.default_rng(seed), MAX_SPEED, 2.0)
        run = play(Flock(seed), policy, 700.0)
        assert run.arrived
        assert np.linalg.norm(run.u, axis=-1).max() <= MAX_SPEED + 1e-12
