# SPDX-License-Identifier: Apache-2.0
"""The filter along a recording against exact densities, plain predictions, and differences."""

from __future__ import annotations

from dataclasses import replace

from herding_ros.control.parameters import Sensor
from herding_ros.fit.estimate import _Likelihood, _Model
from herding_ros.fit.forecast import forecast
from herding_ros.fit.prediction import Filter
from herding_ros.fit.recording import Recording
from herding_ros.model.alignment import Alignment
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import follow
from herding_ros.model.potentials import Morse
from herding_ros.model.simulation import World
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest
from recorded import record
from scipy.stats import multivariate_normal

NOTHING = Morse(repulsion=0.0, attraction=0.0)
FREE = Crowd(sheep=NOTHING, dog=NOTHING, friction=0.7, noise=0.3)
SENSOR = Sensor(0.05, 0.02)


def random_recording(seed: int, sheep: int = 2, instants: int = 9) -> Recording:
    """Walks at unequal times, with gaps in positions and velocities."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.05, 0.3, instants))
    x, v = rng.normal(0.0, 0.2, (2, instants, sheep, 2))
    x[3:5, 0] = np.nan
    v[[2, 3, 6], 0] = np.nan
    return Recording(times, x, v, rng.normal(3.0, 0.1, (instants, 1, 2)))


def exact_log_density(recording: Recording, i: int, steps: int) -> float:
    """Of what is seen of free sheep i after the first instant, given that: one big Gaussian."""
    mean = np.array([recording.x[0, i], recording.v[0, i]])
    covariance = np.diag([SENSOR.position_noise**2, SENSOR.velocity_noise**2])
    means, transitions, covariances = [], [], []
    for interval in np.diff(recording.times):
        dt = interval / steps
        step = np.array([[1.0, dt], [0.0, 1.0 - FREE.friction * dt]])
        whole = np.eye(2)
        for _ in range(steps):
            covariance = step @ covariance @ step.T + np.diag([0.0, FREE.noise**2 * dt])
            whole = step @ whole
        mean = whole @ mean
        means.append(mean)
        transitions.append(whole)
        covariances.append(covariance)
    size = len(means)
    joint = np.zeros((2 * size, 2 * size))
    for a in range(size):
        across = covariances[a]
        for b in range(a, size):
            across = transitions[b] @ across if b > a else across
            joint[2 * b : 2 * b + 2, 2 * a : 2 * a + 2] = across
            joint[2 * a : 2 * a + 2, 2 * b : 2 * b + 2] = across.T
    joint += np.diag(np.tile([SENSOR.position_noise**2, SENSOR.velocity_noise**2], size))
    total = 0.0
    for c in range(2):
        seen = np.stack([recording.x[1:, i, c], recording.v[1:, i, c]], axis=1).ravel()
        there, expected = np.isfinite(seen), np.array(means)[:, :, c].ravel()
        part = joint[np.ix_(there, there)]
        total += multivariate_normal(expected[there], part).logpdf(seen[there])
    return total


@pytest.mark.parametrize('seed', range(3))
def test_of_free_sheep_it_is_the_exact_likelihood(seed: int) -> None:
    recording = random_recording(seed)
    longest = np.diff(recording.times).max()
    found = Filter(recording, [0.0], longest / 3.0).innovations(FREE, SENSOR)
    terms = found.off**2 / found.variance[..., None, :] + np.log(
        2.0 * np.pi * found.variance[..., None, :]
    )
    for i in range(2):
        mine = -0.5 * np.nansum(terms[..., i])
        assert mine == pytest.approx(exact_log_density(recording, i, 3), rel=1e-10)


def test_predictions_are_those_of_the_model() -> None:
    """From exact observations a prediction is a rollout along the recorded dogs."""
    crowd = Crowd(
        Morse(2.0, 0.3, 1.0, 2.0), Morse(1.0, 0.8, 0.0, 1.0), alignment=Alignment(2.0, 0.5),
        noise=0.1,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    x, v = rng.normal(0.0, 0.5, (2, 8, 5, 2))
    d = rng.normal(1.0, 0.5, (8, 2, 2))
    seen = Recording(0.1 * np.arange(8), x, v, d)
    found = Filter(seen, [0.3], 0.025).innovations(crowd, Sensor(1e-8, 1e-8))
    start = HerdState(x[0], v[0], d[0])
    ways = np.concatenate([np.linspace(d[k], d[k + 1], 5)[:-1] for k in range(3)] + [d[3:4]])
    end = follow(crowd, start, ways.transpose(0, 2, 1), 0.025).at(-1)
    np.testing.assert_allclose(found.off[0, 0, 0].T, x[3] - end.x, rtol=1e-8, atol=1e-10)
    assert np.isnan(found.off[1, 0]).all()  # predictions begin as far apart as they reach
    assert not np.isnan(found.off[3, 0]).any()


@pytest.mark.parametrize('leads', [[0.0], [0.2, 0.5]])
def test_gradient_is_that_of_the_objective(leads: list[float]) -> None:
    crowd = Crowd(noise=0.02, alignment=Alignment(1.0, 0.3))
    seen = record(crowd, World(sheep=6, dogs=2, seed=1), 5.0)
    names = ['crowd.dog.repulsion', 'crowd.friction', 'crowd.noise', 'crowd.alignment.rate',
             'sensor.position_noise']  # fmt: skip
    objective = _Likelihood([seen], _Model(crowd, SENSOR), names, leads, 0.05)
    values = _Model(crowd, SENSOR).flat()
    theta = np.log([values[name] for name in names]) + 0.1

    def difference(h: float) -> Array:
        steps = h * np.eye(len(names))
        return np.array([objective(theta + s) - objective(theta - s) for s in steps]) / (2.0 * h)

    found = objective.at(theta).gradient
    np.testing.assert_allclose(found, difference(1e-4), rtol=1e-3, atol=1e-3)


def test_errors_of_forecasts_are_as_expected_if_the_crowd_is_right() -> None:
    """A bit larger: at the start some are thrown apart from places that are not well known."""
    seen = [record(Crowd(), World(seed=seed), 30.0) for seed in (1, 2)]
    judged = forecast(seen, Crowd(), Sensor(0.01, 0.005), 0.05)
    assert [each.ahead for each in judged] == [0.0, 1.0, 3.0, 10.0]
    ratios = [each.error / each.expected for each in judged]
    np.testing.assert_allclose(ratios, 1.1, atol=0.15)
    assert all(each.error < each.standing for each in judged[1:])
    # At the next observation errors are independent and normal.
    assert judged[0].standardised.std() == pytest.approx(1.0, abs=0.02)


def test_residuals_are_recorded_less_predicted() -> None:
    """Of a sheep that walks straight on, is not seen for a while, and turns off; at its times."""
    t = 0.1 * np.arange(41)
    x = np.stack([t, np.maximum(t - 2.95, 0.0)], axis=1)[:, None]
    x[20] = np.nan
    seen = Recording(t, x, np.full_like(x, np.nan), np.full((41, 1, 2), 99.0))
    straight = Crowd(sheep=NOTHING, dog=NOTHING, friction=0.0, noise=1.0)
    exact = Sensor(1e-4, 1.0)
    at_once, second = forecast([seen], straight, exact, 0.05, (0.0, 1.0, 5.0))
    assert (at_once.ahead, second.ahead) == (0.0, 1.0)
    # Predictions of 1 s begin each second: that which begins at 2 s has no beginning.
    np.testing.assert_allclose(second.t, [1.0, 1.0, 4.0, 4.0])
    np.testing.assert_allclose(second.moved[2:], [1.0, 1.0])
    np.testing.assert_allclose(second.predicted[2:], [1.0, 0.5], atol=0.1)
    np.testing.assert_allclose(second.off, second.moved - second.predicted)
    late = at_once.t > 1.0
    assert at_once.t[late].min() == pytest.approx(1.1)
    assert not np.isclose(at_once.t, 2.0).any()
    before = late & (at_once.t < 2.95)
    np.testing.assert_allclose(at_once.off[before], 0.0, atol=2e-3)
    turned = np.isclose(at_once.t, 3.0)
    np.testing.assert_allclose(at_once.off[turned], [0.0, 0.05], atol=2e-3)
    np.testing.assert_array_equal(at_once.standardised, at_once.off / at_once.deviation)


def test_times_in_another_unit_take_no_memory() -> None:
    """All intervals have as many steps as the longest."""
    seen = random_recording(0)
    words = r'times must be in s, with no gap of 2\.\d+e\+20 s: at a step of 0\.05 s it'
    with pytest.raises(ValueError, match=f'^recording: {words}'):
        Filter(replace(seen, times=1e21 * seen.times), [0.0], 0.05)
