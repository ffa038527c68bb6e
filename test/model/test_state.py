# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.state import finite, HerdState
import numpy as np
import pytest

X, V, D = np.ones((3, 2)), np.zeros((3, 2)), np.full((2, 2), 5.0)
NAMES = {'x': 'sheep positions x', 'v': 'sheep velocities v', 'd': 'dogs d'}


@pytest.mark.parametrize('field', NAMES)
@pytest.mark.parametrize('bad', [np.ones(2), np.ones((3, 1)), np.ones((3, 2, 1)), 1.0, None])
def test_wrong_shapes_are_named(field: str, bad: object) -> None:
    with pytest.raises(ValueError, match=f'^{NAMES[field]} must have shape .*, got '):
        HerdState(**{'x': X, 'v': V, 'd': D, field: bad})


@pytest.mark.parametrize('field', NAMES)
@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_named(field: str, bad: float) -> None:
    values = {'x': X, 'v': V, 'd': D}
    spoilt = values[field].copy()
    spoilt[1, 1] = bad
    with pytest.raises(ValueError, match=f'^{NAMES[field]} must be finite'):
        HerdState(**{**values, field: spoilt})


@pytest.mark.parametrize('field', NAMES)
@pytest.mark.parametrize('bad', ['abc', [[1.0, 2.0], [3.0]], [['a', 'b']] * 3])
def test_what_is_no_array_of_numbers_is_named(field: str, bad: object) -> None:
    with pytest.raises(ValueError, match=f'^{NAMES[field]} '):
        HerdState(**{'x': X, 'v': V, 'd': D, field: bad})


def test_velocities_go_with_positions() -> None:
    with pytest.raises(ValueError, match=r'velocities v must have shape \(3, 2\), got \(4, 2\)'):
        HerdState(X, np.zeros((4, 2)), D)


@pytest.mark.parametrize(('n', 'm'), [(0, 1), (1, 0)])
def test_herds_are_not_empty(n: int, m: int) -> None:
    with pytest.raises(ValueError, match=f'got {n} sheep and {m} dogs'):
        HerdState(np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((m, 2)))


def test_state_is_a_copy_in_double_precision() -> None:
    x = np.ones((3, 2), dtype=np.float32)
    state = HerdState(x, [[0, 0]] * 3, D)
    x[0, 0] = 7.0
    assert state.x[0, 0] == 1.0
    assert {state.x.dtype, state.v.dtype, state.d.dtype} == {np.dtype(np.float64)}


def test_finite_takes_any_length_where_none_is_asked() -> None:
    assert finite('a', np.zeros((4, 2)), (None, 2)).shape == (4, 2)
    with pytest.raises(ValueError, match=r'a must have shape \(3, any\), got \(4, 2\)'):
        finite('a', np.zeros((4, 2)), (3, None))


def test_trajectory_starts_at_the_state_and_holds_only_real_sheep(
    random_herd: Callable[..., HerdState],
) -> None:
    state = random_herd(11, 3)
    trajectory = rollout(Crowd(), state, np.zeros((4, 3, 2)), 0.1, 5)
    assert trajectory.x.shape == trajectory.v.shape == (21, 11, 2)
    assert trajectory.d.shape == (21, 3, 2)
    for found, given in zip((trajectory.at(0), trajectory.at(-1)), (0, 20), strict=True):
        np.testing.assert_array_equal(found.x, trajectory.x[given])
        np.testing.assert_array_equal(found.v, trajectory.v[given])
    np.testing.assert_array_equal(trajectory.x[0], state.x)
    np.testing.assert_array_equal(trajectory.v[0], state.v)
    np.testing.assert_array_equal(trajectory.d[0], state.d)
