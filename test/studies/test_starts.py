# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from herding_ros.model.flock import centre
from herding_ros.model.scenario import initial_herd
from herding_ros.model.state import HerdState
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.experiments.starts import arranged
import numpy as np
import pytest

GOAL = np.array([0.6, 0.8])
HERD = initial_herd(20, 3, GOAL, np.random.default_rng(4))
MIDDLE = centre(HERD.x)


def along(points: np.ndarray) -> np.ndarray:
    """How far points (n, 2) are from the flock's centre towards the goal, and to the left."""
    return (points - MIDDLE) @ np.array([[0.6, -0.8], [0.8, 0.6]])


def start(name: str) -> HerdState:
    herd = arranged(name, HERD, GOAL)
    np.testing.assert_array_equal(herd.v, HERD.v)
    return herd


def test_usual_start_is_that_of_the_scenario() -> None:
    assert start('usual') is HERD


def test_strays_are_beside_and_behind_the_flock() -> None:
    herd = start('strays')
    np.testing.assert_allclose(along(herd.x[:2]), [[0.0, 1.2], [-1.2, 0.0]], atol=1e-12)
    np.testing.assert_array_equal(herd.x[2:], HERD.x[2:])
    np.testing.assert_array_equal(herd.d, HERD.d)


def test_dogs_start_inside_or_in_front() -> None:
    inside, front = start('dogs inside'), start('dogs in front')
    np.testing.assert_array_equal(inside.x, HERD.x)
    np.testing.assert_allclose(np.linalg.norm(along(inside.d), axis=1), 0.15, rtol=1e-12)
    np.testing.assert_allclose(centre(inside.d), MIDDLE, atol=1e-12)
    np.testing.assert_array_equal(front.x, HERD.x)
    assert (along(front.d)[:, 0] > 0.4).all()
    np.testing.assert_allclose(np.linalg.norm(front.d, axis=1), 0.9, rtol=1e-12)


def test_clusters_are_on_either_side() -> None:
    moved = along(start('two clusters').x) - along(HERD.x)
    np.testing.assert_allclose(moved, np.tile([[0.0, -0.8], [0.0, 0.8]], (10, 1)), atol=1e-12)


def test_unknown_start_is_refused() -> None:
    with pytest.raises(ValueError, match=r"must be one of usual, strays, .*, got 'scattered'"):
        arranged('scattered', HERD, GOAL)


def test_arrival_from_any_start_is_judged_by_the_usual_spread() -> None:
    """Two clusters with their common centre at the goal are not together, though they start so."""
    flock = initial_herd(20, 2, GOAL, np.random.default_rng(1)).x
    arrived = [
        EXPERIMENTS['herding'](
            'none', settings={}, sheep=20, dogs=2, sigma=0.0, goal=centre(flock).tolist(), seed=1,
            time_limit=0.1, start=start,
        )['arrived']
        for start in ('usual', 'two clusters')
    ]  # fmt: skip
    assert arrived == [True, False]
