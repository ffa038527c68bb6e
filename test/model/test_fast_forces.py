# SPDX-License-Identifier: Apache-2.0
from concurrent.futures import ThreadPoolExecutor
import os

from herding_ros.model import fast_forces, kernels
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.dynamics import forces, reverse_sweep, rollout, to_lanes
from herding_ros.model.fast_forces import CROSSOVER, DirectSum, prepare, summation
from herding_ros.model.motion import Holonomic
from herding_ros.model.noise import increments
from herding_ros.model.noise_field import NoiseField
from herding_ros.model.particle_mesh import ParticleMesh
from herding_ros.model.potentials import Potential, PowerLaw, Tabulated
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

COHESIVE = CROWDS['cohesive'].sheep
R = np.linspace(0.0, 1.0, 30)
TABLE = Tabulated(tuple(R), tuple(0.01 * np.exp(-R / 0.1) - 1e-3 * np.exp(-R)))
MANY = 3000
SQUARE = np.random.default_rng(0).uniform(-0.4, 0.4, (MANY, 2))


def lattice() -> Array:
    """A flock nearly at rest: forces that are small against those of each pair."""
    side = np.arange(60) * 0.0137
    x = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    return x + 1e-4 * np.random.default_rng(1).standard_normal(x.shape)


def with_one_far_away() -> Array:
    return np.concatenate([SQUARE, [[100.0, -3.0]]])


FLOCKS = {
    'square': SQUARE,
    'line': SQUARE * [5.0, 0.01],
    'Gaussian': 0.2 * np.random.default_rng(2).standard_normal((MANY, 2)),
    'two flocks': SQUARE + np.where(np.arange(MANY) % 3 == 0, 4.0, 0.0)[:, None],
    'lattice': lattice(),
    'one far away': with_one_far_away(),
    'couples': np.repeat(SQUARE[: MANY // 2], 2, axis=0),
}


def error(sums: ParticleMesh | DirectSum, potential: Potential, x: Array) -> float:
    """Relative error of all forces."""
    exact = DirectSum(potential, len(x)).gradients(to_lanes(x))
    found = sums.gradients(to_lanes(x))
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


@pytest.mark.parametrize(
    ('name', 'accuracy'), [*((name, 1e-4) for name in FLOCKS), ('square', 1e-6)]
)
def test_mesh_keeps_its_accuracy(name: str, accuracy: float) -> None:
    x = FLOCKS[name]
    sums = prepare(COHESIVE, to_lanes(x), len(x), accuracy)
    assert error(sums, COHESIVE, x) <= accuracy
    if name == 'square':
        assert isinstance(sums, ParticleMesh)


@pytest.mark.parametrize('potential', [CROWDS['printed'].sheep, PowerLaw(), TABLE])
def test_mesh_keeps_its_accuracy_for_any_potential(potential: Potential) -> None:
    sums = prepare(potential, to_lanes(SQUARE), MANY)
    assert isinstance(sums, ParticleMesh)
    assert error(sums, potential, SQUARE) <= fast_forces.ACCURACY


def test_more_accuracy_takes_a_finer_mesh() -> None:
    coarse, fine = (prepare(COHESIVE, to_lanes(SQUARE), MANY, a) for a in (1e-3, 1e-6))
    assert isinstance(coarse, ParticleMesh)
    assert isinstance(fine, ParticleMesh)
    assert error(fine, COHESIVE, SQUARE) < 0.1 * error(coarse, COHESIVE, SQUARE)


def test_memory_is_bounded_however_far_sheep_are() -> None:
    x = np.concatenate([SQUARE, [[1e6, 1e6]]])
    sums = prepare(COHESIVE, to_lanes(x), len(x))
    if isinstance(sums, ParticleMesh):
        assert np.prod(sums.padded) <= 5000**2
    assert error(sums, COHESIVE, x) <= fast_forces.ACCURACY


@pytest.mark.parametrize('place', [0.3, np.nan, np.inf])
def test_flock_in_one_place_or_lost_is_summed_directly(place: float) -> None:
    x = np.full((MANY, 2), place)
    assert isinstance(prepare(COHESIVE, to_lanes(x), MANY), DirectSum)


def test_summation_depends_on_the_past_only() -> None:
    xs = np.stack([to_lanes(SQUARE * (1.0 + 0.01 * k)) for k in range(40)])
    now = [each(k, x) for each in [summation(COHESIVE, MANY)] for k, x in enumerate(xs)]
    assert all(sums.holds(x) for sums, x in zip(now, xs, strict=True))
    assert now[0] is now[1]  # not a new one at every step
    assert now[0] is not now[10]  # the flock has left the box
    again = summation(COHESIVE, MANY)
    for k, sums in enumerate(now[:20]):
        other = again(k, xs[k])
        assert (sums.reach, sums.spacing) == (other.reach, other.spacing)  # type: ignore[union-attr]


def herd(n: int) -> HerdState:
    rng = np.random.default_rng(3)
    x, v = rng.uniform(-0.4, 0.4, (n, 2)), 0.02 * rng.standard_normal((n, 2))
    return HerdState(x, v, rng.uniform(0.5, 0.7, (2, 2)))


def test_forces_below_the_crossover_are_the_direct_sum_to_the_bit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    state = herd(CROSSOVER - 1)
    monkeypatch.setattr(fast_forces, 'prepare', None)
    few = forces(Crowd(), state.x, state.d)
    monkeypatch.setattr(fast_forces, 'CROSSOVER', 10**9)
    np.testing.assert_array_equal(few, forces(Crowd(), state.x, state.d))


@pytest.mark.parametrize('accuracy', [1e-4, 1e-6])
def test_forces_above_it_are_the_direct_sum_to_the_accuracy(
    monkeypatch: pytest.MonkeyPatch, accuracy: float
) -> None:
    state = herd(2 * CROSSOVER)
    found = forces(Crowd(), state.x, state.d, accuracy)
    monkeypatch.setattr(fast_forces, 'CROSSOVER', 10**9)
    exact = forces(Crowd(), state.x, state.d)
    apart = np.linalg.norm(found - exact)
    assert 0.0 < apart <= accuracy * np.linalg.norm(exact)


def test_rollout_follows_the_direct_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over a time in which neighbours do not change places: a flock is chaotic."""
    crowd, state, u = Crowd(), herd(CROSSOVER), np.full((4, 2, 2), -0.05)
    noise = increments(np.random.default_rng(0), crowd, CROSSOVER, 0.01, 40)
    fast = rollout(crowd, state, u, 0.01, 10, noise)
    monkeypatch.setattr(fast_forces, 'CROSSOVER', 10**9)
    direct = rollout(crowd, state, u, 0.01, 10, noise)
    moved = np.linalg.norm(direct.x[-1] - direct.x[0] - 0.4 * state.v)
    assert np.linalg.norm(fast.x[-1] - direct.x[-1]) < 1e-4 * moved
    np.testing.assert_array_equal(fast.d, direct.d)
    assert not fast.xs[:, :, CROSSOVER:].any()


def test_rollout_repeats_bit_for_bit_on_any_number_of_cores(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    crowd, state, u = Crowd(), herd(CROSSOVER), np.full((1, 2, 2), -0.05)
    ends = []
    for cores in (1, 2):
        monkeypatch.setattr(os, 'cpu_count', lambda cores=cores: cores)
        ends.append(rollout(crowd, state, u, 0.01, 5).xs)
    np.testing.assert_array_equal(ends[0], ends[1])


def cost(crowd: Crowd, state: HerdState, u: Array, weights: Array, substeps: int) -> float:
    x = rollout(crowd, state, u, 0.05, substeps).x
    return float(0.5 * (weights * np.square(x - 0.3)).sum())


@pytest.mark.parametrize('name', ['cohesive'])
def test_reverse_sweep_passes_the_taylor_test(name: str) -> None:
    """With the forces that the rollout took, errors and all."""
    crowd, state, rng = CROWDS[name], herd(CROSSOVER), np.random.default_rng(5)
    substeps, u = 20, rng.normal(0.0, 0.05, (2, 2, 2))
    du = rng.normal(0.0, 0.05, u.shape)
    weights = rng.uniform(0.0, 1.0, (41, CROSSOVER, 1))
    trajectory = rollout(crowd, state, u, 0.05, substeps)
    source = np.zeros_like(trajectory.xs)
    source[:, :, :CROSSOVER] = (weights * (trajectory.x - 0.3)).transpose(0, 2, 1)
    path = reverse_sweep(crowd, trajectory, source)
    gradient = Holonomic().transpose(trajectory.ds, u, path, 0.05, substeps)
    here, slope = cost(crowd, state, u, weights, substeps), float((gradient * du).sum())
    steps = 0.5 ** np.arange(6, 10)
    rest = [
        abs(cost(crowd, state, u + h * du, weights, substeps) - here - h * slope) for h in steps
    ]
    assert np.log2(np.divide(rest[:-1], rest[1:])).min() > 1.9


def test_reverse_sweep_agrees_with_the_direct_one(monkeypatch: pytest.MonkeyPatch) -> None:
    crowd, state = Crowd(), herd(CROSSOVER)
    u, rng = np.full((3, 2, 2), -0.03), np.random.default_rng(6)
    trajectory = rollout(crowd, state, u, 0.02, 5)
    source = np.zeros_like(trajectory.xs)
    source[1:, :, :CROSSOVER] = rng.normal(size=(15, 2, CROSSOVER))
    fast = reverse_sweep(crowd, trajectory, source)
    monkeypatch.setattr(fast_forces, 'CROSSOVER', 10**9)
    direct = reverse_sweep(crowd, trajectory, source)
    assert np.linalg.norm(fast - direct) < 1e-5 * np.linalg.norm(direct)
    assert (fast != direct).any()


def test_noise_field_acts_as_in_a_small_flock(monkeypatch: pytest.MonkeyPatch) -> None:
    field = NoiseField(slope=(1.0, 0.5), gust=0.5)
    crowd, state, u = Crowd(noise_field=field), herd(CROSSOVER), np.zeros((1, 2, 2))
    noise = increments(np.random.default_rng(0), crowd, CROSSOVER, 0.01, 3)
    fast = rollout(crowd, state, u, 0.01, 3, noise)
    monkeypatch.setattr(fast_forces, 'CROSSOVER', 10**9)
    direct = rollout(crowd, state, u, 0.01, 3, noise)
    np.testing.assert_allclose(fast.v, direct.v, rtol=0, atol=1e-6)
    uniform = rollout(Crowd(), state, u, 0.01, 3, noise)
    assert np.abs(direct.v - uniform.v).max() > 1e-3


def test_direct_sum_is_the_sum() -> None:
    x, mu = to_lanes(SQUARE[:50]), to_lanes(SQUARE[50:100])
    sums = DirectSum(COHESIVE, 50)
    s = x[:, :50, None] - x[:, None, :50]
    r = np.hypot(*s)
    np.fill_diagonal(r, 1.0)
    exact = (COHESIVE.derivative(r) / r * s).sum(axis=2) / 50
    np.testing.assert_allclose(sums.gradients(x)[:, :50], exact, rtol=1e-10, atol=1e-13)
    h = 1e-7
    apart = (sums.gradients(x + h * mu) - sums.gradients(x - h * mu)) / (2.0 * h)
    found = sums.hessian_products(x, mu)
    np.testing.assert_allclose(found, apart, rtol=0, atol=1e-6 * np.abs(apart).max())
    assert kernels.lanes(50) == x.shape[1]


def test_pool_or_map_makes_no_difference() -> None:
    x = to_lanes(SQUARE)
    with ThreadPoolExecutor(2) as pool:
        one, two = prepare(COHESIVE, x, MANY), prepare(COHESIVE, x, MANY, run=pool.map)
        np.testing.assert_array_equal(one.gradients(x), two.gradients(x))
