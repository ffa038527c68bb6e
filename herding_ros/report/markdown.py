# SPDX-License-Identifier: Apache-2.0
"""Tables in Markdown, for the pages of the studies and of the benchmark."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from .statistics import significant


@dataclass(frozen=True)
class Goal:
    """A goal, what was measured, and whether that is enough (None: not known)."""

    text: str
    bound: str
    measured: object
    reached: bool | None


def table(rows: Iterable[Mapping[str, object]], nothing: str = 'no results') -> str:
    """Return rows, which share their keys, as a table with the keys as its head.

    Floats have three significant digits, None is an empty cell. Without rows: `nothing`.
    """
    rows = list(rows)
    if not rows:
        return f'*{nothing}*'
    head = list(rows[0])
    body = [[_cell(row[key]) for key in head] for row in rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in [head, ['---'] * len(head), *body])


def _cell(value: object) -> str:
    if isinstance(value, float):
        return significant(value)
    return '' if value is None else str(value)


def goals(found: Iterable[Goal]) -> str:
    """Return the table of goals."""
    words = {True: 'yes', False: '**no**', None: 'not known'}
    return table(
        {
            '': goal.text,
            'goal': goal.bound,
            'measured': goal.measured,
            'reached': words[goal.reached],
        }
        for goal in found
    )
