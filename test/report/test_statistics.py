# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

from herding_ros.report.statistics import Fraction, Mean, Median, Quartiles, significant
import numpy as np
import pytest


@pytest.mark.parametrize(
    ('successes', 'count', 'low', 'high'),
    [
        # From (alpha/2)^(1/n), and from published tables of Clopper and Pearson.
        (20, 20, 0.025 ** (1 / 20), 1.0),
        (0, 20, 0.0, 1.0 - 0.025 ** (1 / 20)),
        (19, 20, 0.7513, 0.9987),
        (10, 20, 0.2720, 0.7280),
        (200, 200, 0.025 ** (1 / 200), 1.0),
    ],
)
def test_interval_of_a_fraction(successes: int, count: int, low: float, high: float) -> None:
    found = Fraction.of([True] * successes + [False] * (count - successes))
    assert (found.successes, found.count) == (successes, count)
    assert (found.low, found.high) == pytest.approx((low, high), abs=5e-5)


def test_mean_and_its_error() -> None:
    found = Mean.of([1.0, 2.0, 3.0, 6.0])
    assert found.value == 3.0
    assert found.error == pytest.approx(math.sqrt(14.0 / 3.0) / 2.0)
    assert math.isnan(Mean.of([2.0]).error)
    assert math.isnan(Mean.of([]).value)


def test_interval_of_a_median_is_from_order_statistics() -> None:
    """For n = 20 the 6th and 15th value, for n = 10 the 2nd and 9th: standard tables."""
    found = Median.of(np.arange(20, 0, -1.0).tolist())
    assert (found.value, found.low, found.high) == (10.5, 6.0, 15.0)
    found = Median.of(np.arange(1.0, 11.0).tolist())
    assert (found.value, found.low, found.high) == (5.5, 2.0, 9.0)
    assert (Median.of([3.0]).low, Median.of([3.0]).high) == (-math.inf, math.inf)


def test_interval_of_a_median_holds_it_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    inside = [
        found.low <= math.log(2.0) <= found.high
        for found in (Median.of(rng.exponential(size=20).tolist()) for _ in range(1000))
    ]
    assert 0.94 < np.mean(inside) < 0.98


def test_what_never_came_counts_in_a_median() -> None:
    assert Median.of([1.0, 2.0, math.inf]).value == 2.0
    assert Median.of([1.0, math.inf, math.inf]).value == math.inf
    assert str(Median.of([math.inf] * 20)).startswith('never')


@pytest.mark.parametrize(
    ('mean', 'text'),
    [
        (Mean(0.12345, 0.0123, 9), '0.123 ± 0.012'),
        (Mean(123.4, 5.67, 9), '123.4 ± 5.7'),
        (Mean(1234.0, 56.0, 9), '1234 ± 56'),
        (Mean(3.214e-3, 4.5e-4, 9), '(3.21 ± 0.45)e-3'),
        (Mean(4e-3, 0.024, 9), '0.004 ± 0.024'),
        (Mean(-4e-16, 7.3e-3, 9), '(0.0 ± 7.3)e-3'),
        (Mean(4.0, 0.0, 9), '4.00'),
        (Mean(math.nan, math.nan, 0), '–'),
    ],
)
def test_a_mean_is_written_to_the_digits_it_has(mean: Mean, text: str) -> None:
    assert str(mean) == text


@pytest.mark.parametrize(
    ('value', 'text'),
    [(0.5, '0.500'), (31.26, '31.3'), (3400.0, '3400'), (1.234e-4, '1.23e-4'), (0.0, '0.00')],
)
def test_significant_digits(value: float, text: str) -> None:
    assert significant(value) == text


def test_quartiles_are_shown_with_three_digits() -> None:
    assert str(Quartiles.of([0.01234, 12345.6, 3.14159, 2.0, 4.0])) == '3.14 (2.00 to 4.00)'
