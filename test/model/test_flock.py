# SPDX-License-Identifier: Apache-2.0
import math
import re

from herding_ros.model.flock import (
    Arrival,
    arrived,
    centre,
    distance,
    spread,
    without_strays,
)
from herding_ros.model.state import Array
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

SQUARE = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
HERE = np.array([3.0, -2.0])


def flock(size: float, at: Array) -> Array:
    """Four sheep with the given spread, `size`."""
    return at + size / math.sqrt(2.0) * SQUARE


def test_square_has_the_known_centre_and_spread() -> None:
    np.testing.assert_allclose(centre(flock(0.3, HERE)), HERE, rtol=1e-15)
    assert spread(flock(0.3, HERE)) == pytest.approx(0.3, rel=1e-14)
    assert spread(HERE[None]) == 0.0


def test_whole_trajectories_are_measured_at_once() -> None:
    x = np.stack([flock(0.1, np.array([0.0, 0.0])), flock(0.2, np.array([3.0, 4.0]))])
    np.testing.assert_allclose(distance(x, np.zeros(2)), [0.0, 5.0], atol=1e-15)
    np.testing.assert_allclose(spread(x), [0.1, 0.2], rtol=1e-14)


def test_lists_are_measured_like_arrays() -> None:
    x = flock(0.3, HERE)
    assert spread(x.tolist()) == spread(x)  # type: ignore[arg-type]
    assert distance(x.tolist(), [0.0, 0.0]) == distance(x, np.zeros(2))  # type: ignore[arg-type]


@pytest.mark.parametrize('shape', [(2, 5), (7, 2, 8), (5, 3), (2,), ()])
def test_coordinates_have_to_come_last(shape: tuple[int, ...]) -> None:
    """Those of `Trajectory.xs` do not: its spread would be a number like any other."""
    words = re.escape(f'sheep x must have shape (..., N, 2), got {shape}')
    for measure in (centre, spread, lambda x: distance(x, HERE)):
        with pytest.raises(ValueError, match=f'^{words}$'):
            measure(np.ones(shape))


@given(n=st.integers(1, 30), seed=st.integers(0, 2**32))
def test_distance_and_spread_add_up_to_the_cost_of_individuals(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, z = rng.normal(0.0, 2.0, (n, 2)), rng.normal(0.0, 2.0, 2)
    individuals = sum(math.dist(each, z) ** 2 for each in x) / n
    assert distance(x, z) ** 2 + spread(x) ** 2 == pytest.approx(individuals, rel=1e-12)


@pytest.mark.parametrize(
    ('away', 'size', 'expected'),
    [
        (0.0499, 0.3, True),
        (0.0501, 0.3, False),
        (0.0, 0.4499, True),  # the initial spread is 0.3, the limit 1.5 times that
        (0.0, 0.4501, False),
        (0.0499, 0.01, True),
    ],
)
def test_arrival_is_a_centre_at_the_goal_of_a_flock_together(
    away: float, size: float, expected: bool
) -> None:
    offset = away * np.array([0.6, 0.8])
    assert arrived(flock(size, HERE + offset), HERE, 0.3, Arrival()) is expected


def test_radius_and_spread_of_an_arrival_are_parameters() -> None:
    wide = Arrival(radius=0.2, spread=3.0)
    assert arrived(flock(0.89, HERE + np.array([0.0, 0.19])), HERE, 0.3, wide)
    assert not arrived(flock(0.89, HERE + np.array([0.0, 0.21])), HERE, 0.3, wide)
    assert not arrived(flock(0.91, HERE), HERE, 0.3, wide)


def test_as_many_sheep_as_asked_for_may_be_left_behind() -> None:
    x = np.concatenate([flock(0.3, HERE), [HERE + np.array([5.0, 0.0]), [0.0, 0.0]]])
    found = [arrived(x, HERE, 0.3, Arrival(strays=strays)) for strays in range(3)]
    assert found == [False, False, True]


@given(data=st.data(), n=st.integers(3, 30), seed=st.integers(0, 2**32))
def test_strays_are_left_out_wherever_they_are(data: st.DataObject, n: int, seed: int) -> None:
    """Fewer than half of the sheep, together or in many places, and far enough from the rest."""
    strays = data.draw(st.integers(0, (n - 1) // 2))
    rng = np.random.default_rng(seed)
    size = 0.3  # of the flock, from its middle
    angles, radii = rng.uniform(0.0, 2.0 * np.pi, n), size * rng.uniform(0.0, 1.0, n)
    # The strays pull the centre their way. From here on one of them is still farther from it
    # than all others.
    radii[:strays] = size * (1.01 + 2.0 / (1.0 - 2.0 * strays / n))
    radii[:strays] *= np.exp(rng.uniform(0.0, rng.uniform(0.0, 5.0), strays))
    angles[:strays] *= rng.choice([0.0, 0.1, 1.0])
    order = rng.permutation(n)
    x = (HERE + radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))[order]
    np.testing.assert_array_equal(without_strays(x, strays), x[order >= strays])


@given(n=st.integers(1, 30), strays=st.integers(0, 40), seed=st.integers(0, 2**32))
def test_strays_are_the_same_in_whole_trajectories_and_from_any_side(
    n: int, strays: int, seed: int
) -> None:
    x = np.random.default_rng(seed).normal(0.0, 1.0, (2, 3, n, 2))
    kept = without_strays(x, strays)
    assert kept.shape == (2, 3, max(n - strays, 1), 2)
    for k in np.ndindex(2, 3):
        np.testing.assert_array_equal(kept[k], without_strays(x[k], strays))
    if n - strays > 1:  # of two sheep neither is farther from their centre
        turned = without_strays(np.stack([-x[..., 1], x[..., 0]], axis=-1), strays)
        np.testing.assert_array_equal(turned, np.stack([-kept[..., 1], kept[..., 0]], axis=-1))
