# SPDX-License-Identifier: Apache-2.0
from herding_ros.model import mesh_kernels
from herding_ros.model.mesh_kernels import Mesh, ORDER
from herding_ros.model.state import Array
import numpy as np
from scipy.interpolate import BSpline

ROWS, COLUMNS, PER_LENGTH = 25, 31, 20.0
MESH = Mesh(-0.4, 0.3, PER_LENGTH, COLUMNS, 0)
CORNER = np.array([[MESH.x0], [MESH.y0]])
SIDES = (np.array([[COLUMNS], [ROWS]]) - ORDER) / PER_LENGTH


def sheep(n: int = 20) -> Array:
    return CORNER + SIDES * np.random.default_rng(0).uniform(0.0, 1.0, (2, n))


def field(of: object) -> Array:
    """Values of a function of x, y [m] at the mesh points; sheep count theirs from 3.5 away."""
    at = (np.arange(max(ROWS, COLUMNS)) - (ORDER / 2 - 1)) / PER_LENGTH
    x, y = np.meshgrid(MESH.x0 + at[:COLUMNS], MESH.y0 + at[:ROWS])
    return of(x, y).ravel()  # type: ignore[operator]


def test_weights_are_the_cardinal_b_spline() -> None:
    x = sheep(1)
    points = np.zeros(ROWS * COLUMNS)
    mesh_kernels.spread(*x, MESH, points)
    weight = BSpline.basis_element(np.arange(ORDER + 1.0) - ORDER / 2, extrapolate=False)
    at = np.arange(max(ROWS, COLUMNS)) - (ORDER / 2 - 1)
    wx, wy = (np.nan_to_num(weight(at - w)) for w in ((x - CORNER) * PER_LENGTH)[:, 0])
    np.testing.assert_allclose(
        points.reshape(ROWS, COLUMNS), np.outer(wy[:ROWS], wx[:COLUMNS]), rtol=0, atol=1e-14
    )


def test_every_sheep_weighs_one_and_keeps_its_place() -> None:
    x = sheep()
    points = np.zeros(ROWS * COLUMNS)
    mesh_kernels.spread(*x, MESH, points)
    np.testing.assert_allclose(points.sum(), 20.0, rtol=1e-13)
    for of, moment in ((lambda x, y: x, x[0].sum()), (lambda x, y: y, x[1].sum())):
        np.testing.assert_allclose(points @ field(of), moment, rtol=1e-12)


def test_gradient_of_a_quadratic_field_is_exact() -> None:
    """Splines of any order from 3 on give quadratics back, up to a constant."""
    x, out = sheep(), np.zeros((2, 20))
    points = field(lambda x, y: 2.0 * x - y + x * y + 0.5 * y**2)
    mesh_kernels.gather(*x, MESH, points, *out)
    np.testing.assert_allclose(out, [2.0 + x[1], -1.0 + x[0] + x[1]], rtol=1e-11)


def test_gather_is_the_derivative_of_spread() -> None:
    x, rng = sheep(), np.random.default_rng(1)
    mu, points = rng.normal(size=(2, 20)), rng.normal(size=ROWS * COLUMNS)
    gradient, dipoles = np.zeros((2, 20)), np.zeros(ROWS * COLUMNS)
    mesh_kernels.gather(*x, MESH, points, *gradient)
    mesh_kernels.spread_dipoles(*x, *mu, MESH, dipoles)
    np.testing.assert_allclose(points @ dipoles, (gradient * mu).sum(), rtol=1e-11)
    there, back = np.zeros_like(points), np.zeros_like(points)
    mesh_kernels.spread(*(x + 1e-6 * mu), MESH, there)
    mesh_kernels.spread(*(x - 1e-6 * mu), MESH, back)
    np.testing.assert_allclose(dipoles, (there - back) / 2e-6, rtol=0, atol=1e-6)


def test_gathered_hessians_are_the_derivative_of_gathered_gradients() -> None:
    x, rng = sheep(), np.random.default_rng(2)
    mu = rng.normal(size=(2, 20))
    points, dipoles = rng.normal(size=(2, ROWS * COLUMNS))
    found, there, back, moving = np.zeros((4, 2, 20))
    mesh_kernels.gather_hessians(*x, *mu, MESH, points, dipoles, *found)
    mesh_kernels.gather(*(x + 1e-6 * mu), MESH, points, *there)
    mesh_kernels.gather(*(x - 1e-6 * mu), MESH, points, *back)
    mesh_kernels.gather(*x, MESH, dipoles, *moving)
    expected = (there - back) / 2e-6 + moving
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


def test_rows_may_begin_anywhere() -> None:
    x = sheep()
    x[1] = MESH.y0 + 6.3 / PER_LENGTH
    whole, part = np.zeros(ROWS * COLUMNS), np.zeros(ROWS * COLUMNS)
    mesh_kernels.spread(*x, MESH, whole)
    mesh_kernels.spread(*x, MESH._replace(first_row=5), part)
    np.testing.assert_array_equal(part[: -5 * COLUMNS], whole[5 * COLUMNS :])
