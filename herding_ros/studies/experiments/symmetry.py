# SPDX-License-Identifier: Apache-2.0
"""Symmetric herds without friction and noise, whose centre should stay (paper, 6.3)."""

from __future__ import annotations

from typing import Any

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import distance
from herding_ros.model.scenario import GOAL
from herding_ros.model.state import Array, HerdState
import numpy as np

MOTIONS = ('stand', 'breathe', 'circle', 'both')
"""Motions of pairs of dogs: none, along their diameter, round the goal, or both at once."""


def symmetric_herd(pairs: int, dog_pairs: int, seed: int) -> HerdState:
    """Sheep at rest and dogs, in pairs opposite to each other about the goal (A1 to A3).

    No pairs of sheep: a single one at the goal itself.
    """
    rng = np.random.default_rng(seed)
    goal = np.array(GOAL)
    half = rng.uniform(-0.4, 0.4, (pairs, 2))
    x = goal + (np.concatenate([half, -half]) if pairs else np.zeros((1, 2)))
    radius, angle = rng.uniform(0.6, 1.2, dog_pairs), rng.uniform(0.0, np.pi, dog_pairs)
    arms = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return HerdState(x, np.zeros_like(x), goal + np.concatenate([arms, -arms]))


def velocities(d: Array, motion: str, duration: float, intervals: int) -> Array:
    """Opposite velocities (intervals, 2 M, 2) [m/s] for opposite dogs at d (2 M, 2) [m]."""
    t = (np.arange(intervals) + 0.5) * duration / intervals
    arms = (d - np.array(GOAL))[: len(d) // 2]
    outward = arms / np.linalg.norm(arms, axis=1, keepdims=True)
    round_about = np.stack([-outward[:, 1], outward[:, 0]], axis=1)
    breathe = {'stand': 0.0, 'circle': 0.0}.get(motion, 0.03)
    circle = {'stand': 0.0, 'breathe': 0.0}.get(motion, 0.03)
    half = (
        breathe * np.cos(0.7 * t)[:, None, None] * outward
        + circle * np.sin(0.4 * t)[:, None, None] * round_about
    )
    return np.concatenate([half, -half], axis=1)


def run(
    pairs: int, dog_pairs: int, motion: str, duration: float, dt: float, seed: int
) -> dict[str, Any]:
    """Return the largest distance of the centre of a symmetric herd from the goal, drift [m].

    And the largest displacement of a sheep, moved [m].
    """
    state = symmetric_herd(pairs, dog_pairs, seed)
    crowd = Crowd(friction=0.0, noise=0.0)
    intervals = round(duration / dt)
    u = velocities(state.d, motion, duration, intervals)
    run = rollout(crowd, state, u, dt)
    return {
        'drift': float(distance(run.x, np.array(GOAL)).max()),
        'moved': float(np.linalg.norm(run.x - run.x[0], axis=-1).max()),
    }
