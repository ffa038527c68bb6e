# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
from dataclasses import dataclass, replace
import math
from typing import Any

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.model import fast_forces, kernels
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import forces, physics, reverse_sweep, rollout
from herding_ros.model.expectation import mean_centre
from herding_ros.model.external_force import Form, register
from herding_ros.model.mean_field import mean_field
from herding_ros.model.motion import Holonomic
from herding_ros.model.noise import increments, noise_paths
from herding_ros.model.noise_field import NoiseField
from herding_ros.model.parameters import Parameters, quantity
from herding_ros.model.sampling import FineModel
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
from numba import typeof
import numpy as np
import pytest

HerdMaker = Callable[..., HerdState]


# What a file with a new force holds: its parameters, force and product.


@dataclass(frozen=True)
class Ripples(Parameters):
    """A hilly pasture: f = -grad W with W = height sin(wave x) cos(wave y)."""

    height: float = quantity(0.02, 'height', 'm^2/s^2')
    wave: float = quantity(5.0, 'wave number', '1/m')

    def kernel_form(self) -> Form:
        return FORM(self.height, self.wave)


def ripples_force(x, y, values):  # type: ignore[no-untyped-def]
    height, k = values
    h = height * k
    return (
        -h * math.cos(k * x) * math.cos(k * y),
        h * math.sin(k * x) * math.sin(k * y),
    )


def ripples_product(x, y, w_x, w_y, values):  # type: ignore[no-untyped-def]
    height, k = values
    h = height * k * k
    along = -h * math.sin(k * x) * math.cos(k * y)
    across = -h * math.cos(k * x) * math.sin(k * y)
    return along * w_x + across * w_y, across * w_x + along * w_y


FORM = register('ripples', ripples_force, ripples_product)

HILLS = Ripples()
CROWD = Crowd(external=HILLS, noise=0.03)
FLAT = replace(CROWD, external=Crowd().external)
DT = 0.05


def force_at(x: Array) -> Array:
    """The same with NumPy, (..., 2)."""
    h, (a, b) = HILLS.height * HILLS.wave, np.moveaxis(HILLS.wave * x, -1, 0)
    return h * np.stack([-np.cos(a) * np.cos(b), np.sin(a) * np.sin(b)], axis=-1)


def slow_rollout(state: HerdState, u: Array, substeps: int, noise: Array) -> Array:
    """Euler-Maruyama with forces that NumPy adds; noise (K, N, 2)."""
    x, v, d, xs = state.x, state.v, state.d, [state.x]
    for k, each in enumerate(noise):
        a = forces(FLAT, x, d) + force_at(x) - CROWD.friction * v
        x, v, d = x + DT * v, v + DT * a + each, d + DT * u[k // substeps]
        xs.append(x)
    return np.array(xs)


def test_force_acts_on_each_sheep_where_it_is(random_herd: HerdMaker) -> None:
    state, rng = random_herd(11, 2), np.random.default_rng(0)
    u = rng.normal(0.0, 0.05, (20, 2, 2))
    for crowd in (CROWD, replace(CROWD, noise_field=NoiseField(gust=0.0, slope=(1e-300, 0.0)))):
        noise = increments(rng, crowd, 11, DT, 40)
        found = rollout(crowd, state, u, DT, 2, noise)
        expected = slow_rollout(state, u, 2, noise[:, :, :11].transpose(0, 2, 1))
        np.testing.assert_allclose(found.x, expected, rtol=0, atol=1e-12)
        assert np.abs(found.x - rollout(FLAT, state, u, DT, 2, noise).x).max() > 0.05
        assert not found.xs[..., 11:].any()


def test_force_acts_in_each_path(random_herd: HerdMaker) -> None:
    state, u = random_herd(7, 2), np.full((20, 2, 2), 0.03)
    noise = noise_paths(np.random.default_rng(0), CROWD, 7, DT, 40, 20)
    each = [noise.path(i)[:, :, :7].transpose(0, 2, 1) for i in range(20)]
    expected = np.mean([slow_rollout(state, u, 2, one).mean(axis=1) for one in each], axis=0)
    found = mean_centre(FineModel(CROWD, state, DT, 40, 2), u, noise)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def assert_gradient(crowd: Crowd, state: HerdState, u: Array) -> None:
    """The Taylor remainder of a random cost of places falls with the square."""
    rng = np.random.default_rng(1)
    du, motion, n = rng.normal(size=u.shape), Holonomic(), len(state.x)
    trajectory = rollout(crowd, state, u, DT, 2)
    source = np.zeros_like(trajectory.xs)
    source[:, :, :n] = rng.normal(size=source[:, :, :n].shape)

    def cost(h: float) -> float:
        moved = rollout(crowd, state, u + h * du, DT, 2).xs - trajectory.xs
        return float((source * moved + 0.5 * np.square(moved)).sum())

    dogs = reverse_sweep(crowd, trajectory, source)
    slope = float((motion.transpose(trajectory.ds, u, dogs, DT, 2) * du).sum())
    rest = [abs(cost(h) - h * slope) for h in 5e-4 * 2.0 ** -np.arange(4.0)]
    assert np.log2(np.divide(rest[:-1], rest[1:])).min() > 1.9


def test_adjoint_passes_the_taylor_test(random_herd: HerdMaker) -> None:
    assert_gradient(CROWD, random_herd(9, 3), np.full((20, 3, 2), 0.03))


def test_sensitivity_of_the_centre_is_its_derivative(random_herd: HerdMaker) -> None:
    u, rng = np.full((20, 3, 2), 0.03), np.random.default_rng(1)
    coarse, du, h = CoarseModel(CROWD, random_herd(9, 3), DT, 2), rng.normal(size=u.shape), 1e-5
    there, back = (coarse.rollout(u + step * du).x.mean(axis=1) for step in (h, -h))
    linear = coarse.centre_sensitivity(u, 7)
    expected = linear.residual((there - back) / (2.0 * h))
    np.testing.assert_allclose(
        linear.times(du), expected, rtol=0, atol=1e-5 * np.abs(expected).max()
    )


def test_large_flocks_feel_it(monkeypatch: pytest.MonkeyPatch, random_herd: HerdMaker) -> None:
    """A flock of nine may be large, too."""
    state, u = random_herd(9, 3), np.full((20, 3, 2), 0.03)
    few = rollout(CROWD, state, u, DT, 2).x
    direct = fast_forces.DirectSum(CROWD.sheep, 9)
    monkeypatch.setattr(fast_forces, 'CROSSOVER', 1)
    monkeypatch.setattr(fast_forces, 'prepare', lambda *_: direct)
    np.testing.assert_allclose(rollout(CROWD, state, u, DT, 2).x, few, rtol=0, atol=1e-12)
    assert_gradient(CROWD, state, u)


def test_blobs_of_the_mean_field_limit_feel_it(random_herd: HerdMaker) -> None:
    crowd, blobs = mean_field(CROWD, random_herd(60, 2), 20)
    flat = replace(crowd, external=FLAT.external)
    here, there = (forces(each, blobs.x, blobs.d) for each in (crowd, flat))
    np.testing.assert_allclose(here - there, force_at(blobs.x), rtol=1e-12, atol=1e-15)


def test_the_simulated_flock_feels_it() -> None:
    world, goal = World(sheep=5, dogs=2, dt=DT, substeps=2), np.ones(2)
    ends = []
    for crowd in (CROWD, FLAT):
        simulation = Simulation(crowd, world, goal)
        for _ in range(20):
            simulation.advance(np.zeros((2, 2)))
        ends.append(simulation.state.x)
    assert np.abs(ends[0] - ends[1]).max() > 0.05


@pytest.mark.parametrize('returned', [None, (0.02, 5.0), np.zeros(2)])
def test_what_is_no_form_is_refused(returned: object) -> None:
    """Kernels would take it for no force at all."""

    class Forgetful:
        def kernel_form(self) -> Any:
            return returned

    with pytest.raises(
        ValueError, match=r'^Forgetful\.kernel_form must return what `register` made, got '
    ):
        physics(Crowd(external=Forgetful()), 3, 0.1)


def test_calls_of_kernels_ask_no_python_for_the_type_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def roll() -> None:
        x, d, noise = np.zeros((2, 2, 8)), np.zeros((2, 2, 1)), np.zeros((1, 2, 8))
        kernels.rollout(x, x.copy(), d, noise, physics(CROWD, 1, DT))

    roll()
    asked: list[object] = []
    monkeypatch.setattr(kernels.rollout, 'typeof_pyval', asked.append)
    roll()
    assert not asked


def test_a_force_that_moved_to_another_module_is_compiled_again() -> None:
    """What Numba has stored for it refers to the module by name, which may not exist any more."""

    def form_in(module: str) -> Form:
        def force(x, y, values):  # type: ignore[no-untyped-def]
            return 0.0, 0.0

        force.__module__ = module
        made = register('moved', force, ripples_product)()
        assert isinstance(made, Form)
        return made

    pasture, meadow = (typeof(form_in(module)) for module in ('pasture', 'meadow'))
    assert pasture == typeof(form_in('pasture')) != meadow
