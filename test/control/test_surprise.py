# SPDX-License-Identifier: Apache-2.0
"""What surprises a pilot, judged by flocks under noise and by the covariance of free sheep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from herding_ros.control.parameters import Control, Horizon, Mapping, Sensor
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.surprise import displacement_variance, surprise
from herding_ros.control.window import Window
from herding_ros.model.alignment import Alignment
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import centre, spread
from herding_ros.model.noise import increments
from herding_ros.model.scenario import initial_herd
from herding_ros.model.state import HerdState
import numpy as np
import pytest

GOAL = np.array([1.0, 1.0])
CONTROL = Control(mapping=Mapping(max_iterations=0))


def planned(crowd: Crowd, sheep: int, t: float = 0.0) -> tuple[HerdState, Window]:
    state = initial_herd(sheep, 3, GOAL, np.random.default_rng(5))
    return state, RecedingHorizon(crowd, CONTROL, GOAL).solve(state, t)


@pytest.mark.parametrize('friction', [0.0, 1e-4, 0.5, 3.0])
@pytest.mark.parametrize('elapsed', [0.0, 0.01, 1.0, 10.0])
def test_variance_is_that_of_a_velocity_with_friction_and_random_force(
    friction: float, elapsed: float
) -> None:
    """Against the covariance of place and velocity, P' = A P + P A^T + Q, in small steps."""
    steps = 4000
    dt = elapsed / steps
    a = np.eye(2) + dt * np.array([[0.0, 1.0], [0.0, -friction]])
    covariance = np.zeros((2, 2))
    for _ in range(steps):
        covariance = a @ covariance @ a.T + np.diag([0.0, dt])
    expected = covariance[0, 0]
    found = displacement_variance(Crowd(friction=friction), elapsed)
    assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize('elapsed', [0.1, 1.0, 5.0])
@pytest.mark.parametrize('sheep', [3, 20])
@pytest.mark.parametrize(
    ('crowd', 'sensor'),
    [
        (Crowd(noise=0.03), Sensor()),
        (Crowd(noise=0.03, common_noise=0.5), Sensor()),
        (Crowd(noise=0.03, order=1), Sensor()),
        (Crowd(noise=0.03, alignment=Alignment(5.0, 1.0)), Sensor()),
        (Crowd(noise=0.01), Sensor(0.05, 0.05)),
    ],
)
def test_noise_alone_does_not_surprise(
    crowd: Crowd, sensor: Sensor, sheep: int, elapsed: float
) -> None:
    """Nor do the errors of sensors, of which the plan that is judged knew none."""
    state, window = planned(crowd, sheep)
    rng = np.random.default_rng(1)
    periods = round(elapsed / 0.1)
    dogs = window.plan.u[:periods]
    x, v = (rng.normal(0.0, deviation, (100, *state.x.shape)) for deviation in
            (sensor.position_noise, sensor.velocity_noise))  # fmt: skip
    surprises = 0
    for k in range(100):
        start = replace(state, x=state.x + x[k], v=state.v + v[k]) if sensor != Sensor() else state
        noise = increments(rng, crowd, sheep, 0.05, 2 * periods)
        end = rollout(crowd, start, dogs, 0.05, 2, noise).at(-1)
        seen = replace(end, x=end.x + rng.normal(0.0, sensor.position_noise, end.x.shape))
        control = replace(CONTROL, sensor=sensor)
        surprises += surprise(crowd, control, window, elapsed, seen, elapsed) is not None
    assert surprises <= 2


def gust(state: HerdState) -> HerdState:
    return replace(state, x=state.x + np.array([0.0, 0.3]))


def runaway(state: HerdState) -> HerdState:
    """A sheep off to one side, and the others so far to the other that the centre stays."""
    x = state.x.copy()
    x[0, 0] += 0.8
    return replace(state, x=x - [0.8 / len(x), 0.0])


def at_one_place(state: HerdState) -> HerdState:
    return replace(state, x=0.2 * state.x + 0.8 * state.x.mean(axis=0))


@pytest.mark.parametrize('change', [gust, runaway, at_one_place])
@pytest.mark.parametrize('t', [0.0, 1.7e9])
def test_what_noise_does_not_explain_surprises(
    change: Callable[[HerdState], HerdState], t: float
) -> None:
    crowd = Crowd(noise=0.02)
    state, window = planned(crowd, 20, t)
    then = rollout(crowd, state, window.plan.u[:10], 0.05, 2).at(-1)
    assert surprise(crowd, CONTROL, window, 1.0, then, t + 1.0) is None
    off = surprise(crowd, CONTROL, window, 1.0, change(then), t + 1.0)
    assert off is not None
    expected = (np.linalg.norm(centre(change(then).x) - centre(then.x)),
                abs(spread(change(then).x) - spread(then.x)))  # fmt: skip
    assert (off.centre, off.spread) == pytest.approx(expected, abs=0.02)


def test_a_stronger_noise_and_a_longer_time_explain_more() -> None:
    """A centre that is 6 cm off surprises after a second; after a minute of noise it does not."""
    state, window = planned(Crowd(), 20)
    off = replace(state, x=state.x + np.array([0.06, 0.0]))

    def surprises(noise: float, elapsed: float) -> bool:
        crowd = Crowd(noise=noise)
        return surprise(crowd, CONTROL, window, elapsed, off, 0.0) is not None

    assert [surprises(0.02, elapsed) for elapsed in (0.1, 1.0, 60.0)] == [True, True, False]
    assert surprises(0.0, 60.0)
    assert not surprises(0.3, 1.0)


def test_an_error_that_dogs_run_in_no_time_is_no_surprise() -> None:
    """So a model that is a little wrong surprises no one, in metres or in millimetres."""
    state, window = planned(Crowd(noise=0.0), 20)
    off = replace(state, x=state.x + np.array([0.01, 0.0]))

    def surprises(max_speed: float, feedback: float = 1.0) -> bool:
        control = replace(CONTROL, max_speed=max_speed, horizon=Horizon(feedback=feedback))
        return surprise(Crowd(noise=0.0), control, window, 0.1, off, 0.0) is not None

    assert [surprises(speed) for speed in (0.02, 0.03, 0.05)] == [True, False, False]
    assert surprises(0.05, feedback=0.4)
