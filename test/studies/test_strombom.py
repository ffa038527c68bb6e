# SPDX-License-Identifier: Apache-2.0
"""The published rules, on herds made by hand."""

from __future__ import annotations

from herding_ros.model.state import Array, HerdState
from herding_ros.studies.experiments.strombom import Strombom
import numpy as np
import pytest

GOAL = np.array([2.0, 0.0])
R = 0.2


def policy(**settings: float) -> Strombom:
    return Strombom(
        GOAL, np.random.default_rng(0), **{'sheep_distance': R, 'noise': 0.0} | settings
    )


def ring(n: int, radius: float, middle: tuple[float, float] = (0.0, 0.0)) -> Array:
    angle = 2.0 * np.pi * np.arange(n) / n
    return np.array(middle) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def herd(x: Array, d: Array) -> HerdState:
    return HerdState(x, np.zeros_like(x), d)


def test_one_dog_drives_from_behind_when_all_are_together() -> None:
    posts = policy().posts(ring(16, 0.3, (1.0, 1.0)), 1)
    away = np.array([1.0, 1.0]) - GOAL
    expected = np.array([1.0, 1.0]) + R * 4.0 * away / np.linalg.norm(away)
    np.testing.assert_allclose(posts, [expected], rtol=0, atol=1e-12)


def test_one_dog_collects_the_farthest_stray_from_behind() -> None:
    x = np.concatenate([ring(7, 0.1), [[0.0, 3.0]]])  # f(8) = 4 r_a = 0.8 m
    middle = x.mean(axis=0)
    way = (x[7] - middle) / np.linalg.norm(x[7] - middle)
    np.testing.assert_allclose(policy().posts(x, 1), [x[7] + R * way], rtol=0, atol=1e-12)


@pytest.mark.parametrize(('radius', 'collects'), [(0.79, False), (0.81, True)])
def test_a_stray_is_farther_than_r_n_to_two_thirds(radius: float, collects: bool) -> None:
    x = ring(8, radius)
    post = policy().posts(x, 1)[0]
    behind = np.array([-R * np.sqrt(8.0), 0.0])
    assert np.allclose(post, behind) != collects


def test_several_dogs_share_strays_and_the_arc() -> None:
    x = np.concatenate([ring(20, 0.1), [[0.0, 3.0], [0.0, -3.5]]])
    posts = policy(arc=0.4).posts(x, 5)
    middle = x.mean(axis=0)
    beyond = np.linalg.norm(posts[:2] - middle, axis=1)
    expected = np.linalg.norm(x[[21, 20]] - middle, axis=1) + R
    np.testing.assert_allclose(beyond, expected, rtol=1e-12)  # the farthest stray first
    arms = posts[2:] - middle
    np.testing.assert_allclose(np.linalg.norm(arms, axis=1), R * np.sqrt(22.0), rtol=1e-12)
    back = np.arctan2(*(middle - GOAL)[::-1])
    turned = np.arctan2(arms[:, 1], arms[:, 0]) - back
    turned = (turned + np.pi) % (2.0 * np.pi) - np.pi
    np.testing.assert_allclose(turned, [-0.4, 0.0, 0.4], rtol=0, atol=1e-12)


def test_dogs_take_the_posts_nearest_to_them() -> None:
    x = ring(9, 0.2)
    posts = policy().posts(x, 3)
    outward = posts + 0.5 * (posts - x.mean(axis=0))
    for order in ([0, 1, 2], [2, 0, 1]):
        u = policy()(herd(x, outward[order]), 0.0)
        way = (posts - outward)[order]
        np.testing.assert_allclose(
            u / np.linalg.norm(u, axis=1, keepdims=True),
            way / np.linalg.norm(way, axis=1, keepdims=True),
            atol=1e-12,
        )


@pytest.mark.parametrize(('gap', 'speed'), [(3.01 * R, 0.05), (2.99 * R, 0.02)])
def test_a_dog_is_slow_near_sheep(gap: float, speed: float) -> None:
    x = np.array([[0.0, 0.0], [0.0, 0.01]])
    u = policy()(herd(x, np.array([[0.0, 0.01 + gap]])), 0.0)
    assert np.linalg.norm(u) == pytest.approx(speed)


def test_noise_turns_a_dog_but_never_speeds_it_up() -> None:
    x, d = ring(9, 0.2), np.array([[-3.0, 0.0]])
    noisy = Strombom(GOAL, np.random.default_rng(1), sheep_distance=R)
    straight = np.array([1.0, 0.0])
    u = np.array([noisy(herd(x, d), 0.0)[0] for _ in range(400)])
    np.testing.assert_allclose(np.linalg.norm(u, axis=1), 0.05, rtol=1e-12)
    angle = np.arctan2(u[:, 1], u[:, 0])
    assert np.abs(angle).max() <= np.arcsin(0.3) + 1e-12  # e = 0.3 turns by no more
    assert np.abs(angle).max() > 0.25
    assert np.dot(u.mean(axis=0), straight) > 0.045


def test_a_dog_at_its_post_stays() -> None:
    x = ring(9, 0.2)
    d = policy().posts(x, 1)
    np.testing.assert_allclose(policy()(herd(x, d), 0.0), 0.0, atol=1e-12)


def test_dogs_with_a_heading_are_told_what_others_are() -> None:
    x, d = np.array([[0.0, 0.0], [0.1, 0.0]]), np.array([[1.0, 0.2], [-0.7, 0.5]])
    states = (d, np.hstack([d, [[0.3], [-2.0]]]))
    told = [
        Strombom(np.array([2.0, 0.0]), np.random.default_rng(0))(HerdState(x, 0.0 * x, each), 0.0)
        for each in states
    ]
    assert told[0].shape == (2, 2)
    np.testing.assert_array_equal(told[1], told[0])
