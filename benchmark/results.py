# SPDX-License-Identifier: Apache-2.0
"""The figures of a run of the benchmark, read from its JSON."""

from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

Entry = dict[str, Any]
"""The record of one benchmark: `what` it measured, the case, and its figures."""


@dataclass(frozen=True)
class Results:
    """All entries of one run, and the machine they are from."""

    entries: list[Entry]
    machine: dict[str, str]

    @classmethod
    def read(cls, path: Path) -> Results:
        """Read what pytest-benchmark has written."""
        content = json.loads(path.read_text(encoding='utf-8'))
        entries = [each['extra_info'] for each in content['benchmarks']]
        return cls([entry for entry in entries if entry], content['machine_info'])

    def of(self, what: str, **case: Any) -> list[Entry]:
        """Return the entries of this kind that have all these values."""
        return [
            entry
            for entry in self.entries
            if entry['what'] == what and all(entry.get(key) == case[key] for key in case)
        ]

    def values(self, key: str, what: str, **case: Any) -> list[float]:
        """Return the values under this key of all such entries in one list."""
        return [value for entry in self.of(what, **case) for value in entry[key]]
