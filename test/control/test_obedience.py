# SPDX-License-Identifier: Apache-2.0
"""A dog that does not do as it is told is recognised, and no other."""

from collections.abc import Callable

from herding_ros.control.obedience import Obedience
from herding_ros.control.parameters import Control
from herding_ros.model.motion import Accelerating, Holonomic, MotionModel, Unicycle
from herding_ros.model.state import Array
import numpy as np
import pytest

PERIOD, NOISE, SPEED = 0.1, 0.01, 0.05
MOTIONS = [Holonomic(), Accelerating(acceleration=0.02), Unicycle()]


def course(motion: MotionModel, seconds: float, seed: int) -> tuple[Array, Array]:
    """States (T+1, 3, S) of dogs and their commands, smooth and mostly fast, (T, 3, 2)."""
    rng, steps = np.random.default_rng(seed), round(seconds / PERIOD)
    corners = rng.normal(0.0, 0.06, (steps // 20 + 2, 3, 2))
    share = np.arange(steps)[:, None, None] / 20.0
    k = share.astype(int)[:, 0, 0]
    u = corners[k] + (share - np.floor(share)) * (corners[k + 1] - corners[k])
    u = motion.project(u, SPEED)
    place = rng.normal(size=(3, 2)), rng.uniform(-3.0, 3.0, 3), np.zeros((3, 2))
    return motion.rollout(motion.state(*place), u, PERIOD, 1).swapaxes(1, 2), u


def watched(motion: MotionModel, d: Array, u: Array, noise: float = NOISE) -> list[set[int]]:
    """Return who does not do as told, after each observation of the dogs."""
    rng, obedience, control = np.random.default_rng(9), Obedience(3), Control(motion=motion)
    found = []
    for k in range(len(d)):
        seen = d[k].copy()
        seen[:, :2] += noise * rng.normal(size=(3, 2))
        obedience.observe(PERIOD * k, seen, (0, 1, 2), u[max(k - 1, 0)], control)
        found.append(set(obedience.disobedient))
    return found


@pytest.mark.parametrize('motion', MOTIONS, ids=lambda each: type(each).__name__)
@pytest.mark.parametrize('noise', [0.0, NOISE])
def test_dogs_that_do_as_told_are_trusted(motion: MotionModel, noise: float) -> None:
    """While they run, and while they stand."""
    d, u = course(motion, 100.0, 0)
    assert not any(watched(motion, d, u, noise))
    stand = motion.rollout(d[-1], np.zeros_like(u), PERIOD, 1).swapaxes(1, 2)
    assert not any(watched(motion, stand, np.zeros_like(u), noise))


def stuck(d: Array) -> None:
    d[:] = d[0]


def running_off(d: Array) -> None:
    d[:, :2] = 2.0 * d[0, :2] - d[:, :2]


@pytest.mark.parametrize('motion', MOTIONS, ids=lambda each: type(each).__name__)
@pytest.mark.parametrize('fault', [stuck, running_off])
@pytest.mark.parametrize('seed', range(2))
def test_one_that_does_not_is_recognised_within_two_seconds(
    motion: MotionModel, fault: Callable[[Array], None], seed: int
) -> None:
    d, u = course(motion, 40.0, seed)
    far = np.linalg.norm(d[20:, 1, :2] - d[:-20, 1, :2], axis=1)
    # From when on it ought to run for two seconds, nearly as fast as it can.
    first = next(k for k in range(50, 380) if far[k] > 0.75 * SPEED * 2.0)
    fault(d[first:, 1])
    found = watched(motion, d, u)
    assert not any(found[:first])
    assert found[first + 20] == {1}
    assert set().union(*found) == {1}


def test_odometry_that_is_frozen_is_recognised_too() -> None:
    obedience, control = Obedience(1), Control()
    u = np.array([[0.03, 0.0]])
    for k in range(60):
        d = np.array([[0.003 * min(k, 30), 0.0]])
        obedience.observe(PERIOD * k, d, (0,), u, control)
        assert k > 31 or not obedience.disobedient
    assert 3.1 < obedience.disobedient[0] < 4.5


def test_it_is_trusted_again_once_it_does_as_told() -> None:
    d, u = course(Holonomic(), 60.0, 4)
    d[200:, 1] = d[200, 1]
    d[400:, 1] += np.cumsum(PERIOD * u[399:, 1], axis=0)  # as it is told, from where it stands
    found = watched(Holonomic(), d, u)
    assert found[399] == {1}
    assert found[450] == set()


def test_a_dog_that_is_not_seen_is_not_judged() -> None:
    obedience, control = Obedience(2), Control()
    u = np.full((2, 2), 0.03)
    for k in range(100):
        dogs = (0, 1) if k % 10 else (0,)
        d = np.array([[0.003 * k, 0.003 * k], [5.0, 5.0]])[list(dogs)]
        obedience.observe(PERIOD * k, d, dogs, u, control)
    assert not obedience.disobedient


def test_without_a_timeout_nobody_is_watched() -> None:
    obedience = Obedience(1)
    for k in range(100):
        u = np.full((1, 2), 0.03)
        obedience.observe(PERIOD * k, np.zeros((1, 2)), (0,), u, Control(dog_timeout=0.0))
    assert not obedience.disobedient
