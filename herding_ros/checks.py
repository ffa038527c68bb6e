# SPDX-License-Identifier: Apache-2.0
"""What every message is checked for, live and in a bag: what must not have any effect."""

from __future__ import annotations

import math

LARGEST = 1e8
"""No coordinate [m] or velocity [m/s] is larger, in any projection of the Earth."""


class Refused(ValueError):  # noqa: N818, a node goes on
    """A message that must not have any effect.

    `kind` is one of a few phrases, such as 'wrong frame', and never holds anything of the
    message: messages are counted by it. `cause` tells apart what has to be cured in different
    places, such as the frame that was given; '' if the kind says it all.
    """

    def __init__(self, kind: str, reason: str, cause: str = '') -> None:
        super().__init__(reason)
        self.kind = kind
        self.cause = cause


_CLOCKS = 'do all nodes use the same clock (use_sim_time)?'


def check_frame(what: str, given: str, *allowed: str) -> None:
    """Raise Refused unless a message is in one of the allowed frames."""
    if given not in allowed:
        names = ' or '.join(f"'{name}'" for name in allowed)
        reason = f'{what} must be in frame {names}, got {given!r}'
        raise Refused('wrong frame', reason, given)


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


def check_goal(given: str, x: float, y: float, frame: str) -> None:
    """Raise Refused unless a destination at x, y [m], in the frame given, may be herded to."""
    check_frame(f'goal ({x:g}, {y:g})', given, frame)
    check_size(f'goal ({x:g}, {y:g})', x, y)
