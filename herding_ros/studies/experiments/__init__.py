"""What tasks compute: functions of values that JSON can hold, the seed among them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import direct, herding, observation, sampling, symmetry, variant, window

EXPERIMENTS: dict[str, Callable[..., dict[str, Any]]] = {
    'direct': direct.run,
    'herding': herding.run,
    'observation': observation.run,
    'sampling': sampling.run,
    'symmetry': symmetry.run,
    'variant': variant.run,
    'window': window.run,
}
"""Experiments by the kind of their tasks."""
