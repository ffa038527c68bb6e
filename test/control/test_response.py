# SPDX-License-Identifier: Apache-2.0
"""What a controller learns of sheep that make more or less of dogs than its model."""

from __future__ import annotations

from dataclasses import replace

from herding_ros.control.closed_loop import steer
from herding_ros.control.parameters import Control, Sensor
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.response import Response
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import Allowance, flock
from herding_ros.model.noise import increments
from herding_ros.model.potentials import Morse
from herding_ros.model.simulation import World
from herding_ros.model.state import Array, HerdState
from herding_ros.studies.experiments.truths import OtherWorld, Truth
import numpy as np

CONTROL = Control(sensor=Sensor(position_noise=0.0, velocity_noise=0.0))
PERIOD, STEPS = CONTROL.horizon.control_period, 10
ALONE = Crowd(sheep=Morse(0.0, 1e-2, 0.0, 2.0))
"""Sheep that do not notice each other."""


def feeling(strength: float) -> Crowd:
    """Return a crowd to which dogs are so many times as strong."""
    dog = ALONE.dog
    assert isinstance(dog, Morse)
    repulsion, attraction = strength * dog.repulsion, strength * dog.attraction
    return replace(ALONE, dog=replace(dog, repulsion=repulsion, attraction=attraction))


def learned(truth: Array, seed: int = 0, away: float = 0.0, seconds: int = 20) -> Response:
    """Return what is learned of sheep with these true responses (N,) and dogs so far away [m]."""
    rng = np.random.default_rng(seed)
    n, response = len(truth), Response()
    x = 0.2 * rng.standard_normal((n, 2))
    state = HerdState(x, np.zeros_like(x), away + np.array([[0.3, 0.1], [-0.3, 0.2]]))
    for second in range(seconds):
        response.learn(ALONE, CONTROL, state, float(second))
        u = rng.uniform(-0.03, 0.03, (1, 2, 2))
        noise = increments(rng, ALONE, n, PERIOD, STEPS)
        x, v = np.empty((n, 2)), np.empty((n, 2))
        for each in np.unique(truth):
            after = rollout(feeling(each), state, u, PERIOD, STEPS, noise).at(-1)
            x[truth == each], v[truth == each] = after.x[truth == each], after.v[truth == each]
        state = HerdState(x, v, after.d)
    response.learn(ALONE, CONTROL, state, float(seconds))
    return response


def test_responses_are_found_within_their_deviations() -> None:
    truth = np.repeat([0.0, 0.5, 1.0, 1.5], 5)
    off = []
    for seed in range(10):
        found = learned(truth, seed)
        assert np.median(found.deviation) < 0.5
        off.append((found.mean - truth) / found.deviation)
    # They also allow for what a model has wrong, of which there is nothing here.
    assert np.abs(np.mean(off)) < 0.2
    assert np.sqrt(np.square(off).mean()) < 1.0


def test_of_sheep_that_no_dog_has_come_near_nothing_is_learned() -> None:
    found = learned(np.array([0.0, 1.0]), away=50.0)
    np.testing.assert_allclose(found.mean, 1.0, atol=1e-6)
    np.testing.assert_allclose(found.deviation, 1.0, atol=1e-6)


def test_of_a_time_without_sight_of_them_nothing_is_learned() -> None:
    """To follow an hour by the model takes half a minute."""
    response, generator = Response(), np.random.default_rng(0)
    for t in (0.0, CONTROL.horizon.length + 1.0, 3600.0):
        x = 0.2 * generator.standard_normal((5, 2))
        response.learn(ALONE, CONTROL, HerdState(x, 0.0 * x, x[:2] + 0.1), t)
        np.testing.assert_array_equal(response.mean, 1.0)
        np.testing.assert_array_equal(response.deviation, 1.0)


def test_sheep_that_ignore_dogs_are_left_first_then_the_farthest() -> None:
    rng = np.random.default_rng(1)
    truth = np.ones(12)
    truth[[3, 8]] = 0.0
    found, x = learned(truth), rng.standard_normal((12, 2))
    assert set(np.flatnonzero(~found.herded(x, 2))) == {3, 8}
    rest = np.delete(np.arange(12), [3, 8])
    farthest = rest[~flock(x[rest], 2)]
    assert set(np.flatnonzero(~found.herded(x, 4))) == {3, 8, *farthest}
    assert np.count_nonzero(~found.herded(x, 1)) == 1
    assert found.herded(x, 0).all()


def test_where_all_make_little_of_dogs_none_ignores_them() -> None:
    x = np.random.default_rng(2).standard_normal((8, 2))
    np.testing.assert_array_equal(learned(np.full(8, 0.3)).herded(x, 3), flock(x, 3))


def test_of_another_flock_nothing_is_known() -> None:
    found = learned(np.zeros(5))
    x = np.random.default_rng(3).standard_normal((6, 2))
    np.testing.assert_array_equal(found.herded(x, 2), flock(x, 2))
    found.learn(ALONE, CONTROL, HerdState(x, np.zeros_like(x), np.zeros((2, 2))), 100.0)
    np.testing.assert_array_equal(found.mean, 1.0)


def test_a_controller_that_may_leave_sheep_leaves_those_that_ignore_dogs() -> None:
    crowd, goal = Crowd(), np.array([0.5, 0.5])
    world = OtherWorld(crowd, World(sheep=12, dogs=4, seed=5), goal, Truth(ignoring=0.25))
    control = Control(arrival=Allowance(strays=3)).with_values(
        {'mapping.max_iterations': 0, 'horizon.length': 10.0, 'horizon.accepted': 5.0}
    )
    planner = RecedingHorizon(crowd, control, goal)
    steer(world, planner, 40.0)
    window = planner.improve(world.observe().state, 40.0)
    np.testing.assert_array_equal(window.sheep, world.response > 0.0)
