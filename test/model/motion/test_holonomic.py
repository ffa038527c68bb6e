# SPDX-License-Identifier: Apache-2.0
from herding_ros.model.motion import Holonomic
from herding_ros.model.state import Array
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

project = Holonomic().project

LIMIT = 0.05
seeds = st.integers(0, 2**32)


def random_control(seed: int) -> Array:
    """Commands within and beyond the limit, some by far, some standing."""
    rng = np.random.default_rng(seed)
    u = rng.normal(0.0, 1.0, (40, 3, 2)) * 10.0 ** rng.uniform(-4.0, 3.0, (40, 3, 1))
    u[:2] = 0.0
    return u


@given(seeds)
def test_projection_is_admissible_and_leaves_admissible_commands_alone(seed: int) -> None:
    u = random_control(seed)
    found = project(u, LIMIT)
    assert np.hypot(found[..., 0], found[..., 1]).max() <= LIMIT
    within = np.hypot(u[..., 0], u[..., 1]) <= LIMIT
    assert within.any()
    assert not within.all()
    np.testing.assert_array_equal(found[within], u[within])


@given(seeds)
def test_projection_is_the_nearest_admissible_command(seed: int) -> None:
    """(u - P u).(w - P u) <= 0 for every admissible w: the projection onto a convex set."""
    u, w = random_control(seed), random_control(seed + 1)
    w *= LIMIT / np.maximum(np.linalg.norm(w, axis=-1, keepdims=True), LIMIT)
    found = project(u, LIMIT)
    product = ((u - found) * (w - found)).sum(axis=-1)
    assert (product <= 1e-16 * np.linalg.norm(u, axis=-1)).all()


@given(seeds)
def test_projecting_twice_changes_nothing(seed: int) -> None:
    once = project(random_control(seed), LIMIT)
    np.testing.assert_array_equal(project(once, LIMIT), once)


def test_projection_keeps_the_direction() -> None:
    found = project(np.array([[3.0, 4.0], [-3e-9, 4e-9]]), 1.0)
    np.testing.assert_allclose(found, [[0.6, 0.8], [-3e-9, 4e-9]], rtol=1e-15)


@pytest.mark.parametrize('shape', [(2,), (3, 2), (4, 3, 2)])
def test_any_number_of_axes_will_do(shape: tuple[int, ...]) -> None:
    found = project(np.full(shape, 8.0), 1.0)
    np.testing.assert_allclose(found, np.full(shape, np.sqrt(0.5)), rtol=1e-15)


def test_dogs_are_where_their_commands_have_led_them() -> None:
    rng = np.random.default_rng(0)
    d, u = rng.normal(size=(3, 2)), rng.normal(size=(4, 3, 2))
    found = Holonomic().rollout(d, u, 0.1, 5)
    expected = d + 0.1 * np.cumsum(np.repeat(u, 5, axis=0), axis=0)
    np.testing.assert_array_equal(found[0], d.T)
    np.testing.assert_allclose(found[1:].transpose(0, 2, 1), expected, rtol=0, atol=1e-14)


def test_transpose_is_that_of_the_rollout_for_each_function() -> None:
    """The rollout is affine: differences are derivatives, to rounding."""
    motion, rng = Holonomic(), np.random.default_rng(0)
    d, u, w = rng.normal(size=(3, 2)), rng.normal(size=(4, 3, 2)), rng.normal(size=(4, 3, 2))
    ds = motion.rollout(d, u, 0.1, 5)
    source = rng.normal(size=(21, 2, 3, 2))
    change = motion.rollout(d, u + w, 0.1, 5) - ds
    expected = 0.1 * np.einsum('kcmf,kcm->f', source, change)
    found = motion.transpose(ds, u, source, 0.1, 5)
    np.testing.assert_allclose(np.einsum('imcf,imc->f', found, w), expected, rtol=1e-12)
    one = motion.transpose(ds, u, source[..., 0], 0.1, 5)
    np.testing.assert_array_equal(one, found[..., 0])
