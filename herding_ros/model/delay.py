# SPDX-License-Identifier: Apache-2.0
"""The time from a command until it takes effect."""

from __future__ import annotations

from .parameters import quantity

_MOST_PERIODS = 1000
"""Commands that are under way are kept."""


def delay_quantity(doc: str) -> float:
    """Return the declaration of a delay; see `periods`."""
    return quantity(0.0, f'{doc}; rounded to control periods', 's', low=0.0)  # type: ignore


def periods(name: str, delay: float, control_period: float) -> int:
    """Return a delay [s] in control periods, or raise ValueError that calls it by its name."""
    most = _MOST_PERIODS * control_period
    if delay > most:
        raise ValueError(
            f'{name} must be at most {_MOST_PERIODS} control periods, {most:g} s, got {delay!r}'
        )
    return round(delay / control_period)
