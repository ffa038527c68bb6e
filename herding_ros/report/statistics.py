# SPDX-License-Identifier: Apache-2.0
"""Estimates with their uncertainty, and how they are written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Mean:
    """A mean and its standard error, which is NaN for a single value."""

    value: float
    error: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Mean:
        """Return the mean of independent values; NaN without any."""
        n = len(values)
        value = float(np.mean(values)) if n else math.nan
        error = float(np.std(values, ddof=1)) / math.sqrt(n) if n > 1 else math.nan
        return cls(value, error, n)

    def __str__(self) -> str:
        """Return `value ± error`, the error with two digits and the value to the same place."""
        if math.isnan(self.error) or self.error == 0.0:
            return significant(self.value)
        place = 1 - math.floor(math.log10(self.error))
        largest = max(abs(self.value), self.error)
        exponent = math.floor(math.log10(largest)) if largest < 1e-2 else 0
        place = max(place + exponent, 0)
        value, error = (
            f'{round(each / 10.0**exponent, place) + 0.0:.{place}f}'  # + 0.0 turns -0.0 into 0.0
            for each in (self.value, self.error)
        )
        return f'({value} ± {error})e{exponent}' if exponent else f'{value} ± {error}'


@dataclass(frozen=True)
class Fraction:
    """A fraction of successes with its exact 95 % confidence interval (Clopper and Pearson)."""

    successes: int
    count: int
    low: float
    high: float

    @classmethod
    def of(cls, outcomes: Sequence[bool]) -> Fraction:
        """Return the fraction of independent outcomes that are true."""
        k, n = sum(map(bool, outcomes)), len(outcomes)
        if not n:
            return cls(0, 0, 0.0, 1.0)
        from scipy import stats  # it takes a second to load, and who computes needs none

        interval = stats.binomtest(k, n).proportion_ci(0.95, method='exact')
        return cls(k, n, float(interval.low), float(interval.high))

    @property
    def value(self) -> float:
        """The fraction itself; NaN without outcomes."""
        return self.successes / self.count if self.count else math.nan

    def __str__(self) -> str:
        """Return `k of n (low to high %)`."""
        if not self.count:
            return '–'
        low, high = 100.0 * self.low, 100.0 * self.high
        return f'{self.successes} of {self.count} ({low:.0f} to {high:.0f} %)'


@dataclass(frozen=True)
class Median:
    """A median with its 95 % confidence interval from order statistics.

    Infinity is a value like any other: it stands for an event that has not happened. With too
    few values for the confidence the interval is unbounded.
    """

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Median:
        """Return the median of independent values; NaN without any."""
        if not len(values):
            return cls(math.nan, math.nan, math.nan)
        from scipy import stats

        ordered = np.sort(np.asarray(values, dtype=float))
        n = len(ordered)
        # The number of values below the true median is binomial, whatever their distribution.
        rank = int(stats.binom.ppf(0.025, n, 0.5))
        middle = ordered[(n - 1) // 2], ordered[n // 2]
        value = middle[0] if middle[0] == middle[1] else 0.5 * (middle[0] + middle[1])
        if rank == 0:
            return cls(float(value), -math.inf, math.inf)
        return cls(float(value), float(ordered[rank - 1]), float(ordered[n - rank]))

    def __str__(self) -> str:
        """Return `median (low to high)`."""
        if math.isnan(self.value):
            return '–'
        low = 'less' if self.low == -math.inf else significant(self.low)
        high = 'more' if self.high == math.inf else significant(self.high)
        value = 'never' if self.value == math.inf else significant(self.value)
        return f'{value} ({low} to {high})'


@dataclass(frozen=True)
class Quartiles:
    """Median and quartiles of repeated measurements."""

    low: float
    median: float
    high: float

    @classmethod
    def of(cls, values: Any) -> Quartiles:
        """Return those of a non-empty array of any shape."""
        return cls(*(float(q) for q in np.percentile(values, [25, 50, 75])))

    def __str__(self) -> str:
        """Return `median (quartile to quartile)`."""
        low, median, high = map(significant, (self.low, self.median, self.high))
        return f'{median} ({low} to {high})'


def significant(value: float, digits: int = 3) -> str:
    """Return a value with this many significant digits; a dash for NaN and infinity."""
    if not math.isfinite(value):
        return '–'
    size = math.floor(math.log10(abs(value))) if value else 0
    if value and (size < -2 or size > 5):
        return f'{value:.{digits - 1}e}'.replace('e-0', 'e-').replace('e+0', 'e')
    return f'{value:.{max(digits - 1 - size, 0)}f}'
