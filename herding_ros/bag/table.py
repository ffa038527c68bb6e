# SPDX-License-Identifier: Apache-2.0
"""Sheep and dogs in a table (CSV): what was seen where and when."""

from __future__ import annotations

from collections.abc import Iterator
import csv
from dataclasses import dataclass
import math
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

COLUMNS = ('time', 'name', 'x', 'y')
"""Columns that a table must have; vx and vy may be there too."""

_NUMBERS = ('time', 'x', 'y', 'vx', 'vy')


@dataclass(frozen=True)
class Table:
    """What a table says: T instants, N sheep and M dogs, both in the order of their names.

    times: (T,) [s], increasing; sheep: (T, N, 4) and dogs: (T, M, 4), each x, y [m], vx, vy [m/s];
    NaN where a table has no row or no velocity.
    """

    times: NDArray[np.float64]
    sheep: NDArray[np.float64]
    dogs: NDArray[np.float64]


def read_table(path: str | os.PathLike[str]) -> Table:
    """Read a CSV file: a row for each animal and instant.

    Its columns are time [s], name, x, y [m], and, if velocities were measured, vx, vy [m/s]. Names
    that begin with `dog` are those of dogs, all others those of sheep. Empty lines, and those that
    begin with #, do not count. Raises OSError when it cannot be read, ValueError with the line
    that is wrong, and without sheep or dogs.
    """
    rows = list(_rows(Path(path)))
    times = np.unique([row[0] for row in rows])
    names = sorted({row[1] for row in rows})
    animals = {name: i for i, name in enumerate(names)}
    seen = np.full((len(times), len(names), 4), np.nan)
    for time, name, values in rows:
        seen[np.searchsorted(times, time), animals[name]] = values
    dogs = np.array([name.startswith('dog') for name in names], dtype=bool)
    if dogs.all() or not dogs.any():
        raise ValueError(
            f'{path}: there must be sheep, and dogs with names that begin with dog, '
            f'got {", ".join(names[:10]) or "nothing"}'
        )
    return Table(times, seen[:, ~dogs], seen[:, dogs])


def _rows(path: Path) -> Iterator[tuple[float, str, list[float]]]:
    with path.open(newline='', encoding='utf-8-sig') as file:  # spreadsheets begin with a mark
        numbered = [
            (number, line)
            for number, line in enumerate(file, 1)
            if line.strip() and not line.startswith('#')
        ]
    reader = csv.DictReader((line for _, line in numbered), skipinitialspace=True)
    missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
    if missing:
        raise ValueError(
            f'{path} must begin with a line that names the columns {", ".join(COLUMNS)}, '
            f'and vx, vy where velocities were measured; it lacks {", ".join(missing)}; '
            f'it has {", ".join(reader.fieldnames or ["nothing"])}'
        )
    known = set()
    for (number, _), row in zip(numbered[1:], reader, strict=False):
        where = f'{path}, line {number}'
        if None in row:  # DictReader puts there what is beyond the last column
            raise ValueError(f'{where}: there must be no more values than columns, got {row}')
        if not row['name']:
            raise ValueError(f'{where}: there must be a name, got {row}')
        try:
            time, *values = (float(row.get(key) or 'nan') for key in _NUMBERS)
        except ValueError:
            raise ValueError(f'{where}: must be numbers, got {row}') from None
        if not math.isfinite(time) or not math.isfinite(sum(values[:2])):
            raise ValueError(f'{where}: time, x and y must be finite, got {row}')
        name = row['name']
        if (time, name) in known:
            raise ValueError(f'{where}: {name} must be there once at {time:g} s')
        known.add((time, name))
        yield time, name, values
