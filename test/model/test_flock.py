# SPDX-License-Identifier: Apache-2.0
import math

from herding_ros.model.flock import arrived, centre, distance, spread
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
    assert arrived(flock(size, HERE + offset), HERE, 0.3) is expected
