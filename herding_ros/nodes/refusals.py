"""Messages that a node refuses: said once, counted always."""

from __future__ import annotations

from rclpy.impl.rcutils_logger import RcutilsLogger


class Refusals:
    """Bad messages by kind: each kind is logged once and counted."""

    def __init__(self, logger: RcutilsLogger) -> None:
        """Log to `logger`."""
        self.counts: dict[str, int] = {}
        self._logger = logger

    def add(self, kind: str, error: ValueError) -> None:
        """Count a refused message of a kind, e.g. 'sheep'."""
        if kind not in self.counts:
            self._logger.warning(f'refused a message ({kind}): {error}; further ones are counted')
        self.counts[kind] = self.counts.get(kind, 0) + 1
