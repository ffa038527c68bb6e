# SPDX-License-Identifier: Apache-2.0
"""What a rule of herding provides, and what it would do over a window."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.detour import detour
from herding_ros.control.errands import Errands
from herding_ros.control.reach import Reach
from herding_ros.control.ways import Ways
from herding_ros.model.state import Array, HerdState
import numpy as np
from scipy.optimize import linear_sum_assignment

SIDE_BY_SIDE = 0.45
"""Angle between neighbouring drivers, seen from the flock's centre [rad]."""

_DECISIONS = 10
"""Number of times in a window at which a rule decides anew."""


class Rule(Protocol):
    """Tells dogs where to be."""

    def posts(self, state: HerdState, errands: Errands, goal: Array) -> Array:
        """Return the post (M, 2) [m] of each dog on the way to the goal (2,) [m]."""


def rule_plan(
    rule: Rule,
    model: CoarseModel,
    reach: Reach,
    goal: Array,
    max_speed: float,
    intervals: int,
    ways: Ways | None = None,
) -> Array:
    """Return the control (intervals, M, 2) [m/s] that a rule leads to on the coarse model.

    Ten times in a window it says where the dogs should be. They go there at max_speed round
    the flock, and no farther. Among walls they drive it along its route, from posts on its side
    of them.
    """
    state, chunks = model.state, []
    held = -(-intervals // _DECISIONS)
    for first in range(0, intervals, held):
        count = min(held, intervals - first)
        aim = goal if ways is None else ways.aim(state.x)
        errands = Errands.of(reach, state, aim, ways)
        place = errands.place(state.x)
        posts = rule.posts(state, errands, aim)
        if ways is not None:
            posts = ways.steps(state.dogs, ways.in_front(state.x, posts))
        way, by_dog, _ = detour(state.dogs - place, posts - place, errands.around)
        speed = np.minimum(max_speed, way / (count * model.interval))
        u = np.broadcast_to(-speed[:, None] * by_dog, (count, *posts.shape))
        chunks.append(model.motion.project(u, max_speed))
        state = replace(model, state=state).rollout(chunks[-1]).at(-1)
    return np.concatenate(chunks)


def behind(
    middle: Array, radius: float, goal: Array, dogs: int, spacing: float = SIDE_BY_SIDE
) -> Array:
    """Return posts (dogs, 2) [m] on a circle around a flock's middle on the way to a goal (2,).

    They are side by side, `spacing` [rad] apart, on the side away from the goal.
    """
    back = np.arctan2(*(middle - goal)[::-1])
    return on_circle(middle, radius, back + spacing * (np.arange(dogs) - 0.5 * (dogs - 1)))


def on_circle(middle: Array, radius: float, angles: Array) -> Array:
    """Return points (n, 2) [m] on a circle at these angles (n,) [rad]."""
    return middle + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def nearest_posts(d: Array, posts: Array) -> Array:
    """Return the posts (M, 2) [m] in an order in which dogs at d (M, 2) reach them soon."""
    _, taken = linear_sum_assignment(np.linalg.norm(d[:, None] - posts, axis=-1))
    return posts[taken]
