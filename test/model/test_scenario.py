# SPDX-License-Identifier: Apache-2.0
from herding_ros.model.scenario import initial_herd
from herding_ros.model.state import Array
import numpy as np
import pytest


@pytest.mark.parametrize('goal', [(0.5, 0.5), (1.0, -2.0), (-0.3, 0.0)])
@pytest.mark.parametrize('dogs', [1, 2, 5])
def test_dogs_stand_behind_the_flock(goal: tuple[float, float], dogs: int) -> None:
    herd = initial_herd(30, dogs, np.array(goal), np.random.default_rng(0))
    np.testing.assert_allclose(np.linalg.norm(herd.d, axis=1), 0.9, rtol=1e-14)
    away = -np.array(goal) / np.linalg.norm(goal)
    angles = np.arctan2(away[0] * herd.d[:, 1] - away[1] * herd.d[:, 0], herd.d @ away)
    expected = np.linspace(-0.9, 0.9, dogs) if dogs > 1 else [0.0]
    np.testing.assert_allclose(angles, expected, rtol=0, atol=1e-14)


def test_dogs_ahead_stand_opposite() -> None:
    behind, ahead = (
        initial_herd(30, 3, np.array([1.0, -2.0]), np.random.default_rng(0), each)
        for each in (False, True)
    )
    np.testing.assert_array_equal(ahead.x, behind.x)
    np.testing.assert_allclose(ahead.d, -behind.d, rtol=0, atol=1e-15)


def test_sheep_rest_all_over_the_pasture() -> None:
    herd = initial_herd(4000, 1, np.ones(2), np.random.default_rng(0))
    assert not herd.v.any()
    assert np.abs(herd.x).max() <= 0.4
    uniform = 0.8 / np.sqrt(12.0)
    np.testing.assert_allclose(herd.x.std(axis=0), uniform, rtol=4.0 / np.sqrt(2.0 * 4000))
    assert np.abs(herd.x.mean(axis=0)).max() < 4.0 * uniform / np.sqrt(4000)


def test_flock_follows_from_the_seed() -> None:
    def flock(seed: int) -> Array:
        return initial_herd(5, 2, np.ones(2), np.random.default_rng(seed)).x

    np.testing.assert_array_equal(flock(3), flock(3))
    assert (flock(3) != flock(4)).all()


@pytest.mark.parametrize(('sheep', 'dogs'), [(0, 1), (1, 0)])
def test_empty_herds_are_refused(sheep: int, dogs: int) -> None:
    with pytest.raises(ValueError, match='at least one sheep and one dog'):
        initial_herd(sheep, dogs, np.ones(2), np.random.default_rng(0))
