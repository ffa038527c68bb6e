# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable, Iterator

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import forces, rollout
from herding_ros.model.flock import centre, spread
from herding_ros.model.mean_field import blob_width, leaves, mean_field
from herding_ros.model.potentials import Morse
from herding_ros.model.scenario import initial_herd
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

HerdMaker = Callable[..., HerdState]
GOAL = np.array([0.5, 0.5])
SIZES = [(1, 1), (1, 7), (5, 5), (9, 4), (10, 3), (7, 16), (1000, 128), (1001, 37)]


def whole_parts(sheep: Array, parts: int) -> Iterator[Array]:
    """The same tree, of so many copies of each sheep that none has to be divided."""
    if parts == 1:
        yield sheep.mean(axis=0)
        return
    wider = np.argmax(sheep[:, :2].var(axis=0))
    sheep = sheep[np.lexsort([sheep[:, 1 - wider], sheep[:, wider]])]
    cut = len(sheep) // parts * (parts // 2)
    yield from whole_parts(sheep[:cut], parts // 2)
    yield from whole_parts(sheep[cut:], parts - parts // 2)


@pytest.mark.parametrize(('n', 'count'), SIZES)
def test_leaves_are_those_of_a_flock_of_divisible_size(
    random_herd: HerdMaker, n: int, count: int
) -> None:
    state = random_herd(n, 1, n)
    sheep = np.repeat(np.concatenate([state.x, state.v], axis=1), count, axis=0)
    expected = np.array(list(whole_parts(sheep, count)))
    found = np.concatenate(leaves(state, count), axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(('n', 'count'), SIZES)
def test_mass_centre_and_momentum_are_the_flocks(
    random_herd: HerdMaker, n: int, count: int
) -> None:
    state = random_herd(n, 1, n)
    x, v = leaves(state, count)
    assert x.shape == v.shape == (count, 2)
    np.testing.assert_allclose(centre(x), centre(state.x), rtol=0, atol=1e-15)
    np.testing.assert_allclose(centre(v), centre(state.v), rtol=0, atol=1e-15)


def test_one_leaf_for_each_sheep_is_the_sheep(random_herd: HerdMaker) -> None:
    state = random_herd(33, 1)
    x, v = leaves(state, 33)
    order = [int(np.argmin(np.abs(x - each).sum(axis=1))) for each in state.x]
    np.testing.assert_allclose(x[order], state.x, rtol=1e-15)
    np.testing.assert_allclose(v[order], state.v, rtol=1e-15)


def test_order_of_the_sheep_does_not_matter(random_herd: HerdMaker) -> None:
    state = random_herd(500, 1)
    # Of some only the velocity differs, some are the same.
    x, v = np.round(state.x, 1), np.round(state.v, 1)
    state, order = HerdState(x, v, state.d), np.random.default_rng(0).permutation(500)
    shuffled = HerdState(x[order], v[order], state.d)
    for a, b in zip(leaves(state, 48), leaves(shuffled, 48), strict=True):
        np.testing.assert_array_equal(a, b)


def test_symmetric_flock_stays_symmetric(random_herd: HerdMaker) -> None:
    half = random_herd(150, 2)
    state = HerdState(*(np.concatenate([a, -a]) for a in (half.x, half.v, half.d)))
    crowd, blobs = mean_field(Crowd(), state, 64)
    x = rollout(crowd, blobs, np.zeros((100, 4, 2)), 0.05).x
    assert abs(centre(x)).max() < 1e-13
    assert abs(x[-1] - x[0]).max() > 0.05
    mirrored = -x[-1]
    nearest = np.linalg.norm(x[-1][:, None] - mirrored[None], axis=-1).min(axis=1)
    assert nearest.max() < 1e-10


def test_blobs_are_as_wide_as_their_distance_asks_for() -> None:
    """64 blobs in the square of 0.8 m stand 0.1 m apart; widths come in steps of a fifth."""
    x = initial_herd(10_000, 1, GOAL, np.random.default_rng(0)).x
    width = blob_width(x, 64, 2.0)
    assert 0.07 / 1.12 < width < 0.07 * 1.12
    assert blob_width(2.0 * x + 3.0, 64, 2.0) == 2.0 * width
    assert blob_width(x, 16, 2.0) == 2.0 * width
    assert blob_width(x[:1], 64, 2.0) == pytest.approx(1e-3, rel=0.1)  # no area


def test_repulsion_acts_as_the_pressure_of_the_limit() -> None:
    """The mean of x . F is kappa / A for a flock uniform on the area A, kappa = 2 pi l^2 C.

    The virial of the pressure kappa rho^2 / 2; blobs lose some at the edge, less the more.
    Points as far apart as they are, without blobs, feel next to nothing.
    """
    repulsion = Crowd(sheep=Morse(25.0, 2e-3, 0.0, 1.0))
    state = initial_herd(20_000, 1, GOAL, np.random.default_rng(0))
    state = HerdState(state.x, state.v, state.d + 1e3)
    exact = 2.0 * np.pi * 1e-4 / 0.64

    def virial(crowd: Crowd, x: Array) -> float:
        return float((x * forces(crowd, x, state.d)).sum(axis=1).mean())

    errors = []
    for count in (64, 256, 1024):
        crowd, blobs = mean_field(repulsion, state, count)
        errors.append(1.0 - virial(crowd, blobs.x) / exact)
    assert 0.0 < errors[2] < 0.06
    assert errors[2] < 0.6 * errors[1] < 0.36 * errors[0]
    assert virial(repulsion, leaves(state, 64)[0]) < 1e-6 * exact


def difference(n: int, seed: int, count: int) -> tuple[float, float]:
    """Largest errors of centre and spread [m] in 10 s in which dogs drive the flock."""
    state = initial_herd(n, 5, GOAL, np.random.default_rng(seed))
    crowd, blobs = mean_field(Crowd(), state, count)
    u = np.full((100, 5, 2), 0.03)
    flock, limit = (rollout(c, s, u, 0.05, 2).x for c, s in ((Crowd(), state), (crowd, blobs)))
    assert np.linalg.norm(centre(flock)[-1] - centre(flock)[0]) > 0.1
    # What the leaves' own extent adds to the variance at the start.
    within = spread(flock[0]) ** 2 - spread(limit[0]) ** 2
    return (
        float(np.linalg.norm(centre(limit) - centre(flock), axis=1).max()),
        float(abs(np.sqrt(spread(limit) ** 2 + within) - spread(flock)).max()),
    )


def test_particle_systems_converge_to_it() -> None:
    few, some, many = (
        np.mean([difference(n, seed, 256) for seed in range(2)], axis=0) for n in (100, 400, 1600)
    )
    assert few[1] > 2.0 * some[1] > 8.0 * many[1]
    assert few[0] > 2.0 * many[0]
    assert many[0] < 2e-4
    assert many[1] < 2e-3  # of 0.33
