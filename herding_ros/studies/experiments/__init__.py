"""What tasks compute: functions of values that JSON can hold, the seed among them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import common_noise, direct, herding, observation, symmetry, variant, window

EXPERIMENTS: dict[str, Callable[..., dict[str, Any]]] = {
    'common_noise': common_noise.run,
    'direct': direct.run,
    'herding': herding.run,
    'observation': observation.run,
    'symmetry': symmetry.run,
    'variant': variant.run,
    'window': window.run,
}
"""Experiments by the kind of their tasks."""
