"""Parameters as the few values in which they differ from the defaults, for JSON and people."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

from herding_ros.model.parameters import Parameters

_P = TypeVar('_P', bound=Parameters)


def differences(given: Parameters, default: Parameters) -> dict[str, Any]:
    """Return the fields, nested ones as dicts, in which given is not default."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(given):
        value, usual = getattr(given, field.name), getattr(default, field.name)
        if value != usual:
            nested = isinstance(value, Parameters)
            found[field.name] = differences(value, usual) if nested else value
    return found


def changed(default: _P, values: dict[str, Any]) -> _P:
    """Undo `differences`. Raises TypeError or ValueError for what is not allowed."""
    return dataclasses.replace(
        default,
        **{
            name: changed(getattr(default, name), value) if isinstance(value, dict) else value
            for name, value in values.items()
        },
    )
