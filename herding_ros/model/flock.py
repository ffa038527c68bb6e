# SPDX-License-Identifier: Apache-2.0
"""Observables of a flock: its centre, its spread, and whether it has arrived."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .parameters import Parameters, quantity, TINY
from .state import Array

MOST_STRAYS = 1000
"""No more sheep may be left behind."""


@dataclass(frozen=True)
class Allowance(Parameters):
    """What may be missing when a flock arrives."""

    strays: int = quantity(
        0,
        'so many sheep may be left behind: the flock is what is left without those that are '
        'farthest away',
        low=0,
        high=MOST_STRAYS,
    )


@dataclass(frozen=True)
class Arrival(Allowance):
    """When a flock has arrived. The radius is the paper's stopping criterion.

    A flock that the dogs scatter may have its centre at the destination by accident, so it has
    arrived only if it is together.
    """

    radius: float = quantity(
        0.05, "the flock's centre is nearer than this to the destination", 'm', low=TINY
    )
    spread: float = quantity(
        1.5, "the flock's spread is at most this multiple of that at the start", low=TINY
    )


def centre(x: Array) -> Array:
    """Centre of mass (..., 2) [m] of sheep at x (..., N, 2) [m]; ValueError for other shapes."""
    if np.ndim(x) < 2 or np.shape(x)[-1] != 2:
        raise ValueError(f'sheep x must have shape (..., N, 2), got {np.shape(x)}')
    return np.mean(x, axis=-2)


def spread(x: Array) -> Array:
    """Root-mean-square distance (...) [m] of sheep at x (..., N, 2) [m] from their centre."""
    return np.sqrt(np.square(x - centre(x)[..., None, :]).sum(axis=-1).mean(axis=-1))


def distance(x: Array, goal: Array) -> Array:
    """Distance (...) [m] of the centre of sheep at x (..., N, 2) [m] from goal (2,) [m]."""
    return np.linalg.norm(centre(x) - goal, axis=-1)


def share_within(x: Array, goal: Array, radius: float) -> Array:
    """Share chi (...) of sheep at x (..., N, 2) within a radius of goal (2,); lengths in [m]."""
    return (np.linalg.norm(x - goal, axis=-1) <= radius).mean(axis=-1)


def without_strays(x: Array, strays: int) -> Array:
    """Return sheep at x (..., N, 2) [m] but for some strays: (..., N - strays, 2), see `flock`."""
    return x[flock(x, strays)].reshape(*x.shape[:-2], -1, 2)


def flock(x: Array, strays: int) -> NDArray[np.bool_]:
    """Return which (..., N) of sheep at x (..., N, 2) [m] are no strays; at least one is not.

    One after another, the sheep farthest from the centre of those that are left is taken for a
    stray. So strays that are fewer than half, and far away, are found wherever they are: though
    they move the centre, one of them is always farther from it than all others.
    """
    sheep = np.arange(x.shape[-2])
    left = np.ones(x.shape[:-1], dtype=np.bool_)
    for _ in range(min(strays, len(sheep) - 1)):
        middle = np.mean(x, axis=-2, keepdims=True, where=left[..., None])
        away = np.where(left, np.square(x - middle).sum(axis=-1), -1.0)
        left &= sheep != away.argmax(axis=-1)[..., None]
    return left


def arrived(x: Array, goal: Array, initial_spread: float, arrival: Arrival) -> bool:
    """Whether sheep at x (N, 2) [m], but for strays, are at the goal (2,) [m] and together.

    initial_spread: of the flock without strays, at the start [m].
    """
    x = without_strays(x, arrival.strays)
    return bool(
        distance(x, goal) < arrival.radius and spread(x) <= arrival.spread * initial_spread
    )
