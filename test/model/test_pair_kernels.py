# SPDX-License-Identifier: Apache-2.0
import math

from herding_ros.model import pair_kernels
from herding_ros.model.pair_kernels import Cells, CHUNK
from herding_ros.model.state import Array
import numpy as np
import pytest

REACH = 0.3
CELLS = Cells(-1.0, -0.5, REACH / 4.0, REACH, 27, 5)
NEAR = (0.7, -1.1, 0.4, *(0.3 * (-1.0) ** k / (k + 1.0) for k in range(13)))


def flock(n: int, seed: int = 0) -> tuple[Array, Array, Array, Array]:
    """Positions, the same sorted, who is where, and where cells begin."""
    x = np.random.default_rng(seed).uniform([[-1.0], [-0.5]], [[1.0], [0.9]], (2, n))
    order = np.empty(n, dtype=np.int64)
    start = np.empty(CELLS.rows * CELLS.columns + 1, dtype=np.int64)
    assert pair_kernels.sort(x, n, CELLS, order, start)
    ordered = np.zeros((2, n + CHUNK))
    pair_kernels.take(x, order, ordered)
    return x, ordered, order, start


def slow_pairs(x: Array) -> tuple[Array, Array]:
    """Gradient of sum_{i<j} P(|x_i - x_j|), and its Hessian (2, n, 2, n), P' = NEAR's."""
    n = x.shape[1]
    gradient, hessian = np.zeros((2, n)), np.zeros((2, n, 2, n))
    slope = np.polynomial.Polynomial(NEAR)
    for i in range(n):
        for j in range(n):
            s = x[:, i] - x[:, j]
            r = math.hypot(*s)
            if 0.0 < r < REACH:
                gradient[:, i] += slope(r) * s / r
                e = np.outer(s, s) / r**2
                block = slope.deriv()(r) * e + slope(r) / r * (np.eye(2) - e)
                hessian[:, i, :, i] += block
                hessian[:, i, :, j] -= block
    return gradient, hessian


def test_sort_puts_every_sheep_into_its_cell_once() -> None:
    x, ordered, order, start = flock(200)
    assert sorted(order) == list(range(200))
    np.testing.assert_array_equal(ordered[:, :200], x[:, order])
    assert (start[0], start[-1]) == (0, 200)
    for cell in range(len(start) - 1):
        row, column = divmod(cell, CELLS.columns)
        here = x[:, order[start[cell] : start[cell + 1]]] - [[CELLS.x0], [CELLS.y0]]
        assert (np.floor(here[0] / CELLS.width) == column).all()
        assert (np.floor(here[1] / CELLS.height) == row).all()


@pytest.mark.parametrize('outside', [(1.1, 0.0), (-1.01, 0.0), (0.0, 1.01), (0.0, -0.51)])
def test_sort_says_when_someone_is_outside(outside: tuple[float, float]) -> None:
    x = np.array([[0.0, outside[0]], [0.0, outside[1]]])
    start = np.empty(CELLS.rows * CELLS.columns + 1, dtype=np.int64)
    assert not pair_kernels.sort(x, 2, CELLS, np.empty(2, dtype=np.int64), start)
    assert not pair_kernels.sort(np.full((2, 2), np.nan), 2, CELLS, np.empty(2, np.int64), start)


@pytest.mark.parametrize(('n', 'seed'), [(1, 0), (2, 0), (9, 0), (9, 1), (100, 0)])
def test_near_pairs_are_those_within_the_reach(n: int, seed: int) -> None:
    x, ordered, order, start = flock(n, seed)
    mu = np.random.default_rng(seed + 100).normal(size=(2, n))
    moves = np.zeros_like(ordered)
    pair_kernels.take(mu, order, moves)
    gradient, hessian = slow_pairs(x)
    rows, out, products = (0, CELLS.rows), np.zeros_like(ordered), np.zeros_like(ordered)
    pair_kernels.near_gradients(*ordered, CELLS, start, rows, REACH, NEAR, *out)
    pair_kernels.near_hessians(*ordered, *moves, CELLS, start, rows, REACH, NEAR, *products)
    atol = 1e-13 * n
    np.testing.assert_allclose(out[:, :n], gradient[:, order], rtol=1e-12, atol=atol)
    expected = np.einsum('cidj,dj->ci', hessian, mu)[:, order]
    np.testing.assert_allclose(products[:, :n], expected, rtol=1e-11, atol=100.0 * atol)
    assert not out[:, n:].any()
    assert not products[:, n:].any()


def test_strips_add_up_to_the_whole() -> None:
    n = 150
    _, ordered, _, start = flock(n)
    whole, parts = np.zeros_like(ordered), np.zeros_like(ordered)
    pair_kernels.near_gradients(*ordered, CELLS, start, (0, CELLS.rows), REACH, NEAR, *whole)
    begins = [int(begin) for begin in start[:: CELLS.columns]]
    for rows in ((0, 2), (2, 2), (2, 3), (3, CELLS.rows)):
        first, last = begins[rows[0]], begins[min(rows[1] + 1, CELLS.rows)]
        out = np.zeros((2, last - first + CHUNK))
        pair_kernels.near_gradients(*ordered, CELLS, start, rows, REACH, NEAR, *out)
        parts[:, first : last + CHUNK] += out
    assert np.abs(whole).max() > 1.0
    np.testing.assert_allclose(parts, whole, rtol=0, atol=1e-12)


def test_sheep_in_the_same_place_do_not_move_each_other() -> None:
    x = np.zeros((2, 3))
    order, start = np.empty(3, dtype=np.int64), np.empty(5 * 27 + 1, dtype=np.int64)
    assert pair_kernels.sort(x, 3, CELLS, order, start)
    ordered, out = np.zeros((2, 3 + CHUNK)), np.zeros((2, 3 + CHUNK))
    pair_kernels.near_gradients(*ordered, CELLS, start, (0, 5), REACH, NEAR, *out)
    assert not out.any()
    pair_kernels.near_hessians(
        *ordered, *np.ones((2, 3 + CHUNK)), CELLS, start, (0, 5), REACH, NEAR, *out
    )
    assert not out.any()


def test_put_undoes_take() -> None:
    values = np.random.default_rng(0).normal(size=(2, 16))
    order = np.random.default_rng(1).permutation(13)
    taken, back = np.zeros((2, 13 + CHUNK)), np.zeros((2, 16))
    pair_kernels.take(values, order, taken)
    pair_kernels.put(taken, order, back)
    np.testing.assert_array_equal(back[:, :13], values[:, :13])
    assert not back[:, 13:].any()
