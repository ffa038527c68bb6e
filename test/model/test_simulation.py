# SPDX-License-Identifier: Apache-2.0
import dataclasses
import re
from typing import Any

from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.dynamics import rollout
from herding_ros.model.field import Field
from herding_ros.model.flock import Arrival
from herding_ros.model.motion import MOTIONS, Unicycle
from herding_ros.model.potentials import Harmonic
from herding_ros.model.scenario import initial_herd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

GOAL = np.array([0.5, 0.5])
WORLD = World(sheep=9, dogs=2, seed=3)


def commands(periods: int) -> Array:
    return np.random.default_rng(0).uniform(-0.03, 0.03, (periods, 2, 2))


def played(simulation: Simulation, u: Array) -> Simulation:
    for each in u:
        simulation.advance(each)
    return simulation


def test_same_seed_same_world_bit_for_bit() -> None:
    one, same = (played(Simulation(Crowd(), WORLD, GOAL), commands(20)) for _ in range(2))
    np.testing.assert_array_equal(one.state.x, same.state.x)
    np.testing.assert_array_equal(one.observe().state.x, same.observe().state.x)
    other = played(Simulation(Crowd(), dataclasses.replace(WORLD, seed=4), GOAL), commands(20))
    assert (one.state.x != other.state.x).all()


@pytest.mark.parametrize('kind', sorted(MOTIONS))
def test_a_wall_that_nobody_reaches_changes_no_bit(kind: str) -> None:
    far = Field(fences=(((50.0, -1.0), (50.0, 1.0)),))
    ends = []
    for crowd in (Crowd(), far.around(Crowd())):
        sim = Simulation(crowd, World(sheep=6, dogs=2, seed=1, motion=MOTIONS[kind]), GOAL)
        for _ in range(30):
            sim.advance(np.array([[0.05, 0.0], [0.0, -0.03]]))
        ends.append(sim.state)
    for name in ('x', 'v', 'd'):
        np.testing.assert_array_equal(*(getattr(end, name) for end in ends))


def test_a_seed_is_one_noise_for_any_commands_dogs_and_strength() -> None:
    """Of sheep without forces, so that all that moves them is the noise."""
    alone, walks = Harmonic(0.0), []
    for noise, dogs, speed in ((0.01, 2, 0.0), (0.03, 5, 0.02)):
        crowd = Crowd(sheep=alone, dog=alone, noise=noise)
        sim = Simulation(crowd, dataclasses.replace(WORLD, dogs=dogs), GOAL)
        start = sim.state.x
        walks.append((start, (played(sim, np.full((20, dogs, 2), speed)).state.x - start) / noise))
    (start, walk), (other_start, other_walk) = walks
    np.testing.assert_array_equal(start, other_start)
    np.testing.assert_allclose(walk, other_walk, rtol=1e-9, atol=1e-12)
    assert np.abs(walk).max() > 0.0


def test_looking_at_the_herd_does_not_move_it() -> None:
    seen, unseen = Simulation(Crowd(), WORLD, GOAL), Simulation(Crowd(), WORLD, GOAL)
    for each in commands(10):
        seen.observe()
        seen.advance(each)
    np.testing.assert_array_equal(seen.state.x, played(unseen, commands(10)).state.x)


def test_without_noise_it_is_one_long_rollout() -> None:
    quiet, u = Crowd(noise=0.0), commands(15)
    found = played(Simulation(quiet, WORLD, GOAL), u)
    start = initial_herd(9, 2, GOAL, np.random.default_rng(3))
    expected = rollout(quiet, start, u, WORLD.dt, WORLD.substeps).at(-1)
    np.testing.assert_allclose(found.state.x, expected.x, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.state.d, expected.d, rtol=0, atol=1e-13)


def test_noise_moves_sheep_apart_from_the_coarse_model_but_no_dog() -> None:
    quiet, noisy = (
        played(Simulation(Crowd(noise=sigma), WORLD, GOAL), commands(15)).state
        for sigma in (0.0, 0.02)
    )
    np.testing.assert_array_equal(quiet.d, noisy.d)
    assert (quiet.x != noisy.x).all()


def test_nobody_runs_faster_than_the_limit() -> None:
    simulation = Simulation(Crowd(), WORLD, GOAL)
    start = simulation.state.d
    simulation.advance(np.array([[3.0, 4.0], [0.03, 0.04 - 1e-9]]))
    expected = np.array([[0.03, 0.04], [0.03, 0.04 - 1e-9]])
    np.testing.assert_allclose(simulation.dog_velocities, expected, rtol=1e-14)
    np.testing.assert_allclose(simulation.state.d - start, 0.1 * expected, rtol=1e-12)


def test_clock_counts_whole_control_periods() -> None:
    simulation = played(Simulation(Crowd(), WORLD, GOAL), commands(37))
    assert simulation.nanoseconds == 3_700_000_000
    assert WORLD.control_period == pytest.approx(0.1)


def test_sensors_add_independent_noise_of_the_given_strength() -> None:
    world = dataclasses.replace(WORLD, position_noise=0.01, velocity_noise=0.005)
    simulation = Simulation(Crowd(), world, GOAL)
    simulation.advance(np.full((2, 2), 0.02))
    truth, looks = simulation.state, [simulation.observe() for _ in range(2000)]
    for values, true, strength in (
        ([look.state.x for look in looks], truth.x, 0.01),
        ([look.state.v for look in looks], truth.v, 0.005),
        ([look.state.d for look in looks], truth.d, 0.01),
        ([look.dog_velocities for look in looks], np.full((2, 2), 0.02), 0.005),
    ):
        error = ((np.array(values) - true) / strength).reshape(len(looks), -1)
        assert np.abs(error.mean(axis=0)).max() < 4.5 / np.sqrt(len(looks))
        assert abs(error.var() - 1.0) < 4.0 * np.sqrt(2.0 / error.size)
        apart = np.corrcoef(error.T) - np.eye(error.shape[1])
        assert np.abs(apart).max() < 4.5 / np.sqrt(len(looks))


def test_perfect_sensors_tell_the_truth_in_single_precision() -> None:
    world = dataclasses.replace(WORLD, position_noise=0.0, velocity_noise=0.0)
    simulation = Simulation(Crowd(), world, GOAL)
    simulation.advance(np.full((2, 2), 0.02))
    seen, truth = simulation.observe(), simulation.state
    np.testing.assert_array_equal(seen.state.x, truth.x.astype(np.float32))
    np.testing.assert_array_equal(seen.state.v, truth.v.astype(np.float32))
    np.testing.assert_array_equal(seen.state.d, truth.d)
    np.testing.assert_array_equal(seen.dog_velocities, simulation.dog_velocities)


def test_flock_that_starts_at_the_goal_has_arrived() -> None:
    here = initial_herd(9, 2, GOAL, np.random.default_rng(3)).x.mean(axis=0)
    assert Simulation(Crowd(), WORLD, here).arrived
    assert not Simulation(Crowd(), WORLD, here + np.array([0.06, 0.0])).arrived


def test_strays_of_the_world_count_neither_at_the_start_nor_at_the_goal() -> None:
    usual = Simulation(Crowd(), WORLD, GOAL)
    left = Simulation(Crowd(), dataclasses.replace(WORLD, arrival=Arrival(strays=1)), GOAL)
    np.testing.assert_array_equal(left.state.x, usual.state.x)
    assert left.initial_spread < usual.initial_spread
    there = GOAL + usual.state.x - usual.state.x[1:].mean(axis=0)
    there[0] = [-20.0, 3.0]
    for simulation, expected in ((left, True), (usual, False)):
        simulation.state = dataclasses.replace(simulation.state, x=there)
        assert simulation.arrived is expected


def test_not_all_sheep_may_be_left_behind() -> None:
    words = 'World.arrival.strays must be less than World.sheep, 9, got 9'
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(WORLD, arrival=Arrival(strays=9))


@pytest.mark.parametrize(('preset', 'ahead'), [('cohesive', False), ('guided', True)])
def test_dogs_that_attract_start_ahead_of_the_flock(preset: str, ahead: bool) -> None:
    found = Simulation(CROWDS[preset], WORLD, GOAL).state
    expected = initial_herd(9, 2, GOAL, np.random.default_rng(3), ahead)
    np.testing.assert_array_equal(found.d, expected.d)
    assert (found.d @ GOAL > 0.0).all() == ahead


def test_it_counts_how_often_dogs_touch_and_how_near_they_came() -> None:
    simulation = Simulation(Crowd(), WORLD, GOAL)
    start = float(np.linalg.norm(simulation.state.d[0] - simulation.state.d[1]))
    assert (simulation.touches, simulation.closest_dogs) == (0, start)
    there = simulation.state.d[1] - simulation.state.d[0]
    u = np.zeros((400, 2, 2))
    u[:, 0] = 0.05 * there / start
    k = int((start - 0.08) / 0.005)
    u[k + 5 : k + 15] *= -1.0
    distances = []
    for each in u:
        simulation.advance(each)
        distances.append(float(np.linalg.norm(simulation.state.d[0] - simulation.state.d[1])))
    touching = np.array(distances) < 0.08
    assert simulation.touches == (touching[1:] & ~touching[:-1]).sum() == 2
    assert simulation.closest_dogs == min(distances)


def test_commands_take_effect_after_the_delay() -> None:
    late = Simulation(Crowd(), dataclasses.replace(WORLD, delay=0.29), GOAL)  # three periods
    prompt = Simulation(Crowd(), WORLD, GOAL)
    rng = np.random.default_rng(0)
    u = [np.zeros((2, 2))] * 3 + [rng.normal(0.0, 0.02, (2, 2)) for _ in range(7)]
    for k in range(7):
        late.advance(u[k + 3])
        prompt.advance(u[k])
        np.testing.assert_array_equal(late.state.d, prompt.state.d)
        np.testing.assert_array_equal(late.state.x, prompt.state.x)
        np.testing.assert_array_equal(late.dog_velocities, prompt.dog_velocities)


def test_headings_are_those_when_the_next_command_takes_effect() -> None:
    world = dataclasses.replace(WORLD, delay=0.5, motion=Unicycle())
    simulation = Simulation(Crowd(), world, GOAL)
    told, turned = [], []
    for _ in range(12):
        told.append(simulation.headings)
        turned.append(simulation.state.d[:, 2])
        simulation.advance(np.array([[0.03, 0.01], [-0.01, 0.02]]))
    np.testing.assert_allclose(told[:-5], turned[5:], atol=1e-12)
    assert np.abs(told[-1] - turned[-1]).max() > 0.05


def test_a_delay_without_end_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r'World\.delay must be at most 1000 control periods, 100 s'
    ):
        dataclasses.replace(WORLD, delay=1e6)


WIDE = HerdState(np.zeros((9, 2)), np.zeros((9, 2)), np.ones((2, 3)))
BAD_COMMANDS = [
    (None, 'commands u must have shape (2, 2), got ()'),
    (0.01, 'commands u must have shape (2, 2), got ()'),
    (np.zeros((3, 2)), 'commands u must have shape (2, 2), got (3, 2)'),
    (np.zeros((1, 2, 2)), 'commands u must have shape (2, 2), got (1, 2, 2)'),
    ([[0.0, np.nan], [0.0, 0.0]], 'commands u must be finite'),
]


@pytest.mark.parametrize('delay', [0.0, 0.3])
@pytest.mark.parametrize(('u', 'words'), BAD_COMMANDS)
def test_bad_commands_are_refused_when_they_are_given(u: object, words: str, delay: float) -> None:
    simulation = Simulation(Crowd(), dataclasses.replace(WORLD, delay=delay), GOAL)
    before = simulation.state
    with pytest.raises(ValueError, match=f'^{re.escape(words)}'):
        simulation.advance(u)  # type: ignore[arg-type]
    assert simulation.state is before
    played(simulation, np.zeros((5, 2, 2)))  # nothing of it is left


@pytest.mark.parametrize('goal', [[0.5], [0.5, np.nan], [0.5, 0.5, 0.0], 'there', None])
def test_bad_goals_are_refused(goal: Any) -> None:
    with pytest.raises(ValueError, match=r'^goal must '):
        Simulation(Crowd(), WORLD, goal)
    simulation = Simulation(Crowd(), WORLD, GOAL)
    with pytest.raises(ValueError, match=r'^goal must '):
        simulation.goal = goal
    np.testing.assert_array_equal(simulation.goal, GOAL)


def test_a_start_has_positions_of_dogs_and_no_more() -> None:
    words = re.escape('dogs d of the start must have shape (any, 2), got (2, 3)')
    with pytest.raises(ValueError, match=f'^{words}$'):
        Simulation(Crowd(), WORLD, GOAL, WIDE)
