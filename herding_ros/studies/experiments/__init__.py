# SPDX-License-Identifier: Apache-2.0
"""What tasks compute: functions of values that JSON can hold, the seed among them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import (
    decisions,
    direct,
    fields,
    herding,
    mean_field,
    real,
    real_limits,
    sampling,
    strangers,
    symmetry,
    variant,
    window,
)
from .case import Case

EXPERIMENTS: dict[str, Callable[..., dict[str, Any]]] = {
    'candidates': decisions.candidates,
    'common_noise': Case.experiment(window.common_noise),
    'direct': Case.experiment(direct.run),
    'fields': fields.run,
    'herding': herding.run,
    'looks': decisions.looks,
    'mean_field_convergence': mean_field.convergence,
    'mean_field_mapping': Case.experiment(window.large_flock),
    'mean_field_replan': mean_field.replan,
    'real_drives': real.recorded,
    'real_herding': real.herding,
    'real_limits': real_limits.limits,
    'real_prediction': real.predicted,
    'sampling': sampling.run,
    'strangers': strangers.run,
    'symmetry': symmetry.run,
    'variant': Case.experiment(variant.run),
    'window': Case.experiment(window.table),
}
"""Experiments by the kind of their tasks."""
