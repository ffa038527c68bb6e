"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from .study import Goal, Row


def table(head: Sequence[str], rows: Iterable[Sequence[str]], nothing: str = 'no results') -> str:
    """Return a table, or the words for that there is nothing to show."""
    rows = list(rows)
    if not rows:
        return f'*{nothing}*'
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


def goals(found: Iterable[Goal]) -> str:
    """Return the table of what is aimed at."""
    words = {True: 'yes', False: '**no**', None: 'not known'}
    return table(
        ('', 'goal', 'measured', 'reached'),
        ((goal.text, goal.bound, goal.measured, words[goal.reached]) for goal in found),
    )


def overview(rows: Iterable[tuple[str, Row]]) -> str:
    """Return the table of all figures and tables, each with the study it comes from."""
    return table(
        ('figure or table', 'command', 'paper', 'ours', 'remark'),
        ((row.what, f'`study {name}`', row.paper, row.ours, row.remark) for name, row in rows),
    )
