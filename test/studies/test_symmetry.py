# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import distance
from herding_ros.model.scenario import GOAL
from herding_ros.model.state import HerdState
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.experiments.symmetry import MOTIONS, symmetric_herd, velocities
import numpy as np
import pytest


@pytest.mark.parametrize('motion', MOTIONS)
@pytest.mark.parametrize(('pairs', 'dog_pairs'), [(0, 1), (1, 1), (10, 3)])
def test_centre_stays_to_round_off(pairs: int, dog_pairs: int, motion: str) -> None:
    for seed in range(3):
        found = EXPERIMENTS['symmetry'](pairs, dog_pairs, motion, 20.0, 0.01, seed)
        assert found['drift'] <= 1e-12
        assert (found['moved'] > 0.05) == (pairs > 0)  # the flock itself does move


def test_an_asymmetric_herd_does_not_stay() -> None:
    state = symmetric_herd(10, 3, 0)
    moved = np.concatenate([state.x[:1] + 1e-3, state.x[1:]])
    state = HerdState(moved, state.v, state.d)
    u = velocities(state.d, 'stand', 20.0, 2000)
    run = rollout(Crowd(friction=0.0, noise=0.0), state, u, 0.01)
    assert distance(run.x, np.array(GOAL))[-1] > 1e-4


def test_herd_and_motion_fulfil_the_assumptions() -> None:
    state, goal = symmetric_herd(4, 2, 1), np.array(GOAL)
    for points in (state.x, state.d):
        half = len(points) // 2
        np.testing.assert_allclose(points[:half] - goal, goal - points[half:], atol=1e-15)
    assert not state.v.any()
    for motion in MOTIONS:
        u = velocities(state.d, motion, 5.0, 50)
        np.testing.assert_array_equal(u[:, :2], -u[:, 2:])
        assert u.any() == (motion != 'stand')
