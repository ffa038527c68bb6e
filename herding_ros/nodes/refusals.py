# SPDX-License-Identifier: Apache-2.0
"""Messages that a node refuses: each cause is logged once and every message counted."""

from __future__ import annotations

import time

from herding_ros.checks import Refused
from rclpy.impl.rcutils_logger import RcutilsLogger

_LONGEST_REASON = 300
"""Characters of a reason that are logged: it may quote what a message holds."""

_MOST_CAUSES = 5
"""Causes of one kind on one topic that are logged: a stranger may make up any number."""

_REQUEST_PERIOD = 1.0
"""Least time between two lines about refused requests [s]: they may come at any rate."""


class Refusals:
    """Bad messages by topic and kind."""

    def __init__(self, logger: RcutilsLogger) -> None:
        """Log to `logger`."""
        self.counts: dict[str, int] = {}
        self._logger = logger
        self._causes: dict[str, set[str]] = {}
        self._requests: dict[str, tuple[str, float]] = {}

    def report_values(self) -> dict[str, object]:
        """Return the counts for /diagnostics."""
        return {f'refused {key}': count for key, count in self.counts.items()}

    def add(self, topic: str, error: ValueError) -> None:
        """Count a message refused on a topic, e.g. 'sheep', by the kind of the error.

        It is logged if it is the first one for its cause.
        """
        key, cause = self._count(topic, error)
        causes = self._causes.setdefault(key, set())
        if cause not in causes and len(causes) < _MOST_CAUSES:
            causes.add(cause)
            self._log(key, f'{_reason(error)}; further ones are counted')

    def add_request(self, topic: str, error: ValueError) -> None:
        """Count a message that somebody sent once and waits for the effect of, such as a goal.

        It is logged if it is the first of its kind, or refused for another reason than the one
        that was logged last.
        """
        key, _ = self._count(topic, error)
        reason, now = _reason(error), time.monotonic()
        last, logged = self._requests.get(topic, ('', 0.0))
        is_due = self.counts[key] == 1 or now >= logged + _REQUEST_PERIOD
        if reason != last and is_due:
            self._requests[topic] = reason, now
            self._log(key, reason)

    def _count(self, topic: str, error: ValueError) -> tuple[str, str]:
        kind, cause = 'not allowed', ''
        if isinstance(error, Refused):
            kind, cause = error.kind, error.cause
        key = f'{topic}: {kind}'
        self.counts[key] = self.counts.get(key, 0) + 1
        return key, cause

    def _log(self, key: str, reason: str) -> None:
        self._logger.warning(f'refused a message ({key}): {reason}')


def _reason(error: ValueError) -> str:
    return str(error)[:_LONGEST_REASON]
