from collections.abc import Callable
import dataclasses

import numpy as np
import pytest

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.ensemble import expected_positions
from herding_ros.model.kernels import lanes, PATHS
from herding_ros.model.noise import noise_paths, NoisePaths
from herding_ros.model.state import Array, HerdState

HerdMaker = Callable[..., HerdState]

CROWD = Crowd(noise=0.03)
DT = 0.05
SUBSTEPS = 2


def controls(m: int) -> Array:
    return np.random.default_rng(1).normal(0.0, 0.05, (20, m, 2))


def draw(n: int, paths: int, seed: int = 0, crowd: Crowd = CROWD) -> NoisePaths:
    return noise_paths(np.random.default_rng(seed), crowd, n, DT, 20 * SUBSTEPS, paths)


@pytest.mark.parametrize(
    ('n', 'm', 'paths'), [(1, 1, 1), (8, 2, 4), (11, 3, 15), (17, 1, 16), (5, 2, 17), (3, 1, 50)]
)
def test_expectation_is_the_mean_of_single_rollouts(
    random_herd: HerdMaker, n: int, m: int, paths: int
) -> None:
    state, u, noise = random_herd(n, m), controls(m), draw(n, paths)
    singles = [rollout(CROWD, state, u, DT, SUBSTEPS, noise.path(i)).x for i in range(paths)]
    found = expected_positions(CROWD, state, u, DT, SUBSTEPS, noise)
    assert found.shape == (41, n, 2)
    assert paths == 1 or np.ptp([each[-1] for each in singles], axis=0).min() > 1e-4
    np.testing.assert_allclose(found, np.mean(singles, axis=0), rtol=0, atol=1e-13)


def test_number_of_threads_does_not_change_a_bit(random_herd: HerdMaker) -> None:
    state, u, noise = random_herd(9, 2), controls(2), draw(9, 100)
    first, *others = (
        expected_positions(CROWD, state, u, DT, SUBSTEPS, noise, threads)
        for threads in (1, 2, 3, 7, None)
    )
    for other in others:
        np.testing.assert_array_equal(first, other)


def test_without_noise_it_is_the_coarse_model(random_herd: HerdMaker) -> None:
    quiet, state, u = dataclasses.replace(CROWD, noise=0.0), random_herd(9, 2), controls(2)
    found = expected_positions(quiet, state, u, DT, SUBSTEPS, draw(9, 7, crowd=quiet))
    coarse = rollout(quiet, state, u, DT, SUBSTEPS).x
    np.testing.assert_allclose(found, coarse, rtol=1e-14, atol=1e-15)


def test_common_random_numbers_leave_only_the_control(random_herd: HerdMaker) -> None:
    """A difference quotient over shared noise converges; over fresh noise it does not."""
    state, u = random_herd(9, 2), controls(2)
    direction = np.random.default_rng(2).normal(0.0, 1.0, u.shape)

    def quotient(h: float, seeds: tuple[int, int]) -> Array:
        there, here = (
            expected_positions(CROWD, state, u + step * direction, DT, SUBSTEPS, draw(9, 8, seed))
            for step, seed in zip((h, 0.0), seeds, strict=True)
        )
        return (there - here)[-1] / h

    limit = quotient(1e-7, (0, 0))
    assert np.abs(limit).max() > 1e-3
    np.testing.assert_allclose(quotient(1e-5, (0, 0)), limit, rtol=0, atol=1e-3)
    assert np.abs(quotient(1e-5, (0, 1)) - limit).max() > 1.0


def test_noise_is_brownian_and_independent_from_path_to_path() -> None:
    noise = noise_paths(np.random.default_rng(3), CROWD, 2, DT, 2_000, 20)
    drawn = np.stack([noise.path(i)[:, :, :2] for i in range(20)])
    drawn = drawn.transpose(1, 0, 2, 3).reshape(2_000, -1) / (CROWD.noise * np.sqrt(DT))
    assert abs(drawn.mean()) < 4.0 / np.sqrt(drawn.size)
    assert abs(drawn.var() - 1.0) < 4.0 * np.sqrt(2.0 / drawn.size)
    correlation = np.corrcoef(drawn.T) - np.eye(80)
    assert np.abs(correlation).max() < 5.0 / np.sqrt(2_000)


def test_there_are_no_more_paths_than_asked_for() -> None:
    noise = draw(3, 20)
    assert noise.path(19).shape == (40, 2, lanes(3))
    assert not noise.path(19)[:, :, 3:].any()
    with pytest.raises(IndexError):
        noise.path(20)


@pytest.mark.parametrize(
    ('paths', 'shape'),
    [
        (0, (0, 40, 2, 5 * PATHS)),
        (3, (1, 20, 2, 5 * PATHS)),
        (3, (1, 40, 2, 6 * PATHS)),
        (3, (1, 40, 1, 5 * PATHS)),
        (PATHS + 1, (1, 40, 2, 5 * PATHS)),
    ],
)
def test_noise_that_does_not_fit_is_refused(
    random_herd: HerdMaker, paths: int, shape: tuple[int, ...]
) -> None:
    noise = NoisePaths(paths, np.zeros(shape))
    with pytest.raises(ValueError, match='noise have shape'):
        expected_positions(CROWD, random_herd(5, 1), controls(1), DT, SUBSTEPS, noise)
