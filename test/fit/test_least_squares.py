# SPDX-License-Identifier: Apache-2.0
"""Crowds by their predictions, against closed forms and recordings of known crowds."""

from __future__ import annotations

from dataclasses import replace

from herding_ros.control.parameters import Sensor
from herding_ros.fit.least_squares import (
    _variance,
    constant_velocity,
    fit_predictions,
    Predictor,
    with_noise,
)
from herding_ros.fit.recording import Recording
from herding_ros.model.alignment import Alignment
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import follow
from herding_ros.model.noise import increments
from herding_ros.model.potentials import Morse
from herding_ros.model.state import HerdState
import numpy as np
import pytest
from scipy.integrate import quad

TRUE = Crowd(
    Morse(3.0, 1.0, 20.0, 20.0), Morse(3.0, 2.5, 0.0, 2.0), friction=0.3,
    alignment=Alignment(3.0, 1.5), noise=0.4, common_noise=0.3,
)  # fmt: skip
EXACT = Sensor(1e-3, 1.0)


def drive(crowd: Crowd, seed: int, duration: float, sheep: int = 8) -> Recording:
    """A flock under noise, and a dog that walks behind it to and fro; positions only."""
    rng = np.random.default_rng(seed)
    steps = round(duration / 0.05)
    t = 0.05 * np.arange(steps + 1)
    dog = np.stack([-4.0 + 0.9 * t + np.sin(0.7 * t + seed), 2.0 * np.sin(0.4 * t + seed)])
    x = rng.normal(0.0, 0.8, (sheep, 2))
    start = HerdState(x, np.tile([0.8, 0.0], (sheep, 1)), dog[:, 0][None])
    run = follow(crowd, start, dog.T[:, :, None], 0.05, increments(rng, crowd, sheep, 0.05, steps))
    seen = run.x[::2]
    return Recording(t[::2], seen, np.full_like(seen, np.nan), dog.T[::2, None], f'drive {seed}')


@pytest.fixture(scope='module')
def drives() -> list[Recording]:
    return [drive(TRUE, seed, 20.0) for seed in range(6)]


def test_predictions_are_those_of_straight_walks() -> None:
    """Sheep that turn off at 2 s, each lead at its place; short recordings as far as they go."""
    t = 0.1 * np.arange(41)
    x = np.stack([t, np.maximum(t - 2.0, 0.0)], axis=1)[:, None]
    dog = np.full((41, 1, 2), 99.0)
    seen = Recording(t, x, np.full_like(x, np.nan), dog)
    short = Recording(t[:25], x[:25], np.full_like(x[:25], np.nan), dog[:25])
    found = Predictor([seen, short], (1.0, 2.0)).predict(constant_velocity(1.0), EXACT)
    # Starts at 1, 2 and 3 s, and at 1 and 2 s; the last instants predict nothing.
    off = found.off[:, :, 1, 0]
    expected = [[0.0, 1.0], [1.0, 2.0], [1.0 - 1.0, np.nan]]
    np.testing.assert_allclose(off[:2], expected[:2], atol=0.02)
    np.testing.assert_allclose(off[2, 0], 0.0, atol=0.1)
    assert np.isnan(off[2, 1])
    np.testing.assert_allclose(found.off[:, 0, 0, 0][np.isfinite(off[:, 0])], 0.0, atol=0.02)
    np.testing.assert_array_equal(found.seen[0, :, 0, 0], x[[20, 30], 0, 0])


def test_the_crowd_is_found_again(drives: list[Recording]) -> None:
    start = Crowd(
        Morse(2.0, 1.2, 20.0, 20.0), Morse(1.5, 3.5, 0.0, 2.0), friction=0.5,
        alignment=Alignment(1.5, 2.5), noise=0.7,
    )  # fmt: skip
    predictor = Predictor(drives)
    hold = ['crowd.sheep.attraction_length']
    found = fit_predictions(predictor, start, EXACT, hold)
    error, least, at_first = (predictor.predict(each, EXACT).rms for each in (found, TRUE, start))
    # It predicts what it was fitted to no worse than the truth does.
    assert (error <= 1.02 * least).all()
    assert (error < 0.9 * at_first).any()
    assert found.sheep.attraction_length == 20.0
    assert found.noise == start.noise
    assert found.friction == pytest.approx(TRUE.friction, rel=0.3)
    push, expected = (float(each.dog.derivative(np.array(4.0))) for each in (found, TRUE))
    assert push == pytest.approx(expected, rel=0.2)


def test_the_noise_is_found_again() -> None:
    """Of flocks that noise makes larger, as that of real sheep does."""
    true, unknown = replace(TRUE, noise=1.0), replace(TRUE, noise=2.0, common_noise=0.0)
    predictor = Predictor([drive(true, seed, 20.0) for seed in range(8)])
    found = with_noise(unknown, predictor, EXACT)
    of_found, of_true = (
        each.noise * np.sqrt([1.0 - each.common_noise, each.common_noise])
        for each in (found, true)
    )
    np.testing.assert_allclose(of_found, of_true, rtol=0.3)
    recorded, simulated = predictor.sizes(found)
    assert simulated == pytest.approx(recorded, rel=0.02)


@pytest.mark.parametrize('friction', [0.0, 0.3, 4.0])
def test_variance_is_that_of_a_random_force(friction: float) -> None:
    def response(s: float) -> float:
        return s if not friction else float(-np.expm1(-friction * s) / friction)

    exact = quad(lambda s: response(s) ** 2, 0.0, 7.0)[0]
    assert float(_variance(np.array([7.0]), friction)[0]) == pytest.approx(exact, rel=0.01)


def test_what_tells_nothing_is_refused(drives: list[Recording]) -> None:
    short = drive(TRUE, 0, 1.5)
    with pytest.raises(ValueError, match='longer than 2 s, the longest of 1 has 1'):
        Predictor([short])
    with pytest.raises(ValueError, match=r'hold must be among .* got crowd\.wool'):
        fit_predictions(Predictor(drives[:1]), TRUE, EXACT, ['crowd.wool'])
    with pytest.raises(ValueError, match='there must be a parameter to fit'):
        fit_predictions(Predictor(drives[:1]), TRUE, EXACT, ['crowd.'])
    with pytest.raises(ValueError, match='longer than 10 s to tell the noise'):
        with_noise(TRUE, Predictor([drive(TRUE, 0, 6.0)]), EXACT)
