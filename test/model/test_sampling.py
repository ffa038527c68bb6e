# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
import dataclasses

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.kernels import lanes, PATHS
from herding_ros.model.noise import noise_paths
from herding_ros.model.potentials import Morse
from herding_ros.model.sampling import (
    alone,
    ESTIMATORS,
    FineModel,
    free,
    interpolate,
    MonteCarloEstimator,
    Resolution,
)
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

HerdMaker = Callable[..., HerdState]

CROWD = Crowd(noise=0.03)
NOTHING = Morse(0.0, 1.0, 0.0, 1.0)
FREE_CROWD = Crowd(sheep=NOTHING, dog=NOTHING, noise=0.03)
STEPS = 40


def controls(dogs: int) -> Array:
    return np.random.default_rng(1).normal(0.0, 0.05, (STEPS // 2, dogs, 2))


def model(state: HerdState, crowd: Crowd = CROWD) -> FineModel:
    return FineModel(crowd, state, 0.05, STEPS, 2)


def draw(fine: FineModel, longer: int = 1, seed: int = 0) -> Array:
    return fine.draw(np.random.default_rng(seed), longer)


def single(fine: FineModel, u: Array, noise: Array, path: int, longer: int = 1) -> Array:
    """Centre (K'+1, 2) in one path of a block, from a rollout with every substep on its own."""
    mine = noise[:, :, path :: fine.at_once]
    padded = np.zeros((len(mine), 2, lanes(fine.sheep)))
    padded[:, :, : fine.sheep] = mine
    speeds = np.repeat(u, 2, axis=0).reshape(len(mine), longer, *u.shape[1:]).mean(axis=1)
    track = rollout(fine.crowd, fine.state, speeds, longer * fine.dt, 1, padded)
    return track.x.mean(axis=1)


@pytest.mark.parametrize(('n', 'm', 'longer'), [(1, 1, 1), (8, 2, 1), (11, 3, 2), (5, 2, 4)])
def test_centres_are_those_of_single_rollouts(
    random_herd: HerdMaker, n: int, m: int, longer: int
) -> None:
    fine, u = model(random_herd(n, m)), controls(m)
    noise = draw(fine, longer)
    found = Resolution(longer=longer).sampler(fine, u)(noise)
    assert found.shape == (STEPS // longer + 1, 2, PATHS)
    for path in range(PATHS):
        expected = single(fine, u, noise, path, longer)
        np.testing.assert_allclose(found[:, :, path], expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(('n', 'group'), [(6, 1), (6, 3), (7, 4)])
def test_groups_do_not_notice_each_other(random_herd: HerdMaker, n: int, group: int) -> None:
    """Each is a flock of its own, whose forces are divided by the size of a group."""
    fine, u = model(random_herd(n, 2)), controls(2)
    noise = draw(fine)
    found = Resolution(group).sampler(fine, u)(noise)
    total = np.zeros((STEPS + 1, 2))
    for first in range(0, n, group):
        some = slice(first, min(first + group, n))
        size = some.stop - some.start
        state = HerdState(fine.state.x[some], fine.state.v[some], fine.state.d)
        weaker = dataclasses.replace(
            CROWD.sheep,
            repulsion=CROWD.sheep.repulsion * size / group,
            attraction=CROWD.sheep.attraction * size / group,
        )
        part = model(state, dataclasses.replace(CROWD, sheep=weaker))
        mine = noise[:, :, some.start * PATHS : some.stop * PATHS]
        total += size * single(part, u, np.ascontiguousarray(mine), 3)
    np.testing.assert_allclose(found[:, :, 3], total / n, rtol=0, atol=1e-13)


@pytest.mark.parametrize('resolution', [Resolution(), Resolution(4), Resolution(1, 4)])
def test_a_large_flock_is_computed_path_by_path_alike(
    random_herd: HerdMaker, monkeypatch: pytest.MonkeyPatch, resolution: Resolution
) -> None:
    fine, u = model(random_herd(9, 2)), controls(2)
    noise = draw(fine, resolution.longer)
    block = resolution.sampler(fine, u)(noise)[:, :, 5]
    variate = free(fine, u)(noise)[:, :, 5]
    monkeypatch.setattr('herding_ros.model.sampling._LARGE', 8)
    assert fine.at_once == 1
    one = np.ascontiguousarray(noise[:, :, 5::PATHS])
    found = resolution.sampler(fine, u)(one)
    np.testing.assert_allclose(found[:, :, 0], block, rtol=0, atol=1e-13)
    np.testing.assert_allclose(free(fine, u)(one)[:, :, 0], variate, rtol=0, atol=1e-15)
    assert draw(fine).shape == (STEPS, 2, 9)


def test_noise_is_that_of_the_ensemble(random_herd: HerdMaker) -> None:
    """So that plain estimates are means of the paths that `noise_paths` draws."""
    fine, rng = model(random_herd(5, 1)), np.random.default_rng(4)
    found = [fine.draw(rng, 1) for _ in range(3)]
    drawn = noise_paths(np.random.default_rng(4), CROWD, 5, 0.05, STEPS, 3 * PATHS)
    np.testing.assert_array_equal(found, drawn.blocks)
    assert np.std(draw(fine, 8)) == pytest.approx(0.03 * np.sqrt(0.4), rel=0.1)


def test_without_forces_the_free_centre_is_all_that_noise_does(random_herd: HerdMaker) -> None:
    """With any friction and any start, to rounding."""
    for friction in (0.0, 0.5, 3.0):
        fine = model(random_herd(6, 2), dataclasses.replace(FREE_CROWD, friction=friction))
        u, noise = controls(2), draw(fine)
        moved = Resolution().sampler(fine, u)(noise)
        quiet = Resolution().sampler(fine, u)(np.zeros_like(noise))
        variate = free(fine, u)(noise)
        assert np.abs(variate[-1]).min() > 1e-5
        np.testing.assert_allclose(moved - quiet, variate, rtol=0, atol=1e-14)


def test_the_control_variate_is_odd_and_additive(random_herd: HerdMaker) -> None:
    """Linear in the noise, with weights of its own: so its mean is zero."""
    fine, u = model(random_herd(6, 2)), controls(2)
    sample, one, other = free(fine, u), draw(fine), draw(fine, seed=1)
    np.testing.assert_allclose(
        sample(2.0 * one - other), 2.0 * sample(one) - sample(other), rtol=0, atol=1e-14
    )


def test_antithetic_pair_is_exact_where_noise_acts_linearly(random_herd: HerdMaker) -> None:
    fine, u = model(random_herd(6, 2), FREE_CROWD), controls(2)
    (level,) = MonteCarloEstimator(antithetic=True).levels(fine)
    values = level.sampler(u)(draw(fine))
    expected = rollout(FREE_CROWD, fine.state, u, 0.05, 2).x.mean(axis=1)
    np.testing.assert_allclose(values, expected[:, :, None] + np.zeros(PATHS), atol=1e-14)


@pytest.mark.parametrize('variate', [None, free])
def test_levels_add_up_to_the_fine_model(
    random_herd: HerdMaker, variate: Callable[[FineModel, Array], Callable[[Array], Array]] | None
) -> None:
    """The sum telescopes: with the same noise on all levels only the fine model is left."""
    fine, u = model(random_herd(6, 2)), controls(2)
    chain = (Resolution(1, 8), Resolution(3, 4), Resolution(longer=2), Resolution())
    estimator = MonteCarloEstimator(
        lambda _: chain, **({} if variate is None else {'variate': variate})
    )
    noise, total = draw(fine), np.zeros(1)
    for level in estimator.levels(fine):
        times = level.resolution.longer
        summed = noise.reshape(-1, times, 2, noise.shape[2]).sum(axis=1)
        total = total + interpolate(level.sampler(u)(summed), times)
    expected = Resolution().sampler(fine, u)(noise)
    if variate is not None:
        expected = expected - variate(fine, u)(noise)
    np.testing.assert_allclose(total, expected, rtol=0, atol=1e-13)


def test_sheep_alone_take_long_steps_that_friction_allows(random_herd: HerdMaker) -> None:
    state = random_herd(3, 1)
    for friction, longer in ((0.5, 8), (0.0, 8), (1.0, 4), (3.0, 1), (100.0, 1)):
        crowd = Crowd(friction=friction)
        assert alone(FineModel(crowd, state, 0.05, 400, 2)) == Resolution(1, longer)
    assert alone(FineModel(CROWD, state, 0.05, 70, 2)) == Resolution(1, 7)
    assert alone(FineModel(CROWD, state, 0.05, 37, 2)) == Resolution(1, 1)
    assert alone(FineModel(CROWD, state, 0.05, 1)) == Resolution(1, 1)


def test_interpolation_is_linear_between_the_steps() -> None:
    values = np.random.default_rng(0).normal(size=(4, 2, 3))
    found = interpolate(values, 5)
    for c in range(2):
        expected = np.interp(np.arange(16) / 5, np.arange(4), values[:, c, 1])
        np.testing.assert_allclose(found[:, c, 1], expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(interpolate(values, 1), values)


@pytest.mark.parametrize(('sheep', 'pairs'), [(512, True), (513, False)])
def test_large_flock_takes_paths_one_by_one(sheep: int, pairs: bool) -> None:
    state = HerdState(np.zeros((sheep, 2)), np.zeros((sheep, 2)), np.ones((1, 2)))
    fine = FineModel(Crowd(), state, 0.1, 4)
    assert [level.antithetic for level in ESTIMATORS['multilevel'].levels(fine)] == [pairs] * 2
