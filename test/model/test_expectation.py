# SPDX-License-Identifier: Apache-2.0
import math

from herding_ros.model import expectation
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.expectation import Expectation, ExpectedCentre, mean_centre, Noise
from herding_ros.model.kernels import PATHS
from herding_ros.model.noise import noise_paths
from herding_ros.model.potentials import Morse
from herding_ros.model.sampling import (
    alone,
    ESTIMATORS,
    FineModel,
    free,
    MonteCarloEstimator,
    Resolution,
)
from herding_ros.model.scenario import initial_herd
from herding_ros.model.state import Array
import numpy as np
import pytest

CROWD = Crowd(noise=0.03)
NOTHING = Morse(0.0, 1.0, 0.0, 1.0)
STEPS = 160
ALL = {
    **ESTIMATORS,
    'free': MonteCarloEstimator(variate=free),
    'levels': MonteCarloEstimator(
        lambda fine: (alone(fine), Resolution(5, 2), Resolution()), free, antithetic=True
    ),
}


def model(crowd: Crowd = CROWD, n: int = 10) -> FineModel:
    state = initial_herd(n, 2, np.array([0.5, 0.5]), np.random.default_rng(0))
    return FineModel(crowd, state, 0.05, STEPS, 2)


def controls() -> Array:
    return np.random.default_rng(1).normal(0.02, 0.03, (STEPS // 2, 2, 2))


def found(
    estimator: MonteCarloEstimator,
    error: float,
    most: int,
    seed: int = 0,
    fine: FineModel | None = None,
    threads: int | None = None,
) -> Expectation:
    fine = fine or model()
    noise = Noise(fine, estimator, seed)
    return ExpectedCentre(fine, estimator, noise, error, most, threads)(controls())


def distance(a: Array, b: Array) -> float:
    """Root mean square over the window, as `standard_error`."""
    return math.sqrt(float(np.square(a - b).sum()) / STEPS)


@pytest.mark.parametrize('paths', [1, 5, PATHS, PATHS + 4])
@pytest.mark.parametrize('large', [False, True])
def test_mean_centre_is_that_of_single_rollouts(
    monkeypatch: pytest.MonkeyPatch, large: bool, paths: int
) -> None:
    if large:
        monkeypatch.setattr('herding_ros.model.sampling._LARGE', 4)
    fine, u = model(), controls()
    noise = noise_paths(np.random.default_rng(3), CROWD, 10, 0.05, STEPS, paths)
    singles = [
        rollout(CROWD, fine.state, u, 0.05, 2, noise.path(i)).x.mean(axis=1) for i in range(paths)
    ]
    found, again = (mean_centre(fine, u, noise, threads) for threads in (1, 3))
    np.testing.assert_allclose(found, np.mean(singles, axis=0), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(found, again)


def test_plain_is_the_mean_over_paths() -> None:
    noise = noise_paths(np.random.default_rng(3), CROWD, 10, 0.05, STEPS, 100)
    each = found(ESTIMATORS['plain'], 0.0, 100, seed=3)
    assert each.paths == (100,)
    assert each.work == pytest.approx(100.0)
    expected = mean_centre(model(), controls(), noise)
    np.testing.assert_allclose(each.centre, expected, rtol=0, atol=1e-13)


@pytest.fixture(scope='module')
def truth() -> Expectation:
    return found(ESTIMATORS['plain'], 0.0, 6_000, seed=99)


@pytest.mark.parametrize('name', ALL)
def test_estimates_are_unbiased(name: str, truth: Expectation) -> None:
    each = found(ALL[name], 0.0, 1_500, seed=1)
    both = math.hypot(each.standard_error, truth.standard_error)
    assert distance(each.centre, truth.centre) < 3.0 * both
    assert both < 3e-3


@pytest.mark.parametrize('name', ALL)
def test_standard_error_is_honest(name: str) -> None:
    """The scatter of independent estimates is what they say, and what was asked for."""
    wanted = 8e-3
    runs = [found(ALL[name], wanted, 10_000, seed) for seed in range(60)]
    said = np.array([each.standard_error for each in runs])
    assert said.max() <= wanted
    scatter = np.var([each.centre for each in runs], axis=0, ddof=1).sum() / STEPS
    # Errors are alike all along the way: chi-square, with one degree per run and coordinate.
    assert scatter / np.square(said).mean() == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / 120))


@pytest.mark.parametrize('name', ['free', 'multilevel'])
def test_where_noise_acts_linearly_nothing_is_left(name: str) -> None:
    fine = model(Crowd(sheep=NOTHING, dog=NOTHING, noise=0.03))
    each = found(ALL[name], 1e-9, 10_000, fine=fine)
    assert each.standard_error < 1e-15
    assert max(each.paths) == PATHS


def test_multilevel_is_the_cheapest() -> None:
    """Variance times work does not depend on how much is done."""
    state = initial_herd(20, 3, np.array([0.5, 0.5]), np.random.default_rng(0))
    fine = FineModel(CROWD, state, 0.05, 400, 2)
    u = np.full((200, 3, 2), 0.02)
    costs = {}
    for name, estimator in ALL.items():
        each = ExpectedCentre(fine, estimator, Noise(fine, estimator, 0), 0.0, 200)(u)
        costs[name] = each.standard_error**2 * each.work
    assert min(costs, key=lambda name: costs[name]) == 'multilevel'
    assert costs['plain'] > 15.0 * costs['multilevel']


def test_no_more_work_than_allowed() -> None:
    each = found(ALL['free'], 1e-6, 100)
    assert each.paths == (100,)
    assert each.standard_error > 1e-6
    each = found(ALL['multilevel'], 1e-6, 100)
    assert 90.0 < each.work < 110.0
    assert found(ALL['plain'], 0.0, 7).paths == (7,)
    with pytest.raises(ValueError, match='most must be at least 2 paths, got 1'):
        found(ALL['plain'], 0.0, 1)


def test_paths_are_settled_once_and_noise_is_common() -> None:
    """Later evaluations take the same paths: the difference quotient converges."""
    fine, estimator, u = model(), ALL['multilevel'], controls()
    noise = Noise(fine, estimator, 5)
    expected = ExpectedCentre(fine, estimator, noise, 2e-3, 1000)
    first = expected(u)
    again = expected(u)
    np.testing.assert_allclose(again.centre, first.centre, rtol=0, atol=1e-15)
    assert again.paths == first.paths
    push = np.random.default_rng(2).normal(0.0, 1.0, u.shape)
    quotients = [(expected(u + h * push).centre - again.centre)[-1] / h for h in (1e-4, 1e-6)]
    assert np.abs(quotients[0]).max() > 1e-2
    np.testing.assert_allclose(quotients[0], quotients[1], rtol=0.02)
    assert expected(u * 0.0).paths == first.paths


def test_repeats_bit_for_bit_with_any_number_of_threads() -> None:
    first, *others = (
        found(ALL['multilevel'], 1e-3, 1000, threads=threads) for threads in (None, 1, 2, 5)
    )
    for other in others:
        np.testing.assert_array_equal(first.centre, other.centre)
        assert (first.paths, first.standard_error) == (other.paths, other.standard_error)
    other = found(ALL['multilevel'], 1e-3, 1000, seed=1)
    assert np.abs(other.centre - first.centre).max() > 1e-5


@pytest.mark.parametrize('large', [False, True])
def test_noise_that_is_not_kept_is_drawn_again(
    monkeypatch: pytest.MonkeyPatch, large: bool
) -> None:
    if large:
        monkeypatch.setattr('herding_ros.model.sampling._LARGE', 4)
    kept = found(ALL['multilevel'], 0.0, 40)
    monkeypatch.setattr(expectation, '_MEMORY', 0)
    np.testing.assert_array_equal(found(ALL['multilevel'], 0.0, 40).centre, kept.centre)
    fine = model()
    noise = Noise(fine, ALL['multilevel'], 0)
    list(noise.streams[0].blocks(0, 3))
    assert not noise.streams[0]._kept
