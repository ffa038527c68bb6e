# SPDX-License-Identifier: Apache-2.0
"""What stamps say of the order of messages: time set back, messages that came late or astray."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import dropwhile
from typing import Any, NamedTuple

APART = 1_000_000_000
"""Stamps that differ by more than this do not follow each other [ns]."""


class Sample(NamedTuple):
    """A message of a topic: its place in the bag, its stamp [ns], and what was read of it.

    ns: the log time if it is not stamped; frame: '' without one; log_ns, publish_ns: when it was
    logged and published [ns].
    """

    place: int
    ns: int
    value: Any
    is_stamped: bool = True
    frame: str = ''
    log_ns: int = 0
    publish_ns: int = 0


class Restart(NamedTuple):
    """Time was set back between two states that follow each other in the bag."""

    last: Sample
    first: Sample


def restarts(states: Sequence[Sample], others: Sequence[Sequence[Sample]]) -> list[Restart]:
    """Return where time was set back, in the order in which that happened.

    All topics are set back then, by more than `APART`, or to before the beginning of the run. One
    that is alone in it has a clock that was corrected, or a message that came late.
    """
    found: list[Restart] = []
    begin = states[0].ns if states else 0
    places = [[sample.place for sample in other] for other in others]
    for k in range(1, len(states)):
        last, first = states[k - 1 : k + 1]
        if first.ns >= last.ns:
            continue
        # A single message astray, to either side, is not enough.
        before = min(sample.ns for sample in states[max(k - 2, 0) : k])
        after = max(sample.ns for sample in states[k : k + 2])
        if not (after + APART <= before or (first.ns <= begin and after <= before)):
            continue
        restart = Restart(last, first)
        votes = [
            vote
            for other, at in zip(others, places, strict=True)
            if (vote := _is_set_back(other, at, restart)) is not None
        ]
        if all(votes) and (votes or k + 1 < len(states)):
            found.append(restart)
            begin = first.ns
    return found


def _is_set_back(samples: Sequence[Sample], places: list[int], restart: Restart) -> bool | None:
    """Whether a topic was set back, too; None if it is silent before or after it."""
    last, first = restart
    # Messages between the two may belong to either.
    before, after = bisect_right(places, last.place), bisect_right(places, first.place)
    if after == len(samples):
        after -= 1
    if not 0 < before <= after:
        return None
    return 2 * (samples[before - 1].ns - samples[after].ns) >= last.ns - first.ns


def since(samples: Sequence[Sample], restart: Restart) -> list[Sample]:
    """Return what came after a restart, without late messages of the run before it."""
    last, first = restart

    def is_late(sample: Sample) -> bool:
        if not sample.is_stamped:
            return sample.place < first.place
        return abs(sample.ns - last.ns) < abs(sample.ns - first.ns)

    return list(dropwhile(is_late, (each for each in samples if each.place > last.place)))


def in_order(samples: Sequence[Sample]) -> tuple[list[Sample], int, list[Sample]]:
    """Return samples by their stamps, how many came late, and those that belong nowhere.

    The longest sequence of stamps that never decrease is in order. What is not in it is put
    where its stamp belongs, unless that is more than `APART` from where it came.
    """
    line = _longest_sequence([sample.ns for sample in samples])
    kept, late, astray = list(line), 0, []
    position = 0
    for k, sample in enumerate(samples):
        if position < len(line) and k == line[position]:
            position += 1
            continue
        low = samples[line[position - 1]].ns if position else sample.ns
        high = samples[line[position]].ns if position < len(line) else sample.ns
        if low - APART <= sample.ns <= high + APART:
            kept.append(k)
            late += 1
        else:
            astray.append(sample)
    return sorted((samples[k] for k in kept), key=lambda sample: sample.ns), late, astray


def _longest_sequence(stamps: Sequence[int]) -> list[int]:
    """Return the indices of the longest subsequence that never decreases (by patience sorting)."""
    lowest: list[int] = []  # the lowest stamp that ends a sequence of each length
    ends: list[int] = []  # where it is
    previous: list[int] = []
    for k, ns in enumerate(stamps):
        length = bisect_right(lowest, ns)
        previous.append(ends[length - 1] if length else -1)
        lowest[length : length + 1] = [ns]
        ends[length : length + 1] = [k]
    found = []
    k = ends[-1] if ends else -1
    while k >= 0:
        found.append(k)
        k = previous[k]
    return found[::-1]
