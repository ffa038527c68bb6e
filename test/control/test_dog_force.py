# SPDX-License-Identifier: Apache-2.0
"""What a controller learns of how strong and how far dogs are felt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

from herding_ros.control.dog_force import DogForce, Felt
from herding_ros.control.parameters import Control, Sensor
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.alignment import Alignment
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.noise import increments
from herding_ros.model.potentials import Harmonic, Morse, Potential, PowerLaw, Tabulated
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

SENSOR = Sensor(position_noise=0.0, velocity_noise=0.0)
CONTROL = Control(sensor=SENSOR)
PERIOD = CONTROL.horizon.control_period
STEPS = round(CONTROL.horizon.feedback / PERIOD)
TOLD = Crowd()
POTENTIALS: Sequence[Potential] = (
    Morse(1e-2, 0.5, 5e-4, 2.0),
    Harmonic(),
    PowerLaw(),
    Tabulated((0.1, 0.4, 0.9, 1.5), (0.03, 0.02, 0.005, 0.0)),
)


def felt(strength: float, reach: float, told: Crowd = TOLD) -> Crowd:
    """Return a crowd by the formula for its Morse potential, not by `rescaled`."""
    dog, slope = told.dog, strength * reach  # that of C exp(-r / l) is C / l
    assert isinstance(dog, Morse)
    true = Morse(
        slope * dog.repulsion,
        reach * dog.repulsion_length,
        slope * dog.attraction,
        reach * dog.attraction_length,
    )
    return replace(told, dog=true)


def learned(
    truth: Crowd,
    seed: int,
    told: Crowd = TOLD,
    seconds: int = 100,
    wind: Sequence[float] = (0.0, 0.0),
    errors: float = 0.0,
    sheep: int = 20,
    start: float = 0.0,
) -> tuple[Felt, list[Felt]]:
    """Return what is learned at last, and at each look, of a flock with dogs that roam beside it.

    wind: acceleration of all sheep [m/s^2]; errors: of positions that are seen [m]. Nobody is
    told of either. start: time of the first look [s].
    """
    rng, force = np.random.default_rng(seed), DogForce(told, CONTROL)
    x = 0.15 * rng.standard_normal((sheep, 2))
    state, looks = HerdState(x, np.zeros_like(x), rng.uniform(-1.0, 1.0, (3, 2))), []
    for second in range(seconds):
        seen = state.x + errors * rng.standard_normal(state.x.shape)
        force.learn(replace(state, x=seen), start + second, np.ones(sheep, dtype=np.bool_))
        looks.append(force.felt())
        # They run about at a distance in which sheep feel them.
        aim = state.x.mean(axis=0) + rng.uniform(-0.7, 0.7, (3, 2)) - state.d
        u = 0.05 * aim / np.linalg.norm(aim, axis=1, keepdims=True)
        noise = increments(rng, truth, sheep, PERIOD, STEPS)
        noise[:, :, :sheep] += PERIOD * np.array(wind)[:, None]
        state = rollout(truth, state, np.tile(u, (STEPS, 1, 1)), PERIOD, 1, noise).at(-1)
    return looks[-1], looks


@pytest.mark.parametrize('potential', POTENTIALS, ids=lambda each: type(each).__name__)
def test_dogs_that_are_felt_otherwise_have_the_force_g_f_of_r_by_s(potential: Potential) -> None:
    r = np.linspace(0.05, 3.0, 50, dtype=np.float64)
    dog = Felt(0.5, 2.0).crowd(replace(TOLD, dog=potential)).dog
    np.testing.assert_allclose(
        dog.derivative(r), 0.5 * potential.derivative(r / 2.0), rtol=1e-12, atol=1e-15
    )
    assert Felt().crowd(TOLD) is TOLD


@pytest.mark.parametrize(
    ('strength', 'reach'), [(1.0, 2.0), (1.0, 0.5), (2.0, 1.0), (0.5, 1.0), (2.0, 2.0)]
)
def test_strength_and_range_are_found(strength: float, reach: float) -> None:
    found = [learned(felt(strength, reach), seed)[0] for seed in range(5)]
    of_range = np.log2([each.range for each in found])
    of_force = np.log2([each.strength for each in found])
    assert abs(np.median(of_range) - math.log2(reach)) <= 0.5
    assert abs(np.median(of_force) - math.log2(strength)) <= 0.5


def test_a_time_that_is_rounded_delays_no_comparison() -> None:
    assert 4.1 - 1.1 < 3.0
    true = felt(2.0, 2.0)
    assert learned(true, 0, seconds=30, start=1.1)[1] == learned(true, 0, seconds=30)[1]


def test_strength_is_found_of_sheep_that_align_and_of_such_without_inertia() -> None:
    aligned = replace(TOLD, alignment=Alignment(1.0, 1.0))
    for told in (aligned, replace(TOLD, order=1)):
        found = [learned(felt(2.0, 1.0, told), seed, told)[0].strength for seed in range(5)]
        assert abs(math.log2(float(np.median(found))) - 1.0) <= 0.5


@pytest.mark.parametrize('noise', [0.0, 0.01, 0.03])
def test_what_is_true_is_doubted_in_one_run_of_a_hundred_at_most(noise: float) -> None:
    told = replace(TOLD, noise=noise)
    doubted = [set(learned(told, seed, told)[1]) != {Felt()} for seed in range(30)]
    # If it were one of a hundred, more than two of thirty would be one chance in three hundred.
    assert sum(doubted) <= 2


def test_noise_that_is_stronger_than_told_says_nothing_of_dogs() -> None:
    true = replace(TOLD, noise=0.03)
    doubted = [set(learned(true, seed)[1]) != {Felt()} for seed in range(30)]
    assert sum(doubted) <= 2


def test_errors_of_observation_of_which_it_is_not_told_say_nothing_of_dogs() -> None:
    doubted = [set(learned(TOLD, seed, errors=0.01)[1]) != {Felt()} for seed in range(30)]
    assert sum(doubted) <= 2


def test_wind_is_not_taken_for_dogs() -> None:
    wind = (0.004, -0.002)  # as strong as a dog at 0.8 m
    calm, windy = (learned(TOLD, 0, wind=each)[1] for each in ((0.0, 0.0), wind))
    assert set(calm) == set(windy) == {Felt()}
    found = [learned(felt(1.0, 2.0), seed, wind=wind)[0].range for seed in range(5)]
    assert np.median(found) == 2.0


@pytest.mark.parametrize(('true', 'told'), [(0.02, 5e-4), (5e-4, 0.02)])
def test_another_cohesion_than_told_is_not_taken_for_dogs(true: float, told: float) -> None:
    """Sheep that attract each other forty times as strongly as told, or as weakly."""
    truth, belief = (
        replace(TOLD, sheep=replace(TOLD.sheep, attraction=each)) for each in (true, told)
    )
    doubted = [learned(truth, seed, belief, 40)[0] != Felt() for seed in range(8)]
    assert not sum(doubted)


def test_nothing_is_learned_when_others_come_of_what_no_dog_does_and_of_an_hour() -> None:
    rng = np.random.default_rng(0)
    x = 0.15 * rng.standard_normal((20, 2))
    state = HerdState(x, np.zeros_like(x), np.array([[0.4, 0.0], [0.0, 0.5]]))
    others = HerdState(x[1:], np.zeros((19, 2)), state.d)
    scattered = replace(state, x=10.0 * x)
    for elapsed, then in ((5.0, others), (5.0, scattered), (3600.0, state)):
        force = DogForce(TOLD, CONTROL)
        before = force._dogs_found.copy()
        force.learn(state, 0.0, np.ones(20, dtype=np.bool_))
        force.learn(then, elapsed, np.ones(len(then.x), dtype=np.bool_))
        np.testing.assert_array_equal(force._dogs_found, before)
    force.learn(state, 3605.0, np.ones(20, dtype=np.bool_))
    assert (force._dogs_found != before).any()


def test_plans_go_by_what_is_learned_until_the_crowd_is_told_anew() -> None:
    state = HerdState(
        0.1 * np.random.default_rng(1).standard_normal((12, 2)),
        np.zeros((12, 2)),
        np.array([[-0.5, 0.0], [0.0, -0.5]]),
    )
    planner = RecedingHorizon(TOLD, CONTROL.with_values({'mapping.max_iterations': 0}), np.ones(2))
    planner.felt = Felt(1.0, 2.0)
    crowd = planner.coarse_model(state).crowd
    r = np.array([0.3, 1.0])
    np.testing.assert_allclose(crowd.dog.derivative(r), felt(1.0, 2.0).dog.derivative(r))
    report = planner.solve(state, 0.0).report
    assert (report.felt_strength, report.felt_range) == (1.0, 2.0)
    planner.adjust(TOLD, planner.control)
    assert planner.coarse_model(state).crowd is TOLD


@dataclass(frozen=True)
class WithoutUnits(Potential):
    """A user's potential whose number is no quantity."""

    strength: float = 0.02

    def value(self, r: Array) -> Array:
        return self.strength * np.exp(-r)

    def derivative(self, r: Array) -> Array:
        return -self.strength * np.exp(-r)

    def second_derivative(self, r: Array) -> Array:
        return self.strength * np.exp(-r)


class WithoutNumbers(Potential):
    """A user's potential whose number stands in its methods."""

    def value(self, r: Array) -> Array:
        return 0.02 * np.exp(-r)

    def derivative(self, r: Array) -> Array:
        return -0.02 * np.exp(-r)

    def second_derivative(self, r: Array) -> Array:
        return 0.02 * np.exp(-r)


@pytest.mark.parametrize('dog', [WithoutUnits(), WithoutNumbers()])
def test_of_a_potential_without_units_nothing_is_learned_and_plans_go_on(dog: Potential) -> None:
    """What was learned could not be told to the plans, which were said to go by it."""
    told = replace(TOLD, dog=dog)
    assert set(learned(replace(TOLD, dog=WithoutUnits(0.1)), 0, told, seconds=40)[1]) == {Felt()}


def test_sheep_that_are_left_behind_do_not_count() -> None:
    rng, told = np.random.default_rng(2), replace(TOLD, noise=0.0)
    x = 0.15 * rng.standard_normal((20, 2))
    state = HerdState(x, np.zeros_like(x), np.array([[0.4, 0.0], [0.0, 0.5]]))
    after = rollout(told, state, np.zeros((5 * STEPS, 2, 2)), PERIOD).at(-1)
    herded = np.arange(20) < 12
    for moves_others in (0.0, 0.1):
        force = DogForce(told, CONTROL)
        force.learn(state, 0.0, herded)
        x = after.x + moves_others * ~herded[:, None] * rng.standard_normal((20, 2))
        force.learn(replace(after, x=x), 5.0, herded)
        if not moves_others:
            score = force._dogs_found
    np.testing.assert_array_equal(force._dogs_found, score)
