# SPDX-License-Identifier: Apache-2.0
"""A start from a file: positions in a table, or an instant of a recorded run. No ROS."""

from __future__ import annotations

from pathlib import Path

from herding_ros.bag.table import read_table
from herding_ros.model.state import Array, HerdState
import numpy as np


def read_start(path: Path, instant: float) -> HerdState:
    """Return the herd of a CSV file, or of a bag's folder, at an instant [s] from its first state.

    The CSV file is one that `fit` takes, too: see `read_table`. It is the state that is nearest to
    the instant; sheep whose velocities were not recorded are at rest, and those that are out of
    sight, and dogs that are silent, are left out. Raises ValueError if it cannot be read, or holds
    no sheep or no dog.
    """
    try:
        return _of_bag(path, instant) if path.is_dir() else _of_table(path, instant)
    except (OSError, ValueError) as error:
        raise ValueError(f'start_from must be a CSV file or a bag, got {path}: {error}') from error


def _of_table(path: Path, instant: float) -> HerdState:
    table = read_table(path)
    k = _nearest(table.times, instant)
    sheep, dogs = (each[k, np.isfinite(each[k, :, 0])] for each in (table.sheep, table.dogs))
    return HerdState(sheep[:, :2], np.nan_to_num(sheep[:, 2:]), dogs[:, :2])


def _of_bag(folder: Path, instant: float) -> HerdState:
    from herding_ros.bag.reader import read_run  # it takes a moment, and is seldom needed

    run = read_run(folder)
    k = _nearest(run.times, instant)
    seen, heard = run.seen[k], np.isfinite(run.d[k, :, 0])
    return HerdState(run.x[k, seen], np.nan_to_num(run.v[k, seen]), run.d[k, heard])


def _nearest(times: Array, instant: float) -> int:
    return int(np.abs(times - times[0] - instant).argmin())
