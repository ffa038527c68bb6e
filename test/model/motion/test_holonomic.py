from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from herding_ros.model.motion import Holonomic
from herding_ros.model.state import Array

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
