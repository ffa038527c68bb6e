# SPDX-License-Identifier: Apache-2.0
"""What every message is checked for; conversions raise Refused on what must not move a dog."""

from __future__ import annotations

import math

from herding_ros.nodes.refusals import Refused

LARGEST = 1e8
"""No coordinate [m] or velocity [m/s] is larger, in any projection of the Earth."""

_CLOCKS = 'do all nodes use the same clock (use_sim_time)?'


def check_frame(what: str, given: str, *allowed: str) -> None:
    """Raise Refused unless a message is in one of the allowed frames."""
    if given not in allowed:
        names = ' or '.join(f"'{name}'" for name in allowed)
        raise Refused('wrong frame', f'{what} must be in frame {names}, got {given!r}')


def check_stamp(ns: int, now: int, oldest: float, ahead: float) -> None:
    """Raise Refused when a stamp [ns] is more than `oldest` [s] before now or `ahead` after it."""
    age = (now - ns) * 1e-9
    if age > oldest:
        raise Refused(
            'stamp too old',
            f'it must be at most {oldest:g} s old, got {age:g} s; {_CLOCKS}',
        )
    if age < -ahead:
        raise Refused(
            'stamp in the future',
            f'it must be stamped at most {ahead:g} s ahead, got {-age:g} s; {_CLOCKS}',
        )


def check_size(what: str, *values: float) -> None:
    """Raise Refused unless values are finite and of a size that a pasture has."""
    size = math.hypot(*values)
    if not size <= LARGEST:
        check_finite(what, *values)
        raise Refused('too large', f'{what} must be at most {LARGEST:g}, got {size:g} [m, m/s]')


def check_finite(what: str, *values: float) -> None:
    """Raise Refused unless all values are finite."""
    if not all(map(math.isfinite, values)):
        raise Refused('not finite', f'{what} must be finite, got NaN or infinite values')
