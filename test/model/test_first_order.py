# SPDX-License-Identifier: Apache-2.0
"""Crowds without inertia, against slow references and exact solutions."""

from collections.abc import Callable
import dataclasses
import math

from herding_ros.model import fast_forces, kernels
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.dynamics import forces, reverse_sweep, rollout
from herding_ros.model.expectation import mean_centre
from herding_ros.model.kernels import PATHS
from herding_ros.model.mean_field import mean_field
from herding_ros.model.motion import Holonomic
from herding_ros.model.noise import increments, noise_paths
from herding_ros.model.noise_field import NoiseField
from herding_ros.model.potentials import Harmonic, Morse
from herding_ros.model.sampling import ESTIMATORS, FineModel, free, Resolution
from herding_ros.model.simulation import World
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

HerdMaker = Callable[..., HerdState]

NOTHING = Morse(repulsion=0.0, attraction=0.0)
CROWD = Crowd(order=1, friction=0.7, noise=0.05)
FREE = dataclasses.replace(CROWD, sheep=NOTHING, dog=NOTHING)
FIELD = NoiseField(slope=(2.0, -1.0), gust=0.9, period=0.7)


def slow_rollout(
    crowd: Crowd, start: HerdState, u: Array, dt: float, noise: Array, t: float = 0.0
) -> tuple[Array, Array]:
    """Euler-Maruyama of alpha x' = F + sigma f dB, one step for each entry of u."""
    x, v, d = [start.x], [start.v], start.d
    for k, velocities in enumerate(u):
        force = forces(crowd, x[k], d)
        kick = np.reshape(crowd.noise_field(t + k * dt, x[k]), (-1, 1)) * noise[k]
        x.append(x[k] + (dt * force + kick) / crowd.friction)
        v.append(force / crowd.friction)
        d = d + dt * velocities
    return np.array(x), np.array(v)


@pytest.mark.parametrize(('n', 'm', 'substeps'), [(1, 1, 1), (8, 2, 3), (11, 5, 4)])
@pytest.mark.parametrize('field', [NoiseField(), FIELD])
def test_rollout_is_euler_maruyama(
    random_herd: HerdMaker, n: int, m: int, substeps: int, field: NoiseField
) -> None:
    crowd, state = dataclasses.replace(CROWD, noise_field=field), random_herd(n, m)
    rng, dt, steps, t = np.random.default_rng(1), 0.02, 6 * substeps, 3.3
    u = rng.normal(0.0, 0.1, (6, m, 2))
    noise = increments(rng, crowd, n, dt, steps)
    found = rollout(crowd, state, u, dt, substeps, noise, t)
    drawn = noise[:, :, :n].transpose(0, 2, 1)
    x, v = slow_rollout(crowd, state, np.repeat(u, substeps, axis=0), dt, drawn, t)
    assert np.abs(x[-1] - x[0]).min() > 1e-5
    np.testing.assert_allclose(found.x, x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.v, v, rtol=0, atol=1e-12)


def test_it_is_the_limit_of_short_relaxation_times(random_herd: HerdMaker) -> None:
    """With mass m in m x'' = F - alpha x' the distance vanishes like m."""
    state, dt, steps, u = random_herd(6, 2), 1e-3, 1000, np.full((1, 2, 2), 0.05)
    limit = rollout(CROWD, state, u, dt, steps).x
    apart = []
    for mass in (0.02, 0.01, 0.005):
        heavy = dataclasses.replace(
            CROWD,
            order=2,
            friction=CROWD.friction / mass,
            sheep=scaled(CROWD.sheep, 1.0 / mass),
            dog=scaled(CROWD.dog, 1.0 / mass),
        )
        x = rollout(heavy, state, u, dt, steps).x
        # The velocity at the start is lost over a distance of v m / alpha.
        drift = mass * state.v / CROWD.friction
        apart.append(np.abs(x[-1] - limit[-1] - drift).max())
    np.testing.assert_allclose(np.divide(apart[:-1], apart[1:]), 2.0, rtol=0.1)
    assert apart[2] < 0.1 * np.abs(limit[-1] - limit[0]).max()


def scaled(p: Morse, factor: float) -> Morse:
    return dataclasses.replace(p, repulsion=factor * p.repulsion, attraction=factor * p.attraction)


def test_free_sheep_diffuse() -> None:
    """Var x = 2 D t with D = sigma^2 / (2 alpha^2), exactly for any time step."""
    n, dt, steps, paths = 200, 0.5, 20, 40
    start = HerdState(np.zeros((n, 2)), np.full((n, 2), 9.0), np.ones((1, 2)))
    rng, stand = np.random.default_rng(0), np.zeros((1, 1, 2))
    ends = np.concatenate(
        [
            rollout(FREE, start, stand, dt, steps, increments(rng, FREE, n, dt, steps)).x[-1]
            for _ in range(paths)
        ]
    )
    variance = (FREE.noise / FREE.friction) ** 2 * dt * steps
    many = 4.0 / math.sqrt(len(ends))
    np.testing.assert_allclose(ends.mean(axis=0), 0.0, atol=many * math.sqrt(variance))
    np.testing.assert_allclose(ends.var(axis=0), variance, rtol=many * math.sqrt(2.0))


def test_a_standing_dog_is_left_exponentially() -> None:
    """R - r decays with k / alpha; of the discrete scheme, exactly. Beyond R nothing moves."""
    crowd = Crowd(sheep=NOTHING, dog=Harmonic(0.3, 0.5), order=1, friction=0.6, noise=0.0)
    away, dt, steps = np.array([0.6, -0.8]), 0.05, 100
    start = HerdState(np.outer([0.1, 0.7], away), np.zeros((2, 2)), np.zeros((1, 2)))
    x = rollout(crowd, start, np.zeros((1, 1, 2)), dt, steps).x
    decay = (1.0 - dt * 0.3 / 0.6) ** np.arange(steps + 1)
    assert decay[-1] == pytest.approx(math.exp(-0.3 / 0.6 * dt * steps), rel=0.1)
    np.testing.assert_allclose(x[:, 0], np.outer(0.5 - 0.4 * decay, away), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(x[:, 1], x[0, 1] + np.zeros((steps + 1, 1)))


def test_independent_sheep_are_the_targets_of_lama_and_di_bernardo(
    random_herd: HerdMaker,
) -> None:
    """Each by itself: x' = beta sum (lambda - r) over dogs within lambda + sqrt(2 D) dB / dt."""
    crowd, state, dt, steps = CROWDS['independent'], random_herd(9, 3), 0.1, 60
    rng = np.random.default_rng(2)
    u, noise = rng.normal(0.0, 0.1, (steps, 3, 2)), increments(rng, crowd, 9, dt, steps)
    found = rollout(crowd, state, u, dt, 1, noise)
    beta, reach = Harmonic().stiffness / crowd.friction, Harmonic().reach
    assert beta * reach == World().max_speed
    x, d, near = state.x, state.d, 0
    for k in range(steps):
        moved = x + noise[k, :, :9].T / crowd.friction
        for i, m in np.ndindex(9, 3):
            r = math.dist(x[i], d[m])
            if r < reach:
                moved[i] += dt * beta * (reach - r) * (x[i] - d[m]) / r
                near += 1
        x, d = moved, d + dt * u[k]
    assert 0 < near < 27 * steps
    np.testing.assert_allclose(found.x[-1], x, rtol=0, atol=1e-8)


def test_velocity_has_no_effect(random_herd: HerdMaker) -> None:
    state, u = random_herd(5, 2), np.full((10, 2, 2), 0.02)
    still = dataclasses.replace(state, v=np.zeros_like(state.v))
    one, other = (rollout(CROWD, each, u, 0.05, 2) for each in (state, still))
    np.testing.assert_array_equal(one.x, other.x)
    np.testing.assert_array_equal(one.v[1:], other.v[1:])


@pytest.mark.parametrize('field', [NoiseField(), FIELD])
def test_many_paths_are_single_rollouts(random_herd: HerdMaker, field: NoiseField) -> None:
    crowd, state, dt, steps = (
        dataclasses.replace(CROWD, noise_field=field),
        random_herd(7, 2),
        0.05,
        20,
    )
    fine = FineModel(crowd, state, dt, steps, 2)
    u = np.random.default_rng(1).normal(0.0, 0.05, (steps // 2, 2, 2))
    noise = noise_paths(np.random.default_rng(2), crowd, 7, dt, steps, PATHS)
    expected = np.mean(
        [rollout(crowd, state, u, dt, 2, noise.path(i)).x.mean(axis=1) for i in range(PATHS)],
        axis=0,
    )
    np.testing.assert_allclose(mean_centre(fine, u, noise), expected, rtol=0, atol=1e-13)


def test_without_forces_the_free_centre_is_all_that_noise_does(random_herd: HerdMaker) -> None:
    fine, u = FineModel(FREE, random_herd(6, 2), 0.05, 20), np.zeros((20, 2, 2))
    noise = fine.draw(np.random.default_rng(0), 1)
    moved, quiet = (Resolution().sampler(fine, u)(each) for each in (noise, 0.0 * noise))
    variate = free(fine, u)(noise)
    assert np.abs(variate[-1]).min() > 1e-5
    np.testing.assert_allclose(moved - quiet, variate, rtol=0, atol=1e-14)


def test_multilevel_estimates_lie_close_together(random_herd: HerdMaker) -> None:
    """Much closer than the flock's centre itself: the control variate takes the rest."""
    fine, u = FineModel(CROWD, random_herd(6, 2), 0.05, 40, 2), np.full((20, 2, 2), 0.05)
    plain = Resolution().sampler(fine, u)(fine.draw(np.random.default_rng(3), 1))
    for level in ESTIMATORS['multilevel'].levels(fine):
        noise = fine.draw(np.random.default_rng(3), level.resolution.longer)
        values = level.sampler(u)(noise)
        assert values.var(axis=2).mean() < 0.02 * plain.var(axis=2).mean()


def test_large_flocks_move_alike(monkeypatch: pytest.MonkeyPatch, random_herd: HerdMaker) -> None:
    """Whoever takes the steps: the kernel, or Python around forces from a summation."""
    state, u = random_herd(30, 2), np.full((4, 2, 2), 0.03)
    noise = increments(np.random.default_rng(0), CROWD, 30, 0.02, 20)
    source = np.zeros((21, 2, 32))
    source[1:, :, :30] = np.random.default_rng(1).normal(size=(20, 2, 30))

    def both() -> tuple[Array, Array]:
        trajectory = rollout(CROWD, state, u, 0.02, 5, noise)
        return trajectory.x, reverse_sweep(CROWD, trajectory, source)

    small = both()
    monkeypatch.setattr(fast_forces, 'CROSSOVER', 20)
    for sweep in ('rollout', 'adjoint'):  # not to be called now
        monkeypatch.delattr(kernels, sweep)
    for one, other in zip(small, both(), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-3 * np.abs(one).max())


def test_reverse_sweep_of_a_large_flock_passes_the_taylor_test(
    monkeypatch: pytest.MonkeyPatch, random_herd: HerdMaker
) -> None:
    monkeypatch.setattr(fast_forces, 'CROSSOVER', 20)
    state, rng = random_herd(30, 2), np.random.default_rng(5)
    u, du = rng.normal(0.0, 0.05, (2, 4, 2, 2))

    def cost(u: Array) -> float:
        return float(0.5 * np.square(rollout(CROWD, state, u, 0.05, 5).x - 0.3).sum())

    trajectory = rollout(CROWD, state, u, 0.05, 5)
    source = np.zeros_like(trajectory.xs)
    source[:, :, :30] = trajectory.xs[:, :, :30] - 0.3
    path = reverse_sweep(CROWD, trajectory, source)
    slope = float((Holonomic().transpose(trajectory.ds, u, path, 0.05, 5) * du).sum())
    steps = 0.5 ** np.arange(3, 7)
    rest = np.array([abs(cost(u + h * du) - cost(u) - h * slope) for h in steps])
    assert np.log2(rest[:-1] / rest[1:]).min() > 1.9


def test_mean_field_limit_has_no_inertia_either(random_herd: HerdMaker) -> None:
    """Its centre is the flock's: dogs far off in the flock's own length push all alike."""
    state, u = random_herd(300, 2), np.full((20, 2, 2), 0.02)
    state = dataclasses.replace(state, d=state.d + 1.0)
    quiet = dataclasses.replace(CROWD, noise=0.0)
    crowd, blobs = mean_field(quiet, state, 48)
    assert crowd.order == 1
    flock, few = (
        rollout(*each, u, 0.05, 2).x.mean(axis=1) for each in ((quiet, state), (crowd, blobs))
    )
    moved = np.abs(flock[-1] - flock[0]).max()
    assert moved > 1e-3
    np.testing.assert_allclose(few, flock, rtol=0, atol=0.01 * moved)


def test_without_inertia_there_has_to_be_friction() -> None:
    with pytest.raises(ValueError, match=r'Crowd.friction must be above 0 .* got 0'):
        Crowd(order=1, friction=0.0)
    with pytest.raises(ValueError, match=r'Crowd.order must be from 1 to 2, got 3'):
        Crowd(order=3)
