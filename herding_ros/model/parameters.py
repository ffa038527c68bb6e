"""What one can turn in the model: validated, documented numbers."""

from __future__ import annotations

import array
from collections.abc import Sequence
import dataclasses
from dataclasses import dataclass
from functools import cache
import math
from numbers import Real
from typing import Any, get_type_hints

import numpy as np


def quantity(
    default: Any,
    doc: str,
    unit: str = '',
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """Return a dataclass field that knows its meaning, unit and bounds (inclusive)."""
    metadata = {'doc': doc, 'unit': unit, 'low': low, 'high': high, 'choices': choices}
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Parameters:
    """Base of every set of parameters: checks each field against its declaration.

    Raises ValueError on construction, naming the field, what was given, what is allowed.
    """

    def __post_init__(self) -> None:
        """Check type, finiteness, bounds and choices of each field."""
        for field in dataclasses.fields(self):
            if field.metadata:
                value = getattr(self, field.name)
                checked = check(f'{type(self).__name__}.{field.name}', value, field)
                object.__setattr__(self, field.name, checked)
            else:
                types = _types(type(self))  # type: ignore[arg-type]  # mypy asks its instances
                group, kind = getattr(self, field.name), types[field.name]
                if not isinstance(group, kind):
                    raise ValueError(
                        f'{type(self).__name__}.{field.name} is {group!r}, '
                        f'allowed is a {kind.__name__}'
                    )


@cache  # a filter makes a crowd at every step
def _types(kind: type[Parameters]) -> dict[str, Any]:
    """Return the types of the fields."""
    return get_type_hints(kind)


def check(name: str, value: Any, field: dataclasses.Field[Any]) -> Any:
    """Return value converted to the field's type, or raise ValueError if not allowed."""
    converted = _convert(value, field.default)
    if converted is None or not _within(converted, field):
        raise ValueError(f'{name} is {value!r}, allowed is {describe_limits(field)}')
    return converted


def _convert(value: Any, like: Any) -> Any:
    """Return value with the type of `like`; None if that would change its meaning."""
    if isinstance(like, tuple):
        if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray | array.array):
            return None
        parts = tuple(_convert(each, part) for each, part in zip(value, like, strict=False))
        return parts if len(value) == len(like) and None not in parts else None
    if isinstance(like, float):
        number = isinstance(value, Real) and not isinstance(value, bool)
        return float(value) if number else None
    return value if type(value) is type(like) else None


def _within(value: Any, field: dataclasses.Field[Any]) -> bool:
    """Whether value keeps the field's bounds and choices."""
    low, high, choices = (field.metadata[key] for key in ('low', 'high', 'choices'))
    if isinstance(value, (bool, str)):
        return not choices or value in choices
    return all(
        math.isfinite(number)
        and (low is None or number >= low)
        and (high is None or number <= high)
        for number in (value if isinstance(value, tuple) else (value,))
    )


def describe_limits(field: dataclasses.Field[Any]) -> str:
    """Say in words what the field allows, for error messages and parameter tables."""
    low, high, choices = (field.metadata[key] for key in ('low', 'high', 'choices'))
    if choices:
        return ' or '.join(choices)
    if isinstance(field.default, tuple):
        words = f'{len(field.default)} numbers'
    else:
        kinds = {float: 'a number', int: 'an integer', bool: 'true or false', str: 'a text'}
        words = kinds[type(field.default)]
    if low is not None and high is not None:
        return f'{words} from {low:g} to {high:g}'
    if low is not None:
        return f'{words} of at least {low:g}'
    if high is not None:
        return f'{words} of at most {high:g}'
    return words


TINY = 1e-9
"""Lower bound of quantities that must be positive."""
