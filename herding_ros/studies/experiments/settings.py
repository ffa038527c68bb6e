# SPDX-License-Identifier: Apache-2.0
"""Parameters as their differences from the defaults, for JSON."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

from herding_ros.control.parameters import Control
from herding_ros.model.parameters import Parameters

_P = TypeVar('_P', bound=Parameters)


def differences(given: Parameters, default: Parameters) -> dict[str, Any]:
    """Return the fields, nested ones as dicts, in which `given` is not `default`."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(given):
        value, usual = getattr(given, field.name), getattr(default, field.name)
        if value != usual:
            nested = isinstance(value, Parameters)
            found[field.name] = differences(value, usual) if nested else value
    return found


def changed(default: _P, values: dict[str, Any]) -> _P:
    """Undo `differences`. Raises TypeError or ValueError for invalid parameters."""
    return dataclasses.replace(
        default,
        **{
            name: changed(getattr(default, name), value) if isinstance(value, dict) else value
            for name, value in values.items()
        },
    )


def with_paths(control: Control, paths: int | None) -> Control:
    """Return control with another number of Monte Carlo paths; None keeps it."""
    if paths is None:
        return control
    return dataclasses.replace(control, mapping=dataclasses.replace(control.mapping, paths=paths))
