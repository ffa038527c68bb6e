# SPDX-License-Identifier: Apache-2.0
from concurrent.futures import ThreadPoolExecutor

from herding_ros.model import kernels
from herding_ros.model.crowd import CROWDS
from herding_ros.model.particle_mesh import ParticleMesh, split
from herding_ros.model.potentials import Morse, Potential, PowerLaw
from herding_ros.model.state import Array
import numpy as np
import pytest

COHESIVE = CROWDS['cohesive'].sheep
POTENTIALS = [COHESIVE, CROWDS['printed'].sheep, PowerLaw()]
N = 400


def lanes(x: Array) -> Array:
    """Positions (n, 2) as the kernels want them."""
    out = np.zeros((2, kernels.lanes(len(x))))
    out[:, : len(x)] = x.T
    return out


def flock(n: int = N, seed: int = 0) -> Array:
    return lanes(np.random.default_rng(seed).uniform([-0.5, 0.1], [0.5, 0.7], (n, 2)))


def mesh(
    potential: Potential, n: int = N, reach: float = 0.1, ratio: float = 10.0
) -> ParticleMesh:
    low, extent = np.array([-0.52, 0.08]), np.array([1.04, 0.64])
    return ParticleMesh(potential, n, low, extent, reach, reach / ratio)


def slow_gradients(p: Potential, x: Array, n: int) -> Array:
    """1/n sum_j grad P(x_i - x_j), all pairs at once."""
    s = x[:, :n, None] - x[:, None, :n]
    r = np.hypot(*s)
    r[r == 0.0] = 1.0  # no direction, no force
    return (p.derivative(r) / r * s).sum(axis=2) / n


def error(found: Array, expected: Array) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


@pytest.mark.parametrize('p', POTENTIALS)
@pytest.mark.parametrize('reach', [0.02, 0.06])
def test_near_and_smooth_slopes_are_the_potentials(p: Potential, reach: float) -> None:
    near, smooth = split(p, reach)
    r = np.linspace(1e-4, reach, 200)
    z = r / reach
    slope = np.polynomial.Polynomial(near)(r) + 2.0 * z / reach * smooth.deriv()(z * z)
    scale = np.abs(p.derivative(r)).max()
    np.testing.assert_allclose(slope, p.derivative(r), rtol=0, atol=3e-8 * scale)


@pytest.mark.parametrize('p', POTENTIALS)
def test_smooth_part_joins_the_potential(p: Potential) -> None:
    """Value and seven derivatives: the difference grows like the eighth power."""
    reach = 0.05
    _, smooth = split(p, reach)
    np.testing.assert_allclose(smooth(1.0), p.value(np.array(reach)), rtol=1e-12)
    apart = [
        abs(float(smooth((1.0 - t) ** 2) - p.value(np.array(reach * (1.0 - t)))))
        for t in (0.2, 0.1)
    ]
    assert np.log2(apart[0] / apart[1]) > 7.0


@pytest.mark.parametrize('p', POTENTIALS)
@pytest.mark.parametrize(('ratio', 'bound'), [(5.0, 3e-4), (7.0, 2e-5), (10.0, 2e-6)])
def test_gradients_are_those_of_all_pairs(p: Potential, ratio: float, bound: float) -> None:
    x = flock()
    found = mesh(p, ratio=ratio).gradients(x)
    assert error(found[:, :N], slow_gradients(p, x, N)) < bound
    assert not found[:, N:].any()


def test_error_falls_with_a_high_power_of_the_spacing() -> None:
    """Above fourth order, until the splines' own limit."""
    x = flock()
    expected = slow_gradients(COHESIVE, x, N)
    errors = [
        error(mesh(COHESIVE, reach=0.06, ratio=ratio).gradients(x)[:, :N], expected)
        for ratio in (4.0, 8.0)
    ]
    assert np.log2(errors[0] / errors[1]) > 5.0


def test_sheep_in_the_same_place_feel_the_others_alone() -> None:
    x = flock()
    x[:, 1] = x[:, 0]
    found = mesh(COHESIVE).gradients(x)
    expected = slow_gradients(COHESIVE, x, N)
    assert error(found[:, :N], expected) < 1e-5
    np.testing.assert_allclose(found[:, 0], found[:, 1], rtol=1e-10)


@pytest.mark.parametrize('n', [1, 2, 3])
def test_few_sheep(n: int) -> None:
    x = flock(n, seed=4)
    x[:, 1:n] = x[:, :1] + 0.02 * np.arange(1, n)
    found = mesh(COHESIVE, n).gradients(x)[:, :n]
    expected = slow_gradients(COHESIVE, x, n) if n > 1 else np.zeros((2, 1))
    assert np.abs(found - expected).max() < 1e-4


@pytest.mark.parametrize('p', POTENTIALS)
def test_hessian_products_are_the_derivative_of_the_gradients(p: Potential) -> None:
    """A Taylor test: what is left of the gradients falls with the square of the step."""
    x, rng, sums = flock(), np.random.default_rng(1), mesh(p)
    mu = lanes(rng.normal(size=(N, 2)))
    here, product = sums.gradients(x), sums.hessian_products(x, mu)
    steps = 1e-5 * 0.5 ** np.arange(4)
    rest = [np.linalg.norm(sums.gradients(x + h * mu) - here - h * product) for h in steps]
    assert np.log2(np.divide(rest[:-1], rest[1:])).min() > 1.9
    assert rest[-1] < 0.1 * np.linalg.norm(steps[-1] * product)


def test_hessian_products_are_symmetric() -> None:
    x, rng, sums = flock(), np.random.default_rng(2), mesh(COHESIVE)
    a, b = (lanes(rng.normal(size=(N, 2))) for _ in range(2))
    there, back = (float((u * sums.hessian_products(x, w)).sum()) for u, w in ((a, b), (b, a)))
    assert abs(there) > 1e-3
    np.testing.assert_allclose(there, back, rtol=1e-10)


def test_order_of_the_sheep_does_not_matter() -> None:
    x, order = flock(), np.random.default_rng(3).permutation(N)
    sums = mesh(COHESIVE)
    mixed = x.copy()
    mixed[:, :N] = x[:, order]
    np.testing.assert_allclose(
        sums.gradients(mixed)[:, :N], sums.gradients(x)[:, order], rtol=0, atol=1e-13
    )


@pytest.mark.parametrize('threads', [1, 2, 3])
def test_threads_do_not_change_a_bit(threads: int) -> None:
    x, one = flock(), mesh(COHESIVE)
    with ThreadPoolExecutor(threads) as pool:
        many = ParticleMesh(
            one.potential, N, one.low, one.extent, one.reach, one.spacing, pool.map
        )
        np.testing.assert_array_equal(many.gradients(x), one.gradients(x))
        np.testing.assert_array_equal(many.hessian_products(x, x), one.hessian_products(x, x))


def test_box_and_who_is_in_it() -> None:
    x, sums = flock(), mesh(COHESIVE)
    assert sums.holds(x)
    x[0, 3] = 0.53
    assert not sums.holds(x)
    x[0, 3] = 3.0
    with pytest.raises(ValueError, match='must be in the box'):
        sums.gradients(x)
    x[0, 3] = np.nan
    assert not sums.holds(x)


def test_far_apart_attraction_is_in_free_space() -> None:
    """No images: two groups at the far ends feel each other once, not round the period."""
    attraction = Morse(0.0, 1e-2, 1.0, 2.0)
    x = flock()
    x[0, :N] = np.where(x[0, :N] < 0.0, -0.5, 0.49) + 0.02 * x[0, :N]
    found = mesh(attraction).gradients(x)
    assert error(found[:, :N], slow_gradients(attraction, x, N)) < 1e-5
