# SPDX-License-Identifier: Apache-2.0
"""Messages that a node refuses: each kind is logged once and counted always."""

from __future__ import annotations

from rclpy.impl.rcutils_logger import RcutilsLogger

_LONGEST_REASON = 300
"""Characters of a reason that are logged: it may quote what a message holds."""


class Refused(ValueError):  # noqa: N818, a node goes on
    """A message that must not have any effect.

    `kind` is one of a few phrases, such as 'wrong frame', and never holds anything of the
    message: messages are counted by it.
    """

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind


class Refusals:
    """Bad messages by topic and kind: each kind is logged once and counted."""

    def __init__(self, logger: RcutilsLogger) -> None:
        """Log to `logger`."""
        self.counts: dict[str, int] = {}
        self._logger = logger

    def report_values(self) -> dict[str, object]:
        """Return the counts for /diagnostics."""
        return {f'refused {key}': count for key, count in self.counts.items()}

    def add(self, topic: str, error: ValueError) -> None:
        """Count a message refused on a topic, e.g. 'sheep', by the kind of the error."""
        kind = error.kind if isinstance(error, Refused) else 'not allowed'
        key = f'{topic}: {kind}'
        if key not in self.counts:
            reason = str(error)[:_LONGEST_REASON]
            self._logger.warning(f'refused a message ({key}): {reason}; further ones are counted')
        self.counts[key] = self.counts.get(key, 0) + 1
