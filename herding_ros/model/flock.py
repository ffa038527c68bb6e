# SPDX-License-Identifier: Apache-2.0
"""Observables of a flock: its centre, its spread, and whether it has arrived."""

from __future__ import annotations

import numpy as np

from .state import Array

ARRIVAL_DISTANCE = 0.05
"""How near the centre has to be to the destination [m]; the paper's stopping criterion."""

TOGETHER = 1.5
"""A flock is together while its spread is at most this multiple of the initial spread."""


def centre(x: Array) -> Array:
    """Centre of mass (..., 2) [m] of sheep at x (..., N, 2) [m]."""
    return x.mean(axis=-2)


def spread(x: Array) -> Array:
    """Root-mean-square distance (...) [m] of sheep at x (..., N, 2) [m] from their centre."""
    return np.sqrt(np.square(x - centre(x)[..., None, :]).sum(axis=-1).mean(axis=-1))


def distance(x: Array, goal: Array) -> Array:
    """Distance (...) [m] of the centre of sheep at x (..., N, 2) [m] from goal (2,) [m]."""
    return np.linalg.norm(centre(x) - goal, axis=-1)


def arrived(x: Array, goal: Array, initial_spread: float) -> bool:
    """Whether sheep at x (N, 2) [m] are at the goal (2,) [m], and together.

    A flock that the dogs scatter may have its centre at the goal by accident,
    so it has arrived only if it is together.
    """
    return bool(distance(x, goal) < ARRIVAL_DISTANCE and spread(x) <= TOGETHER * initial_spread)
