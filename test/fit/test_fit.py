# SPDX-License-Identifier: Apache-2.0
"""Crowds found again in recordings of them, and what the recordings cannot tell."""

from __future__ import annotations

from herding_ros.control.closed_loop import as_policy
from herding_ros.control.excitation import ExcitingPilot
from herding_ros.control.parameters import Control
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.fit.estimate import Fit, fit
from herding_ros.fit.recording import Recording
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.potentials import Morse
from herding_ros.model.simulation import World
import numpy as np
import pytest
from recorded import GOAL, record

TOLD = ('crowd.dog.repulsion', 'crowd.dog.repulsion_length', 'crowd.friction', 'crowd.noise')


def truth(crowd: Crowd) -> dict[str, float]:
    return crowd.flat('crowd.')


def off(found: Fit, crowd: Crowd) -> dict[str, float]:
    """Errors of logarithms in standard deviations."""
    true = truth(crowd)
    return {
        e.name: float(np.log(e.value / true[e.name]) / e.deviation)
        for e in found.estimates
        if e.name in true
    }


@pytest.fixture(scope='module')
def reference() -> Recording:
    return record(Crowd(), World(seed=1), 30.0)


@pytest.fixture(scope='module')
def found(reference: Recording) -> Fit:
    """A fit that starts a factor of two off."""
    start = Crowd(dog=Morse(2e-2, 0.25, 5e-4, 2.0), friction=1.0, noise=0.02)
    return fit([reference], start)


def test_the_crowd_is_found_again_from_a_wrong_start(found: Fit) -> None:
    assert found.converged
    errors = off(found, Crowd())
    assert {name: errors[name] for name in TOLD if abs(errors[name]) > 3.0} == {}
    widths = {e.name: e.deviation for e in found.estimates}
    assert widths['crowd.noise'] < 0.02
    assert widths['crowd.friction'] < 0.08
    assert all(e.is_told for e in found.estimates if e.name in TOLD)


def test_what_cannot_be_told_is_said(found: Fit) -> None:
    doubts = {e.name: e.doubt for e in found.estimates}
    for part in ('sheep', 'dog'):
        assert doubts[f'crowd.{part}.attraction'] == 'it has hardly any effect here'
    # Sheep repel each other within 1 cm, which is the noise of their positions.
    assert doubts['crowd.sheep.repulsion'] == 'it acts within the noise of the positions'


def test_a_flat_direction_is_told_from_no_effect() -> None:
    """Without inertia only force / friction and noise / friction matter."""
    still, fled = Morse(0.0, 1e-2, 0.0, 2.0), Morse(0.1, 0.3, 0.0, 2.0)
    crowd = Crowd(still, fled, friction=2.0, order=1, noise=0.02)
    world = World(sheep=10, dogs=2, seed=2)
    fitted = fit([record(crowd, world, 20.0)], crowd, hold=['crowd.sheep.'])
    told = {e.name: e for e in fitted.estimates}
    names = {'crowd.friction', 'crowd.noise', 'crowd.dog.repulsion'}
    for name in names:
        assert told[name].doubt in {f'{other} can make up for it' for other in names - {name}}
    assert told['crowd.dog.repulsion_length'].is_told
    assert {'crowd.dog.attraction_length', 'crowd.alignment.range'} <= set(fitted.held)
    ratio = fitted.crowd.noise / fitted.crowd.friction
    assert ratio == pytest.approx(crowd.noise / crowd.friction, rel=0.1)
    order = [e.name for e in fitted.estimates]
    i, j = order.index('crowd.friction'), order.index('crowd.noise')
    assert fitted.correlation[i, j] > 0.99


def test_strength_and_range_of_a_dog_that_keeps_its_distance_make_up_for_each_other() -> None:
    """Only the force at that distance can be told: C / l exp(-r / l)."""
    crowd, away = Crowd(dog=Morse(2e-2, 0.5, 0.0, 2.0), noise=5e-3), np.array([0.15, 0.0])
    force = 0.02 / 0.5 * np.exp(-0.15 / 0.5)
    rng, dt, x, v, seen = np.random.default_rng(0), 0.05, np.zeros(2), np.zeros(2), []
    for _ in range(1200):
        seen.append((x, v))
        push = np.array([force, 0.0]) - crowd.friction * v
        x, v = x + dt * v, v + dt * push + crowd.noise * np.sqrt(dt) * rng.normal(size=2)
    places, velocities = np.array(seen[::2]).swapaxes(0, 1)[:, :, None]
    times = 2.0 * dt * np.arange(len(places))
    recording = Recording(times, places, velocities, places - away, 'one', 1e-4, 1e-4)
    hold = ['crowd.sheep.', 'crowd.friction', 'crowd.noise']
    strength, reach = fit([recording], crowd, hold=hold).estimates
    assert strength.doubt == 'crowd.dog.repulsion_length can make up for it'
    assert reach.doubt == 'crowd.dog.repulsion can make up for it'
    found = strength.value / reach.value * np.exp(-0.15 / reach.value)
    assert found == pytest.approx(force, rel=0.1)


def test_what_is_held_narrows_the_intervals_of_others(reference: Recording) -> None:
    """As said in advance, from the intervals of a fit in which it is free."""
    free = fit([reference], Crowd(), hold=['crowd.sheep.'])
    untold = {e.name for e in free.estimates if not e.is_told}
    assert untold == {'crowd.dog.attraction', 'crowd.dog.attraction_length'}
    said = {e.name: e for e in free.narrower()}
    assert said.keys() == {'crowd.dog.repulsion', 'crowd.dog.repulsion_length'}
    fewer = fit([reference], Crowd(), hold=['crowd.sheep.', *untold])
    held = {e.name: e for e in fewer.estimates}
    for name, each in said.items():
        assert each.deviation == pytest.approx(held[name].deviation, rel=0.15)
    assert fewer.narrower() == ()


def test_noise_of_sensors_is_found(reference: Recording) -> None:
    blind = Recording(reference.times, reference.x, reference.v, reference.d)
    fitted = fit([blind], Crowd(), hold=['crowd.sheep.', 'crowd.dog.'])
    assert fitted.sensor.position_noise == pytest.approx(0.01, rel=0.03)
    assert fitted.sensor.velocity_noise == pytest.approx(0.005, rel=0.05)
    assert fitted.crowd.noise == pytest.approx(0.01, rel=0.06)


def test_positions_alone_and_gaps_are_enough(reference: Recording) -> None:
    rng = np.random.default_rng(0)
    x = np.where(rng.random(reference.x.shape[:2])[..., None] < 0.2, np.nan, reference.x)
    seen = Recording(reference.times, x, np.full_like(x, np.nan), reference.d, position_noise=0.01)
    fitted = fit(
        [seen],
        Crowd(),
        hold=['crowd.sheep.', 'crowd.dog.attraction', 'crowd.dog.attraction_length'],
    )
    errors = off(fitted, Crowd())
    assert {name: errors[name] for name in TOLD if abs(errors[name]) > 3.0} == {}
    assert 'sensor.velocity_noise' not in [e.name for e in fitted.estimates]


def test_two_recordings_say_more_than_one(reference: Recording) -> None:
    hold = ['crowd.sheep.', 'crowd.dog.']
    one = fit([reference], Crowd(), hold=hold)
    two = fit([reference, reference], Crowd(), hold=hold)
    for a, b in zip(one.estimates, two.estimates, strict=True):
        assert b.value == pytest.approx(a.value, rel=1e-3)
        assert b.deviation == pytest.approx(a.deviation / np.sqrt(2.0), rel=0.02)


def test_held_parameters_stay(reference: Recording) -> None:
    fitted = fit([reference], CROWDS['cohesive'], hold=['crowd.sheep.', 'crowd.dog.'])
    assert fitted.crowd.sheep == Crowd().sheep
    assert 'crowd.sheep.repulsion' in fitted.held
    with pytest.raises(ValueError, match=r'hold must be among crowd\.sheep.* got crowd\.wool'):
        fit([reference], Crowd(), hold=['crowd.wool'])
    with pytest.raises(ValueError, match=r"hold must be a list of names, got 'crowd\.sheep\.'"):
        fit([reference], Crowd(), hold='crowd.sheep.')
    with pytest.raises(ValueError, match='there must be a parameter to fit'):
        fit([reference], Crowd(), hold=['crowd.'])


def test_leads_beyond_the_recording_are_refused(reference: Recording) -> None:
    with pytest.raises(ValueError, match=r'leads must be .* shorter than the recording, 29\.9 s'):
        fit([reference], Crowd(), leads=[1.0, 31.0])


@pytest.mark.parametrize('lead', [-1.0, np.nan, np.inf])
def test_leads_that_are_no_times_are_refused(reference: Recording, lead: float) -> None:
    with pytest.raises(ValueError, match=rf'leads must be at least 0 .*, got \[1\.0, {lead}\]$'):
        fit([reference], Crowd(), leads=[1.0, lead])


def test_nothing_to_fit_to_is_refused() -> None:
    with pytest.raises(ValueError, match=r'^there must be a recording to fit to$'):
        fit([], Crowd())


@pytest.mark.statistics
def test_a_run_to_and_fro_tells_all_that_can_be_told() -> None:
    """What `herd --excite` records in a minute."""
    inside = []
    for seed in range(3):
        pilot = ExcitingPilot(RecedingHorizon(Crowd(), Control(), GOAL, seed), 5)
        fitted = fit([record(Crowd(), World(seed=seed), 60.0, as_policy(pilot, []))], Crowd())
        told = {e.name: e for e in fitted.estimates if e.name in TOLD}
        assert all(e.is_told for e in told.values())
        inside += [e.low < truth(Crowd())[name] < e.high for name, e in told.items()]
    assert np.mean(inside) >= 0.9


@pytest.mark.statistics
def test_intervals_hold_what_they_promise() -> None:
    """A minute of each of twelve flocks; every second fit starts a factor of two off."""
    starts = Crowd(), Crowd(dog=Morse(2e-2, 0.25, 5e-4, 2.0), friction=1.0, noise=0.02)
    true, inside, errors = truth(Crowd()), [], []
    for seed in range(12):
        fitted = fit([record(Crowd(), World(seed=seed), 60.0)], starts[seed % 2])
        told = {e.name: e for e in fitted.estimates if e.name in TOLD}
        inside += [e.low < true[name] < e.high for name, e in told.items()]
        errors.append([told[name].value / true[name] - 1.0 for name in TOLD])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.mean(inside) >= 0.9
    np.testing.assert_array_less(rms, [0.1, 0.12, 0.06, 0.03])
