# SPDX-License-Identifier: Apache-2.0
"""Starts that are harder than the reference scenario: herds of it, arranged anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from herding_ros.model.flock import centre
from herding_ros.model.state import Array, HerdState
import numpy as np

_STRAY = 1.2
"""Distance of a stray from the centre of the flock [m]."""
_INSIDE = 0.15
"""Distance of dogs inside the flock from its centre [m]."""
_CLUSTER = 0.8
"""Distance of two clusters from their common centre [m]."""


def _strays(herd: HerdState, ahead: Array) -> HerdState:
    """Move one sheep aside, and one behind the flock."""
    x, middle = herd.x.copy(), centre(herd.x)
    x[0] = middle + _STRAY * _aside(ahead)
    x[1] = middle - _STRAY * ahead
    return replace(herd, x=x)


def _inside(herd: HerdState, ahead: Array) -> HerdState:
    """Put the dogs in the midst of the flock."""
    angles = 2.0 * np.pi * np.arange(len(herd.d)) / len(herd.d)
    d = herd.d.copy()
    d[:, :2] = centre(herd.x) + _INSIDE * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return replace(herd, d=d)


def _in_front(herd: HerdState, ahead: Array) -> HerdState:
    """Put the dogs on the side of the goal."""
    d = herd.d.copy()
    d[:, :2] *= -1.0
    return replace(herd, d=d)


def _clusters(herd: HerdState, ahead: Array) -> HerdState:
    """Divide the flock in two, one on each side."""
    side = np.where(np.arange(len(herd.x)) % 2, 1.0, -1.0)[:, None]
    return replace(herd, x=herd.x + _CLUSTER * side * _aside(ahead))


_STARTS: dict[str, Callable[[HerdState, Array], HerdState]] = {
    'usual': lambda herd, _: herd,
    'strays': _strays,
    'dogs inside': _inside,
    'dogs in front': _in_front,
    'two clusters': _clusters,
}


def arranged(start: str, herd: HerdState, goal: Array) -> HerdState:
    """Return a herd of the reference scenario, on its way to goal (2,) [m], in another start."""
    if start not in _STARTS:
        raise ValueError(f'start must be one of {", ".join(_STARTS)}, got {start!r}')
    angle = np.arctan2(goal[1], goal[0])
    return _STARTS[start](herd, np.array([np.cos(angle), np.sin(angle)]))


def _aside(ahead: Array) -> Array:
    return np.array([-ahead[1], ahead[0]])
