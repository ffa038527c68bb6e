"""What tasks compute: functions of values that JSON can hold, the seed among them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import (
    common_noise,
    direct,
    herding,
    mean_field,
    observation,
    sampling,
    symmetry,
    variant,
    window,
)

EXPERIMENTS: dict[str, Callable[..., dict[str, Any]]] = {
    'common_noise': common_noise.run,
    'direct': direct.run,
    'herding': herding.run,
    'mean_field_convergence': mean_field.convergence,
    'mean_field_mapping': mean_field.mapping,
    'mean_field_replan': mean_field.replan,
    'observation': observation.run,
    'sampling': sampling.run,
    'symmetry': symmetry.run,
    'variant': variant.run,
    'window': window.run,
}
"""Experiments by the kind of their tasks."""
