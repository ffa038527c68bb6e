# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
import dataclasses
import itertools
import math

from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.dynamics import forces, rollout
from herding_ros.model.noise import increments
from herding_ros.model.potentials import Morse
from herding_ros.model.scenario import initial_herd
from herding_ros.model.state import Array, HerdState
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp

HerdMaker = Callable[..., HerdState]

NOTHING = Morse(repulsion=0.0, attraction=0.0)
QUIET = dataclasses.replace(CROWDS['cohesive'], noise=0.0)
# Crowds without inertia are those of test_first_order.py, those that align of test_alignment.py.
OF_THE_PAPER = [n for n, crowd in CROWDS.items() if crowd.order == 2 and not crowd.alignment.rate]
presets = pytest.mark.parametrize('preset', OF_THE_PAPER)


def potential(r: float, p: Morse) -> float:
    repulsion = p.repulsion * math.exp(-r / p.repulsion_length)
    return repulsion - p.attraction * math.exp(-r / p.attraction_length)


def slope(r: float, p: Morse) -> float:
    repulsion = p.repulsion / p.repulsion_length * math.exp(-r / p.repulsion_length)
    return p.attraction / p.attraction_length * math.exp(-r / p.attraction_length) - repulsion


def slow_forces(crowd: Crowd, x: Array, d: Array) -> Array:
    """The interaction terms of the paper's state system, pair by pair."""
    out = np.zeros_like(x)
    for i in range(len(x)):
        for others, p, weight in ((x, crowd.sheep, 1.0 / len(x)), (d, crowd.dog, 1.0)):
            for other in others:
                s = x[i] - other
                r = math.hypot(*s)
                if r > 0.0:
                    out[i] -= weight * slope(r, p) * s / r
    return out


def slow_rollout(
    crowd: Crowd, start: HerdState, u: Array, dt: float, noise: Array
) -> tuple[Array, Array, Array]:
    """Euler-Maruyama, one step for each entry of u; noise (steps, N, 2)."""
    x, v, d = [start.x], [start.v], [start.d]
    for k in range(len(u)):
        drift = slow_forces(crowd, x[k], d[k]) - crowd.friction * v[k]
        x.append(x[k] + dt * v[k])
        v.append(v[k] + dt * drift + noise[k])
        d.append(d[k] + dt * u[k])
    return np.array(x), np.array(v), np.array(d)


def rotated(points: Array, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


@presets
@given(n=st.integers(1, 17), m=st.integers(1, 5), seed=st.integers(0, 2**32))
def test_forces_are_those_of_the_paper(
    random_herd: HerdMaker, preset: str, n: int, m: int, seed: int
) -> None:
    state, crowd = random_herd(n, m, seed), CROWDS[preset]
    expected = slow_forces(crowd, state.x, state.d)
    np.testing.assert_allclose(
        forces(crowd, state.x, state.d), expected, rtol=1e-12, atol=1e-14 * (1 + m)
    )


@presets
def test_forces_are_minus_the_gradient_of_the_energy(random_herd: HerdMaker, preset: str) -> None:
    crowd, state, h = CROWDS[preset], random_herd(6, 3), 1e-6

    def energy(x: Array) -> float:
        pairs = sum(
            potential(math.dist(a, b), crowd.sheep) for a, b in itertools.combinations(x, 2)
        )
        to_dogs = sum(potential(math.dist(a, b), crowd.dog) for a in x for b in state.d)
        return pairs / len(x) + to_dogs

    expected = np.zeros_like(state.x)
    for index in np.ndindex(state.x.shape):
        there, back = state.x.copy(), state.x.copy()
        there[index] += h
        back[index] -= h
        expected[index] = -(energy(there) - energy(back)) / (2.0 * h)
    np.testing.assert_allclose(forces(crowd, state.x, state.d), expected, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize('preset', ['cohesive'])
@pytest.mark.parametrize('n', [2, 7, 8, 9, 17])
def test_pair_forces_balance(random_herd: HerdMaker, preset: str, n: int) -> None:
    crowd = dataclasses.replace(CROWDS[preset], dog=NOTHING)
    state = random_herd(n, 1)
    found = forces(crowd, state.x, state.d)
    assert np.abs(found).max() > 1e-5  # there are forces to balance
    assert np.abs(found.sum(axis=0)).max() <= 1e-14 * n * max(1.0, np.abs(found).max())


@presets
def test_coincident_sheep_and_dogs_exert_no_force(preset: str) -> None:
    crowd, far = CROWDS[preset], np.array([[300.0, 0.0]])
    together = np.full((3, 2), 0.1)
    assert np.abs(forces(crowd, together, far)).max() < 1e-60
    assert not forces(crowd, together[:1], together[:1]).any()


@presets
def test_coincident_sheep_still_feel_the_others(preset: str) -> None:
    crowd, d = CROWDS[preset], np.array([[0.5, 0.2]])
    x = np.array([[0.1, 0.1], [0.1, 0.1], [0.13, 0.1]])
    found = forces(crowd, x, d)
    np.testing.assert_allclose(found, slow_forces(crowd, x, d), rtol=1e-12)
    np.testing.assert_array_equal(found[0], found[1])


@presets
@pytest.mark.parametrize(('n', 'm', 'substeps'), [(1, 1, 1), (8, 2, 3), (11, 5, 4)])
def test_rollout_is_euler_maruyama(
    random_herd: HerdMaker, preset: str, n: int, m: int, substeps: int
) -> None:
    crowd, state = dataclasses.replace(CROWDS[preset], noise=0.05), random_herd(n, m)
    rng = np.random.default_rng(1)
    u, dt, steps = rng.normal(0.0, 0.1, (6, m, 2)), 0.02, 6 * substeps
    noise = increments(rng, crowd, n, dt, steps)
    found = rollout(crowd, state, u, dt, substeps, noise)
    real_noise = noise[:, :, :n].transpose(0, 2, 1)
    x, v, d = slow_rollout(crowd, state, np.repeat(u, substeps, axis=0), dt, real_noise)
    np.testing.assert_allclose(found.x, x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.v, v, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.d, d, rtol=0, atol=1e-14)


def test_without_noise_the_fine_model_is_the_coarse_one(random_herd: HerdMaker) -> None:
    state, u = random_herd(9, 2), np.full((50, 2, 2), 0.03)
    noise = increments(np.random.default_rng(0), QUIET, 9, 0.01, 50)
    fine, coarse = (rollout(QUIET, state, u, 0.01, 1, each) for each in (noise, None))
    np.testing.assert_array_equal(fine.x, coarse.x)
    np.testing.assert_array_equal(fine.v, coarse.v)


@presets
def test_rollout_converges_to_the_solution_at_first_order(preset: str) -> None:
    crowd = dataclasses.replace(CROWDS[preset], noise=0.0)
    x = np.stack(np.meshgrid([-0.2, 0.0, 0.2], [-0.15, 0.15]), axis=-1).reshape(-1, 2)
    start = HerdState(x, 0.02 * np.flip(x, axis=1), np.array([[0.5, 0.4], [-0.5, 0.1]]))
    n, t_end = len(x), 2.0
    u = np.array([[-0.1, -0.05], [0.1, 0.02]])

    def right_hand_side(t: float, y: Array) -> Array:
        x, v = y.reshape(2, n, 2)
        return np.concatenate(
            [v, slow_forces(crowd, x, start.d + t * u) - crowd.friction * v]
        ).ravel()

    exact = solve_ivp(
        right_hand_side, (0.0, t_end), np.concatenate([start.x, start.v]).ravel(),
        method='DOP853', rtol=1e-10, atol=1e-12,
    ).y[:, -1].reshape(2, n, 2)  # fmt: skip
    errors = []
    for steps in (100, 200, 400, 800):
        end = rollout(crowd, start, np.tile(u, (steps, 1, 1)), t_end / steps).at(-1)
        errors.append(np.abs(np.stack([end.x, end.v]) - exact).max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert errors[0] > 1e-5  # far above the error of the reference
    np.testing.assert_allclose(orders, 1.0, atol=0.05)


def test_free_sheep_follow_the_ornstein_uhlenbeck_law() -> None:
    alpha, sigma, t, steps, paths, n = 0.5, 0.2, 2.0, 200, 800, 16
    crowd = Crowd(sheep=NOTHING, dog=NOTHING, friction=alpha, noise=sigma)
    x0, v0 = np.array([1.0, -2.0]), np.array([0.3, -0.1])
    start = HerdState(np.tile(x0, (n, 1)), np.tile(v0, (n, 1)), np.zeros((1, 2)))
    rng, dt, stand = np.random.default_rng(7), t / steps, np.zeros((1, 1, 2))
    ends = [
        rollout(crowd, start, stand, dt, steps, increments(rng, crowd, n, dt, steps)).at(-1)
        for _ in range(paths)
    ]
    x, v = np.concatenate([e.x for e in ends]), np.concatenate([e.v for e in ends])

    decay = math.exp(-alpha * t)
    var_v = sigma**2 * (1.0 - decay**2) / (2.0 * alpha)
    var_x = (sigma / alpha) ** 2 * (
        t - 2.0 * (1.0 - decay) / alpha + (1.0 - decay**2) / (2.0 * alpha)
    )
    covariance = (sigma * (1.0 - decay) / alpha) ** 2 / 2.0
    # Four standard errors, and the bias of Euler's scheme: of relative size alpha dt.
    bias, many = alpha * dt, 4.0 / math.sqrt(len(x))
    mean_x, mean_v = x0 + v0 * (1.0 - decay) / alpha, v0 * decay
    atol_x, atol_v = many * math.sqrt(var_x), many * math.sqrt(var_v)
    np.testing.assert_allclose(x.mean(axis=0) - x0, mean_x - x0, rtol=bias, atol=atol_x)
    np.testing.assert_allclose(v.mean(axis=0), mean_v, rtol=bias, atol=atol_v)
    rtol = bias + many * math.sqrt(2.0)
    np.testing.assert_allclose(x.var(axis=0), var_x, rtol=rtol)
    np.testing.assert_allclose(v.var(axis=0), var_v, rtol=rtol)
    found = ((x - x.mean(axis=0)) * (v - v.mean(axis=0))).mean(axis=0)
    np.testing.assert_allclose(
        found, covariance, rtol=bias, atol=many * math.sqrt(var_x * var_v + covariance**2)
    )
    across = np.corrcoef(np.concatenate([x, v], axis=1).T)[np.ix_([0, 2], [1, 3])]
    assert np.abs(across).max() < many  # nothing couples the two coordinates


@presets
def test_rollout_commutes_with_moving_the_world(random_herd: HerdMaker, preset: str) -> None:
    crowd, state, angle = CROWDS[preset], random_herd(11, 3), 2.1
    rng = np.random.default_rng(0)
    u, shift = rng.normal(0.0, 0.05, (100, 3, 2)), np.array([3.0, -1.5])
    noise = increments(rng, crowd, 11, 0.01, 100)
    turned_noise = np.zeros_like(noise)
    turned_noise[:, :, :11] = rotated(noise[:, :, :11].transpose(0, 2, 1), angle).transpose(
        0, 2, 1
    )
    here = rollout(crowd, state, u, 0.01, 1, noise)
    moved = HerdState(
        rotated(state.x, angle) + shift, rotated(state.v, angle), rotated(state.d, angle) + shift
    )
    there = rollout(crowd, moved, rotated(u, angle), 0.01, 1, turned_noise)
    for a, b in ((here.x, there.x), (here.d, there.d)):
        np.testing.assert_allclose(rotated(a, angle) + shift, b, rtol=0, atol=1e-11)
    np.testing.assert_allclose(rotated(here.v, angle), there.v, rtol=0, atol=1e-11)


def test_order_of_sheep_and_dogs_does_not_matter(random_herd: HerdMaker) -> None:
    state, rng = random_herd(13, 4), np.random.default_rng(3)
    sheep, dogs = rng.permutation(13), rng.permutation(4)
    u = rng.normal(0.0, 0.05, (100, 4, 2))
    mixed = HerdState(state.x[sheep], state.v[sheep], state.d[dogs])
    expected = rollout(QUIET, state, u, 0.01).x[:, sheep]
    found = rollout(QUIET, mixed, u[:, dogs], 0.01).x
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@presets
@pytest.mark.parametrize('friction', [0.0, 0.5])
def test_without_dogs_momentum_only_rubs_off(
    random_herd: HerdMaker, preset: str, friction: float
) -> None:
    crowd = dataclasses.replace(CROWDS[preset], dog=NOTHING, friction=friction)
    state, dt, steps = random_herd(9, 1), 0.01, 300
    momentum = rollout(crowd, state, np.zeros((1, 1, 2)), dt, steps).v.sum(axis=1)
    expected = state.v.sum(axis=0) * (1.0 - friction * dt) ** np.arange(steps + 1)[:, None]
    np.testing.assert_allclose(momentum, expected, rtol=0, atol=1e-11)


def test_one_sheep_between_two_symmetric_dogs_stays() -> None:
    crowd = dataclasses.replace(QUIET, friction=0.0)
    goal, p = np.array([0.5, 0.5]), np.array([0.3, -0.1])
    start = HerdState(goal[None], np.zeros((1, 2)), np.array([goal + p, goal - p]))
    towards = np.random.default_rng(0).normal(0.0, 0.05, (2000, 1, 2))
    for moves in (0.0, 1.0):
        u = moves * np.concatenate([towards, -towards], axis=1)
        assert np.abs(rollout(crowd, start, u, 0.01).x - goal).max() <= 1e-12


def test_symmetric_herd_keeps_its_centre() -> None:
    crowd = dataclasses.replace(QUIET, friction=0.0)
    rng, goal = np.random.default_rng(4), np.array([0.5, 0.5])
    half_x, half_d = rng.uniform(-0.4, 0.4, (5, 2)), rng.uniform(-0.7, 0.7, (3, 2))
    half_u = rng.normal(0.0, 0.05, (500, 3, 2))
    start = HerdState(
        goal + np.concatenate([half_x, -half_x]),
        np.zeros((10, 2)),
        goal + np.concatenate([half_d, -half_d]),
    )
    found = rollout(crowd, start, np.concatenate([half_u, -half_u], axis=1), 0.01).x
    assert np.abs(found[-1] - found[0]).max() > 0.05  # the sheep do move
    assert np.abs(found.mean(axis=1) - goal).max() <= 1e-11


def test_printed_crowd_explodes_and_cohesive_one_does_not() -> None:
    goal, growth = np.array([0.5, 0.5]), {}
    start = initial_herd(30, 5, goal, np.random.default_rng(0))
    for name, crowd in CROWDS.items():
        x = rollout(crowd, start, np.zeros((1, 5, 2)), 0.01, 2000).x[[0, -1]]
        radius = np.linalg.norm(x - x.mean(axis=1, keepdims=True), axis=-1).mean(axis=1)
        growth[name] = radius[1] / radius[0]
    assert growth['printed'] > 5.0
    assert growth['cohesive'] < 1.5


@pytest.mark.parametrize('dt', [0.0, -0.01, math.nan, math.inf])
def test_bad_time_step_is_refused(random_herd: HerdMaker, dt: float) -> None:
    with pytest.raises(ValueError, match='time step dt must be'):
        rollout(QUIET, random_herd(2, 1), np.zeros((1, 1, 2)), dt)


@pytest.mark.parametrize('u', [np.zeros((4, 2)), np.zeros((4, 3, 2)), np.full((4, 2, 2), np.nan)])
def test_bad_control_is_refused(random_herd: HerdMaker, u: Array) -> None:
    with pytest.raises(ValueError, match='control u'):
        rollout(QUIET, random_herd(2, 2), u, 0.01)


def test_noise_of_the_wrong_length_is_refused(random_herd: HerdMaker) -> None:
    with pytest.raises(ValueError, match='noise must have shape'):
        rollout(QUIET, random_herd(2, 1), np.zeros((4, 1, 2)), 0.01, 2, np.zeros((4, 2, 8)))
