# SPDX-License-Identifier: Apache-2.0
"""Alignment against slow references, exact solutions, symmetries and its mean-field limit."""

from collections.abc import Callable
from dataclasses import replace
import math

from herding_ros.model import fast_forces
from herding_ros.model.alignment import Alignment
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import (
    alignment_rates,
    forces,
    relative_friction,
    reverse_sweep,
    rollout,
)
from herding_ros.model.expectation import mean_centre
from herding_ros.model.mean_field import mean_field
from herding_ros.model.noise import increments, noise_paths
from herding_ros.model.noise_field import NoiseField
from herding_ros.model.potentials import Morse
from herding_ros.model.sampling import FineModel
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

HerdMaker = Callable[..., HerdState]

NOTHING = Morse(repulsion=0.0, attraction=0.0)
ALIGNED = Crowd(alignment=Alignment(1.5, 0.3), noise=0.05)
ALONE = Crowd(sheep=NOTHING, dog=NOTHING, friction=0.0, noise=0.0, alignment=Alignment(1.5, 0.3))
STAND = np.zeros((1, 1, 2))


def slow_alignment(alignment: Alignment, x: Array, v: Array) -> Array:
    """The sum of the definition, pair by pair."""
    out = np.zeros_like(v)
    for i in range(len(x)):
        for j in range(len(x)):
            weight = math.exp(-0.5 * (math.dist(x[i], x[j]) / alignment.range) ** 2)
            out[i] += alignment.rate / len(x) * weight * (v[j] - v[i])
    return out


def slow_rollout(
    crowd: Crowd, start: HerdState, u: Array, dt: float, noise: Array
) -> tuple[Array, Array]:
    """Euler-Maruyama, one step for each entry of u; noise (steps, N, 2)."""
    x, v, d = [start.x], [start.v], start.d
    for k, velocities in enumerate(u):
        drift = forces(crowd, x[k], d) + slow_alignment(crowd.alignment, x[k], v[k])
        x.append(x[k] + dt * v[k])
        v.append(v[k] + dt * (drift - crowd.friction * v[k]) + noise[k])
        d = d + dt * velocities
    return np.array(x), np.array(v)


@pytest.mark.parametrize(('n', 'm'), [(1, 1), (2, 1), (8, 2), (11, 3)])
def test_rollout_is_euler_maruyama(random_herd: HerdMaker, n: int, m: int) -> None:
    state, rng, dt, steps = random_herd(n, m), np.random.default_rng(1), 0.02, 20
    u = rng.normal(0.0, 0.1, (steps, m, 2))
    noise = increments(rng, ALIGNED, n, dt, steps)
    found = rollout(ALIGNED, state, u, dt, 1, noise)
    x, v = slow_rollout(ALIGNED, state, u, dt, noise[:, :, :n].transpose(0, 2, 1))
    np.testing.assert_allclose(found.x, x, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.v, v, rtol=0, atol=1e-13)
    without = rollout(replace(ALIGNED, alignment=Alignment()), state, u, dt, 1, noise)
    assert n == 1 or np.abs(found.v - without.v).max() > 1e-3


@pytest.mark.parametrize('field', [NoiseField(), NoiseField(slope=(2.0, -1.0))])
@pytest.mark.parametrize('n', [2, 9])
def test_paths_at_once_are_single_ones(random_herd: HerdMaker, n: int, field: NoiseField) -> None:
    crowd, state = replace(ALIGNED, noise_field=field), random_herd(n, 2)
    u, dt, steps, paths = np.full((10, 2, 2), 0.05), 0.05, 20, 18
    noise = noise_paths(np.random.default_rng(0), crowd, n, dt, steps, paths)
    expected = np.mean(
        [rollout(crowd, state, u, dt, 2, noise.path(i)).x.mean(axis=1) for i in range(paths)],
        axis=0,
    )
    found = mean_centre(FineModel(crowd, state, dt, steps, 2), u, noise)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_it_moves_no_momentum_and_ends_all_relative_motion(random_herd: HerdMaker) -> None:
    state = random_herd(9, 1)
    crowd = replace(ALONE, alignment=Alignment(1.5, 1.0))
    v = rollout(crowd, state, STAND, 0.05, 200).v
    np.testing.assert_allclose(v.mean(axis=1) - v[0].mean(axis=0), 0.0, atol=1e-16)
    energy = np.square(v - v.mean(axis=1, keepdims=True)).sum(axis=(1, 2))
    assert (np.diff(energy) < 0.0).all()
    assert energy[-1] < 1e-3 * energy[0]


def test_a_flock_within_the_range_aligns_at_the_rate(random_herd: HerdMaker) -> None:
    """Then beta/N sum_j (v_j - v_i) = beta (mean v - v_i), and each step leaves 1 - h beta."""
    state, rate, dt, steps = random_herd(12, 1), 0.7, 0.05, 60
    crowd = replace(ALONE, alignment=Alignment(rate, 1e5))
    v = rollout(crowd, state, STAND, dt, steps).v
    mean = state.v.mean(axis=0)
    expected = mean + (1.0 - dt * rate) ** steps * (state.v - mean)
    np.testing.assert_allclose(v[-1], expected, rtol=0, atol=1e-9 * np.abs(state.v).max())


def test_sheep_beyond_the_range_do_not_align() -> None:
    x = np.array([[0.0, 0.0], [0.6, 0.0], [6.0, 0.0]])  # 2 and 20 ranges away
    state = HerdState(x, np.array([[0.0, 1.0], [0.0, -1.0], [0.0, 1.0]]), np.ones((1, 2)))
    v = rollout(ALONE, state, STAND, 1e-3).v[1] - state.v
    gained = 1e-3 * 1.5 / 3.0 * 2.0 * math.exp(-2.0)
    np.testing.assert_allclose(v[:, 1], [-gained, gained, 0.0], rtol=1e-12, atol=1e-60)


def test_it_is_the_same_in_all_frames_of_reference(random_herd: HerdMaker) -> None:
    """In one that moves, and in one that is turned; without friction, which rests in one."""
    crowd, state = replace(ALIGNED, friction=0.0), random_herd(9, 2)
    u, w, c, s = np.full((10, 2, 2), 0.03), np.array([0.2, -0.1]), math.cos(1.0), math.sin(1.0)
    turn = np.array([[c, s], [-s, c]])
    here = rollout(crowd, state, u, 0.05)
    moving = rollout(crowd, replace(state, v=state.v + w), u + w, 0.05)
    t = 0.05 * np.arange(11.0)[:, None, None]
    np.testing.assert_allclose(moving.x, here.x + w * t, rtol=0, atol=1e-13)
    turned = rollout(
        crowd, HerdState(*(p @ turn for p in (state.x, state.v, state.d))), u @ turn, 0.05
    )
    np.testing.assert_allclose(turned.x, here.x @ turn, rtol=0, atol=1e-13)


def test_rates_are_what_a_single_sheep_loses(random_herd: HerdMaker) -> None:
    state = random_herd(9, 1)
    expected = []
    for i in range(9):
        v = np.zeros((9, 2))
        v[i] = 1.0
        expected.append(-slow_alignment(ALIGNED.alignment, state.x, v)[i, 0])
    np.testing.assert_allclose(alignment_rates(ALIGNED, state.x), expected, rtol=1e-12)
    friction = ALIGNED.friction + np.mean(expected)
    assert relative_friction(ALIGNED, state.x) == pytest.approx(friction, rel=1e-12)
    assert relative_friction(Crowd(), state.x) == Crowd().friction


@pytest.mark.parametrize('alignment', [Alignment(2.0, 0.3), Alignment(15.0, 0.1)])
def test_limit_of_a_large_flock_aligns_as_the_flock_does(alignment: Alignment) -> None:
    """How much of its shear a flock has kept after 2 s."""
    x = np.random.default_rng(4).uniform(-0.4, 0.4, (1400, 2))
    state = HerdState(x, x @ np.array([[0.0, 1.0], [0.0, 0.0]]), np.full((1, 2), 9.0))

    def shear_left(crowd: Crowd, state: HerdState) -> float:
        end = rollout(crowd, state, STAND, 0.05, 40).at(-1)
        return float((state.x[:, 0] @ end.v[:, 1]) / (state.x[:, 0] @ state.v[:, 1]))

    crowd = replace(ALONE, alignment=alignment)
    flock = shear_left(crowd, state)
    errors = [abs(shear_left(*mean_field(crowd, state, count)) - flock) for count in (16, 64, 256)]
    assert 0.4 < flock < 0.9
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2]
    assert errors[2] < 0.003


@pytest.mark.parametrize('n', [fast_forces.CROSSOVER])
def test_large_flocks_align_as_small_ones(monkeypatch: pytest.MonkeyPatch, n: int) -> None:
    rng = np.random.default_rng(3)
    x, v = rng.uniform(-0.4, 0.4, (n, 2)), rng.normal(0.0, 0.05, (n, 2))
    state, u = HerdState(x, v, rng.uniform(0.5, 0.7, (2, 2))), np.full((2, 2, 2), -0.05)
    trajectory = rollout(ALIGNED, state, u, 0.02, 3)
    source = np.zeros_like(trajectory.xs)
    source[1:, :, :n] = rng.normal(size=(6, 2, n))
    fast = reverse_sweep(ALIGNED, trajectory, source)
    monkeypatch.setattr(fast_forces, 'CROSSOVER', 10**9)
    direct = rollout(ALIGNED, state, u, 0.02, 3)
    moved = np.linalg.norm(direct.v[-1] - direct.v[0])
    assert 0.0 < np.linalg.norm(trajectory.v[-1] - direct.v[-1]) < 1e-3 * moved
    expected = reverse_sweep(ALIGNED, trajectory, source)
    assert np.linalg.norm(fast - expected) < 1e-5 * np.linalg.norm(expected)


def test_without_inertia_there_is_nothing_to_align() -> None:
    with pytest.raises(
        ValueError, match=r'alignment.rate must be 0 where Crowd.order is 1, got 2'
    ):
        Crowd(order=1, alignment=Alignment(2.0))
    with pytest.raises(ValueError, match=r'Alignment.rate must be from 0 to 1e\+09, got -1'):
        Alignment(-1.0)
