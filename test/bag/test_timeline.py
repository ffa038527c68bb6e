# SPDX-License-Identifier: Apache-2.0
"""Time that is set back, and single messages that came late or have a wrong stamp."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from herding_ros.bag.timeline import APART, in_order, restarts, Sample, since
from hypothesis import given
from hypothesis import strategies as st
import pytest

RUN = [float(k) for k in range(10)]


def samples(seconds: Sequence[float], first: int = 0, step: int = 2) -> list[Sample]:
    return [
        Sample(first + step * k, round(s * 1e9), f'{s}@{first + step * k}')
        for k, s in enumerate(seconds)
    ]


def stamps(found: Sequence[Sample]) -> list[float]:
    return [sample.ns * 1e-9 for sample in found]


@pytest.mark.parametrize(
    ('sheep', 'dog', 'times'),
    [
        (RUN, RUN, []),
        (RUN + RUN, RUN + RUN, [0.0]),
        (RUN + RUN[:3] + RUN, RUN + RUN[:3] + RUN, [0.0, 0.0]),
        ([*RUN, 0.0], [*RUN, 0.0], [0.0]),  # the bag ends there
        (RUN + RUN, [*RUN, *[9.0 + k for k in RUN]], []),  # a tracker's clock alone
        ([*RUN[:9], 8.5, 9.0], RUN, []),  # one that came late
        ([*RUN[:8], 0.0, 9.0], RUN, []),  # one without a time
        ([*RUN[:4], 1e6, *RUN[4:]], [*RUN[:4], 1e6, *RUN[4:]], []),  # a clock's blink
        ([5.0, 5.1, 5.2, 5.0, 5.1], [5.0, 5.1, 5.2, 5.0, 5.1], [5.0]),  # after less than APART
        ([5.0, 5.1, 5.2, 5.15, 5.3], [5.0, 5.1, 5.2, 5.15, 5.3], []),
        (RUN + RUN, RUN[:5], [0.0]),  # a dog that had been silent before
    ],
)
def test_time_is_set_back_where_all_topics_are(
    sheep: list[float], dog: list[float], times: list[float]
) -> None:
    found = restarts(samples(sheep), [samples(dog, first=1)])
    assert [restart.first.ns * 1e-9 for restart in found] == times


def test_what_came_late_of_the_run_before_is_not_of_the_next() -> None:
    sheep = samples(RUN + RUN)
    (restart,) = restarts(sheep, [])
    assert restart == (sheep[9], sheep[10])
    command = samples([*RUN, 9.0, 0.0, 1.0], first=1)
    assert stamps(since(command, restart)) == [0.0, 1.0]
    assert stamps(since(sheep, restart)) == RUN


def test_late_messages_are_put_in_order_and_stray_ones_left_out() -> None:
    found, late, astray = in_order(samples([0, 1, 2, 1.5, 3, 100, 4, -50, 5, 5, 4.2]))
    assert stamps(found) == [0, 1, 1.5, 2, 3, 4, pytest.approx(4.2), 5, 5]
    assert late == 2
    assert stamps(astray) == [100, -50]


@given(st.lists(st.integers(-5, 5), max_size=9))
def test_as_few_as_possible_are_moved(seconds: list[int]) -> None:
    found, late, astray = in_order(samples([float(s) for s in seconds]))
    assert stamps(found) == sorted(stamps(found))
    assert len(found) + len(astray) == len(seconds)
    longest = max(
        size
        for size in range(len(seconds) + 1)
        for chosen in combinations(seconds, size)
        if list(chosen) == sorted(chosen)
    )
    assert late + len(astray) == len(seconds) - longest
    assert APART == 10**9
