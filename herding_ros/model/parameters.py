"""What one can turn in the model: validated, documented numbers."""

from __future__ import annotations

import array
from collections.abc import Callable, Sequence
import dataclasses
from dataclasses import dataclass
import math
from numbers import Real
from typing import Any

import numpy as np

from .state import Array


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
            elif not _may_stand_for(getattr(self, field.name), field.default):
                function = ' or a function' if callable(field.default) else ''
                raise ValueError(
                    f'{type(self).__name__}.{field.name} is {getattr(self, field.name)!r}, '
                    f'allowed is a {type(field.default).__name__}{function}'
                )


def _may_stand_for(value: Any, group: Any) -> bool:
    """Whether value is of the group's kind; any function may stand for a group that is called."""
    is_function = callable(value) and not isinstance(value, type)
    return isinstance(value, type(group)) or (callable(group) and is_function)


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


@dataclass(frozen=True)
class Morse(Parameters):
    """Morse potential P(r) = C_r exp(-r / l_r) - C_a exp(-r / l_a) (paper, section 6)."""

    repulsion: float = quantity(1.0, 'strength C_r of the repulsion', 'm^2/s^2', low=0.0)
    repulsion_length: float = quantity(1e-2, 'range l_r of the repulsion', 'm', low=TINY)
    attraction: float = quantity(5e-4, 'strength C_a of the attraction', 'm^2/s^2', low=0.0)
    attraction_length: float = quantity(2.0, 'range l_a of the attraction', 'm', low=TINY)

    @property
    def coefficients(self) -> tuple[float, float, float, float]:
        """(C_r / l_r, 1 / l_r, C_a / l_a, 1 / l_a), what the kernels work with."""
        return (
            self.repulsion / self.repulsion_length,
            1.0 / self.repulsion_length,
            self.attraction / self.attraction_length,
            1.0 / self.attraction_length,
        )


NoiseFunction = Callable[[float, Array], Array | float]
"""A factor of sigma: from a time [s] and any places (N, 2) [m] to (N,), or one number for all.

Finite and not negative. The crowd's equations have a solution if |f(t, x)| <= C (1 + |x|) and
|f(t, x) - f(t, y)| <= D |x - y| for some C and D (paper, remark in section 2.2).
"""


@dataclass(frozen=True)
class NoiseField(Parameters):
    """How the noise depends on time t [s] and place x [m]: a factor of sigma, 1 by default.

    f(t, x) = max(1 + g.x, 0) (1 + a sin(2 pi t / T)) (1 + p exp(-|x - c|^2 / (2 l^2)))

    with slope g, gust a, period T, and a patch p at c of radius l. It keeps the paper's
    conditions, f(t, x) <= C (1 + |x|) and |f(t, x) - f(t, y)| <= D |x - y|, with

    C = (1 + a) (1 + max(p, 0)) max(1, |g|),
    D = (1 + a) (|g| (1 + max(p, 0)) + |p| ((1 + |g| |c|) e^(-1/2) / l + 2 |g| / e)).
    """

    slope: tuple[float, float] = quantity(
        (0.0, 0.0), 'sigma grows by this share of itself per metre in x and in y', '1/m'
    )
    gust: float = quantity(
        0.0, 'sigma swings up and down by this share of itself', low=0.0, high=1.0
    )
    period: float = quantity(10.0, 'time from one gust to the next', 's', low=TINY)
    patch: float = quantity(
        0.0, 'sigma is larger by this share of itself in the middle of the patch', low=-1.0
    )
    patch_centre: tuple[float, float] = quantity((0.0, 0.0), 'where the patch is', 'm')
    patch_radius: float = quantity(0.2, 'standard deviation of the patch', 'm', low=TINY)

    @property
    def is_uniform(self) -> bool:
        """Whether the factor is 1 everywhere and always."""
        return not (any(self.slope) or self.gust or self.patch)

    def __call__(self, t: float, x: Array) -> Array:
        """Return the factor (...) at t and places x (..., 2)."""
        slope = np.maximum(1.0 + self.slope[0] * x[..., 0] + self.slope[1] * x[..., 1], 0.0)
        gust = 1.0 + self.gust * math.sin(2.0 * math.pi * t / self.period)
        from_patch = np.square((x - self.patch_centre) / self.patch_radius).sum(axis=-1)
        return np.asarray(slope * gust * (1.0 + self.patch * np.exp(-0.5 * from_patch)))


@dataclass(frozen=True)
class Crowd(Parameters):
    """How sheep move (paper, state system). The defaults are the preset `cohesive`.

    What moves sheep at random is explained in `noise`.
    """

    sheep: Morse = Morse(1.0, 1e-2, 5e-4, 2.0)
    dog: Morse = Morse(1e-2, 0.5, 5e-4, 2.0)
    friction: float = quantity(0.5, 'friction alpha of the sheep', '1/s', low=0.0)
    noise: float = quantity(
        0.01, 'strength sigma of the random force on each sheep', 'm/s^1.5', low=0.0
    )
    common_noise: float = quantity(
        0.0, 'share of its variance that all sheep have in common', low=0.0, high=1.0
    )
    noise_field: NoiseField | NoiseFunction = NoiseField()


CROWDS = {
    'cohesive': Crowd(),
    'printed': Crowd(sheep=Morse(1.0, 2.0, 5e-4, 1e-2), dog=Morse(1e-2, 0.5, 5e-4, 1e-2)),
}
"""Crowds by name; `sheep` is the potential between two sheep, `dog` that of a dog on a sheep.

`cohesive` is the paper's with the two lengths swapped, so that the text's long-range
attraction and short-range repulsion hold; `printed` takes the paper by the letter, and the
crowd explodes.
"""
