# SPDX-License-Identifier: Apache-2.0
"""What in the graph is worth a look. No ROS."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any, TypeVar

_T = TypeVar('_T', bound=Hashable)

LOOK_ROUNDS = 20
"""Rounds after which a topic with as many ends as before is looked at: one may be another."""


class Looks:
    """Chooses topics whose ends are looked at: that takes ten times as long as to count them."""

    def __init__(self) -> None:
        self._round = 0
        self._counts: Mapping[Any, object] = {}

    def due(self, counts: Mapping[_T, object]) -> list[_T]:
        """Return the topics that are new, have more or fewer ends, or have their turn.

        To be called once a round; counts: how many ends there are of each topic.
        """
        before, self._counts = self._counts, counts
        self._round += 1
        return [
            topic
            for k, (topic, count) in enumerate(counts.items(), start=self._round)
            if topic not in before or count != before[topic] or k % LOOK_ROUNDS == 0
        ]
