# SPDX-License-Identifier: Apache-2.0
"""What a controller learns of a plant that moves the flock otherwise than its model."""

from __future__ import annotations

from dataclasses import replace

from herding_ros.control.closed_loop import steer
from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.drift import displacement, Drift
from herding_ros.control.parameters import Control, Horizon, Mapping
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.flock import centre
from herding_ros.model.parameters import TINY
from herding_ros.model.scenario import initial_herd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

GOAL = np.array([0.5, 0.5])
CONTROL = Control(horizon=Horizon(length=10.0, accepted=5.0), mapping=Mapping(max_iterations=0))


@pytest.mark.parametrize('friction', [0.0, 1e-5, 0.5, 3.0])
def test_displacement_is_that_of_a_velocity_with_friction(friction: float) -> None:
    """Against v' = 1 - alpha v, x' = v in small steps."""
    times, dt = np.linspace(0.0, 20.0, 40001), 5e-4
    v = np.zeros(len(times))
    for k in range(len(times) - 1):
        v[k + 1] = v[k] + dt * (1.0 - friction * v[k])
    x = dt * np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]))])
    found = displacement(Crowd(friction=friction), times)
    np.testing.assert_allclose(found, x, rtol=1e-3, atol=1e-6)


def test_without_inertia_it_is_proportional_to_time() -> None:
    found = displacement(Crowd(friction=0.5, order=1), np.array([0.0, 3.0]))
    np.testing.assert_array_equal(found, [0.0, 6.0])


def test_a_constant_acceleration_is_found() -> None:
    """Predictions that know the estimate so far are off by what is missing of it."""
    crowd, truth, drift = Crowd(), np.array([0.004, -0.003]), Drift()
    for _ in range(60):
        missing = truth - drift.acceleration
        drift.learn(crowd, missing * displacement(crowd, np.array([1.0])), 1.0, 10.0, 0.05)
    np.testing.assert_allclose(drift.acceleration, truth, rtol=3e-3)
    path = drift.path(crowd, np.array([0.0, 100.0, 101.0]))
    np.testing.assert_array_equal(path[0], 0.0)
    np.testing.assert_allclose(path[2] - path[1], truth / 0.5, rtol=3e-3)


def test_a_gust_is_no_drift() -> None:
    drift = Drift()
    drift.learn(Crowd(), np.array([0.3, 0.4]), 1.0, 10.0, 0.05)
    np.testing.assert_array_equal(drift.acceleration, 0.0)
    drift.learn(Crowd(), np.array([0.003, 0.004]), 1.0, 10.0, 0.05)
    assert (drift.acceleration > 0.0).all()


class Windy(Simulation):
    """Our own world, with a wind that accelerates all sheep and that nobody states."""

    wind = np.array([0.004, -0.004])

    def _moved(self, u: Array, noise: Array) -> HerdState:
        state = super()._moved(u, noise)
        return replace(state, v=state.v + self.control_period * self.wind)


def test_a_flock_in_the_wind_is_held_at_the_goal() -> None:
    """Dogs that did not learn of the wind would hold it 0.03 m off."""
    never = replace(World().arrival, radius=TINY)
    exact = {'position_noise': 0.0, 'velocity_noise': 0.0}
    plant = Windy(Crowd(noise=0.0), World(6, 4, seed=3, arrival=never, **exact), GOAL)
    planner = RecedingHorizon(Crowd(noise=0.0), CONTROL, GOAL)
    run = steer(plant, planner, 60.0)
    off = np.linalg.norm(centre(run.x) - GOAL, axis=1)
    assert off[-200:].mean() < 0.01


def test_sheep_that_are_not_seen_any_more_are_no_drift() -> None:
    """Their centre jumps; what is expected of them is the model's alone."""
    state = initial_herd(6, 3, GOAL, np.random.default_rng(2))
    planner = RecedingHorizon(Crowd(), CONTROL, GOAL)
    planner.solve(state, 0.0)
    fewer = HerdState(state.x[1:], state.v[1:], state.d)
    found = planner.improve(fewer, 1.0)
    predicted = CoarseModel(Crowd(), fewer, 0.1).rollout(found.plan.u)
    np.testing.assert_array_equal(found.centre, centre(predicted.x))
