# SPDX-License-Identifier: Apache-2.0
"""Units as parameters state them, such as m/s^1.5, and what a quantity is in larger ones."""

from __future__ import annotations

from functools import cache
import re

_POWER = re.compile(r'(1|[a-z]+)(?:\^([0-9.]+))?')


@cache
def factor(unit: str, length: float, time: float) -> float:
    """Return what a quantity with this unit is multiplied by where lengths and times are.

    m/s^1.5 is multiplied by length / time**1.5, for example; angles and bytes stay. The factor is
    exact if length and time are powers of four. Raises ValueError for what is not a unit.
    """
    powers = {'m': 0.0, 's': 0.0, 'rad': 0.0, 'byte': 0.0, '1': 0.0}
    for position, part in enumerate(unit.split('/') if unit else []):
        match = _POWER.fullmatch(part)
        if not match or match[1] not in powers:
            raise ValueError(
                'unit must be powers of m, s, rad and byte in a row, such as m, 1/s or m/s^1.5, '
                f'got {unit!r}'
            )
        powers[match[1]] += float(match[2] or 1.0) * (1.0 if position == 0 else -1.0)
    return float(length ** powers['m'] * time ** powers['s'])
