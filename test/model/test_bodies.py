# SPDX-License-Identifier: Apache-2.0
"""How near dogs are to each other, against every pair looked at in turn."""

import itertools

from herding_ros.model.bodies import closest, distances_between, touches
import numpy as np


def test_distances_are_those_of_every_pair() -> None:
    d = np.random.default_rng(0).normal(size=(4, 5, 2))
    expected = [[np.hypot(*(a - b)) for a, b in itertools.combinations(state, 2)] for state in d]
    np.testing.assert_allclose(distances_between(d), expected, rtol=1e-14)
    np.testing.assert_allclose(closest(d), np.min(expected), rtol=1e-14)


def test_a_dog_that_is_alone_or_not_seen_is_near_no_other() -> None:
    assert closest(np.zeros((3, 1, 2))) == np.inf
    d = np.array([[[0.0, 0.0], [np.nan, np.nan], [3.0, 4.0]]])
    assert closest(d) == 5.0
    assert touches(d, 1.0) == 0


def test_two_dogs_touch_once_until_they_part() -> None:
    x = np.array([3.0, 1.9, 1.5, 2.1, 1.9, 1.9])
    d = np.stack([np.zeros((6, 2)), np.stack([x, 0.0 * x], axis=1)], axis=1)
    assert touches(d, 1.0) == 2
    assert touches(d[1:], 1.0) == 2  # in touch at the start
    assert touches(d, 0.5) == 0
