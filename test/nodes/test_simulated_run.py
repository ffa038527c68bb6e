# SPDX-License-Identifier: Apache-2.0
"""A run of the sim, without processes."""

from __future__ import annotations

import dataclasses

from herding_ros.model.crowd import Crowd
from herding_ros.model.potentials import Morse
from herding_ros.model.simulation import World
from herding_ros.nodes.simulated_run import SimulatedRun
import numpy as np
import pytest

WORLD = World(sheep=3, dogs=2, seed=5)
GOAL = np.array([0.5, 0.5])
STAND = np.zeros((2, 2))


def make(stop_on_arrival: bool = False, time_limit: float = 0.0) -> SimulatedRun:
    return SimulatedRun(Crowd(), WORLD, GOAL, stop_on_arrival, time_limit)


def test_restart_is_the_first_start_though_the_goal_was_moved() -> None:
    run = make()
    first = run.simulation.state
    run.move_goal(-GOAL)
    run.advance(np.full((2, 2), 0.02))
    later = run.simulation.state
    run.restart()
    assert run.now == 0
    for field in dataclasses.fields(first):
        now, then = (getattr(state, field.name) for state in (run.simulation.state, first))
        np.testing.assert_array_equal(now, then)
    np.testing.assert_array_equal(run.goal, -GOAL)
    np.testing.assert_array_equal(run.simulation.goal, -GOAL)
    run.advance(np.full((2, 2), 0.02))
    np.testing.assert_array_equal(run.simulation.state.x, later.x)


def test_a_changed_crowd_survives_a_restart() -> None:
    run = make()
    run.change_crowd(Crowd(noise=0.2))
    run.restart()
    assert run.simulation.crowd == Crowd(noise=0.2)


def test_a_finished_run_goes_on_when_the_goal_is_moved() -> None:
    run = make(time_limit=0.2)
    run.advance(STAND)
    assert not run.stands
    run.advance(STAND)
    assert run.stands
    assert run.outcome == 'the flock did not arrive within 0.2 s'
    run.move_goal(np.zeros(2))
    assert not run.stands
    run.paused = True
    assert run.stands


class Broken:
    """A random force that cannot be computed."""

    def __call__(self, t: float, x: np.ndarray) -> float:
        raise ZeroDivisionError('of the user')


@pytest.mark.parametrize(
    'crowd', [Crowd(friction=1e6), Crowd(noise_field=Broken()), Crowd(Morse(1e6, 1e-9))]
)
def test_a_herd_that_cannot_move_stands_until_it_can(crowd: Crowd) -> None:
    run = make()
    run.change_crowd(crowd)
    for _ in range(100):
        before = run.simulation.state
        run.advance(STAND)
        if run.failed:
            break
    else:
        assert np.isfinite(run.simulation.state.x).all()
        return
    assert run.stands
    assert 'a step could not be taken' in run.outcome
    assert run.simulation.state is before
    now = run.now
    run.change_crowd(Crowd())
    assert not run.stands
    run.restart()
    run.advance(STAND)
    assert run.now > 0 <= now


@pytest.mark.parametrize('stops', [True, False])
def test_it_finishes_at_home_if_it_shall(stops: bool) -> None:
    run = make(stop_on_arrival=stops)
    run.move_goal(run.simulation.state.x.mean(axis=0))
    run.advance(STAND)
    assert run.finished == stops
