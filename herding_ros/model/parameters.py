# SPDX-License-Identifier: Apache-2.0
"""Parameters: frozen dataclasses of validated, documented values, nested at will."""

from __future__ import annotations

import array
from collections.abc import Iterator, Mapping, Sequence
import dataclasses
from dataclasses import dataclass
from functools import cache
import math
from numbers import Real
from typing import Any, get_type_hints, NamedTuple, TypeVar

import numpy as np

from .units import factor

_P = TypeVar('_P', bound='Parameters')

TINY = 1e-9
"""Lower bound of quantities that must be positive."""

LARGE = 1e9
"""Bound of numbers that have no other: products of some such numbers are finite."""


def quantity(
    default: Any,
    doc: str,
    unit: str = '',
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    live: bool = False,
) -> Any:
    """Return a dataclass field with its meaning, unit and bounds (inclusive).

    Numbers with a point have bounds in any case: those that are not given are `LARGE`. live: the
    value may change while a node runs (a dynamic parameter).
    """
    if type(default[0] if isinstance(default, tuple) else default) is float:
        low, high = -LARGE if low is None else low, LARGE if high is None else high
    metadata = {
        'doc': doc, 'unit': unit, 'low': low, 'high': high, 'choices': choices, 'live': live,
    }  # fmt: skip
    return dataclasses.field(default=default, metadata=metadata)


class Entry(NamedTuple):
    """A value, its dotted name, and the field that declares it."""

    name: str
    value: Any
    field: dataclasses.Field[Any]


@dataclass(frozen=True)
class Parameters:
    """Base of every set of parameters: checks each field against its declaration.

    A field is a `quantity`, or a set of parameters itself; the values of the latter have dotted
    names, as in ROS. Raises ValueError on construction, with the field, what it must be and what
    was given.
    """

    def __post_init__(self) -> None:
        """Check type, finiteness, bounds and choices of each field."""
        for field in dataclasses.fields(self):
            name, value = f'{type(self).__name__}.{field.name}', getattr(self, field.name)
            if field.metadata:
                object.__setattr__(self, field.name, check(name, value, field))
                continue
            kind = _types(type(self))[field.name]  # type: ignore[arg-type]  # mypy: its instances
            # A class has the methods that a protocol asks for, too.
            if isinstance(value, type) or not isinstance(value, kind):
                article = 'an' if kind.__name__[0] in 'AEIOU' else 'a'
                raise ValueError(f'{name} must be {article} {kind.__name__}, got {value!r}')

    def walk(self, prefix: str = '') -> Iterator[Entry]:
        """Yield every value with its dotted name after the prefix, those of nested sets too."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Parameters):
                yield from value.walk(f'{prefix}{field.name}.')
            elif field.metadata:
                yield Entry(prefix + field.name, value, field)

    def flat(self, prefix: str = '') -> dict[str, Any]:
        """Return the values by their dotted names after the prefix."""
        return {entry.name: entry.value for entry in self.walk(prefix)}

    def with_values(self: _P, values: Mapping[str, Any], prefix: str = '') -> _P:
        """Return these parameters with the values of some dotted names replaced.

        Raises ValueError for a value that a field does not allow, and for a name that is not one
        of `flat(prefix)`.
        """
        if unknown := sorted(set(values) - set(self.flat(prefix))):
            raise ValueError(f'{type(self).__name__} has no parameter {", ".join(unknown)}')
        return _replaced(self, values, prefix)

    def rescaled(self: _P, length: float, time: float) -> _P:
        """Return these parameters in a world whose lengths and times are so many times ours.

        Each value is multiplied by the `factor` of its unit. Integers stay: they count steps, or
        wall time. Raises ValueError for a part that is not made of parameters, such as a function
        of the user's: its units are not known.
        """
        changes: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Parameters):
                changes[field.name] = value.rescaled(length, time)
            elif not field.metadata:
                raise ValueError(
                    f'{type(self).__name__}.{field.name} must be made of parameters, whose units '
                    f'are known, to be rescaled, got {value!r}'
                )
            elif field.metadata['unit'] and not isinstance(value, int):
                times = factor(field.metadata['unit'], length, time)
                several = isinstance(value, tuple)
                changes[field.name] = (
                    tuple(times * each for each in value) if several else times * value
                )
        return dataclasses.replace(self, **changes)


def _replaced(parameters: _P, values: Mapping[str, Any], prefix: str) -> _P:
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(parameters):
        value, name = getattr(parameters, field.name), prefix + field.name
        if isinstance(value, Parameters):
            changes[field.name] = _replaced(value, values, f'{name}.')
        elif name in values:
            changes[field.name] = values[name]
    return dataclasses.replace(parameters, **changes)


@cache  # a filter makes a crowd at every step
def _types(kind: type[Parameters]) -> dict[str, Any]:
    """Return the types of the fields."""
    return get_type_hints(kind)


def check(name: str, value: Any, field: dataclasses.Field[Any]) -> Any:
    """Return value converted to the field's type; ValueError if the field does not allow it."""
    converted = _convert(value, field.default)
    if converted is not None and _within(converted, field):
        return converted
    right_kind = type(converted) in (int, float) and math.isfinite(converted)
    must_be = _bounds(field) if right_kind else describe_limits(field)
    raise ValueError(f'{name} must be {must_be}, got {value!r}')


def _convert(value: Any, like: Any) -> Any:
    """Return value with the type of `like`; None if that would change its meaning."""
    if isinstance(value, np.generic):
        value = value.item()  # a scalar of Python
    if isinstance(like, tuple):
        if _are_strings(like):
            is_strings = isinstance(value, list | tuple) and all(type(v) is str for v in value)
            return tuple(value) if is_strings else None
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
    if _are_strings(field.default):
        return True
    return all(
        math.isfinite(number)
        and (low is None or number >= low)
        and (high is None or number <= high)
        for number in (value if isinstance(value, tuple) else (value,))
    )


def _are_strings(default: object) -> bool:
    """Whether a field takes any number of strings."""
    return isinstance(default, tuple) and bool(default) and isinstance(default[0], str)


def describe_limits(field: dataclasses.Field[Any]) -> str:
    """Return in words what a field must be, for error messages and parameter tables."""
    if field.metadata['choices']:
        return ' or '.join(field.metadata['choices'])
    if isinstance(field.default, tuple):
        kind = 'strings' if _are_strings(field.default) else f'{len(field.default)} numbers'
    else:
        kinds = {float: 'a number', int: 'an integer', bool: 'true or false', str: 'a string'}
        kind = kinds[type(field.default)]
    bounds = _bounds(field)
    return f'{kind}{" of" if bounds.startswith("at") else ""} {bounds}'.rstrip()


def _bounds(field: dataclasses.Field[Any]) -> str:
    low, high = field.metadata['low'], field.metadata['high']
    if low is not None and high is not None:
        return f'from {low:g} to {high:g}'
    if low is not None:
        return f'at least {low:g}'
    return '' if high is None else f'at most {high:g}'
