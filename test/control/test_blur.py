# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

from herding_ros.control.blur import blurred
from herding_ros.control.parameters import Control
from herding_ros.control.reach import Reach
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.potentials import Harmonic, Morse
from herding_ros.model.state import HerdState
import numpy as np
import pytest

TARGETS = Crowd(sheep=Harmonic(0.0, 1.0), dog=Harmonic(3.0, 2.5), friction=2.0, order=1, noise=1.5)


def test_force_is_that_on_average_of_a_sheep_that_diffuses() -> None:
    """By the paths of many sheep near one dog that do not feel it meanwhile."""
    time, d = 0.3, np.array([0.7, 0.4])
    steps = np.random.default_rng(0).standard_normal((20_000, 30, 2)) * np.sqrt(time / 30)
    apart = d + TARGETS.noise / TARGETS.friction * steps.sum(axis=1)
    r = np.linalg.norm(apart, axis=1, keepdims=True)
    forces = -TARGETS.dog.derivative(r) * apart / r
    error = forces.std(axis=0) / np.sqrt(len(forces))
    at = np.linalg.norm(d)
    expected = -blurred(TARGETS, time, 7.5).dog.derivative(np.array([at]))[0] * d / at
    assert (np.abs(forces.mean(axis=0) - expected) < 4.0 * error).all()
    plain = -TARGETS.dog.derivative(np.array([at]))[0] * d / at
    assert (np.abs(forces.mean(axis=0) - plain) > 20.0 * error).any()


def test_dogs_keep_their_distance_from_sheep_that_diffuse() -> None:
    standoffs = [Reach.of(blurred(TARGETS, time, 7.5), 7.5).standoff for time in (0.0, 0.3, 1.0)]
    assert standoffs == sorted(set(standoffs))


@pytest.mark.parametrize(
    'crowd',
    [
        Crowd(),
        Crowd(noise=0.03),
        replace(TARGETS, noise=0.0),
        replace(TARGETS, dog=Morse(0.0, 1.0, 0.0, 1.0)),
    ],
)
def test_nothing_changes_where_noise_moves_sheep_little_or_none_notices_a_dog(
    crowd: Crowd,
) -> None:
    assert blurred(crowd, 1.0, 7.5) is crowd


def test_without_feedback_plans_are_those_of_the_paper() -> None:
    state = HerdState(np.eye(2), np.zeros((2, 2)), 3.0 * np.ones((1, 2)))
    for feedback, same in ((1.0, False), (10.0, True)):
        control = Control().with_values({'horizon.feedback': feedback, 'max_speed': 7.5})
        planner = RecedingHorizon(TARGETS, control, np.zeros(2))
        assert (planner.coarse_model(state).crowd == TARGETS) is same
