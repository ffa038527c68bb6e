# SPDX-License-Identifier: Apache-2.0
"""What was left out of a recorded run, and why."""

from __future__ import annotations

from herding_ros.checks import Refused

_LONGEST = 500
"""Characters of a line."""


class Notes:
    """One line for each cause, in the order in which they came up."""

    def __init__(self) -> None:
        self._lines: dict[object, str] = {}
        self._counts: dict[object, int] = {}

    def add(self, line: str) -> None:
        """Add a line."""
        self._lines[line] = line

    def leave_out(self, topic: str, error: Refused) -> None:
        """Note that a message of a topic is left out; the first of each kind gives its reason."""
        key = topic, error.kind
        self._counts[key] = self._counts.get(key, 0) + 1
        self._lines.setdefault(key, f'{topic} ({error.kind}): {error}')

    def lines(self) -> tuple[str, ...]:
        """Return all of them, printable on a terminal."""
        return tuple(
            printable(self._line(key, line)[:_LONGEST]) for key, line in self._lines.items()
        )

    def _line(self, key: object, line: str) -> str:
        if key not in self._counts:
            return line
        return f'left out {counted(self._counts[key], "message")} of {line}'


def counted(count: int, word: str) -> str:
    """Return a count with its word, in the plural unless it is 1."""
    return f'{count} {word}{"" if count == 1 else "s"}'


def printable(text: str) -> str:
    """Return a text that may quote a bag without characters that would control a terminal."""
    return ''.join(each if each.isprintable() else '?' for each in text)
