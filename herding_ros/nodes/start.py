# SPDX-License-Identifier: Apache-2.0
"""A start from a file: positions in a table, or an instant of a recorded run. No ROS."""

from __future__ import annotations

import csv
from pathlib import Path

from herding_ros.model.state import HerdState
import numpy as np


def read_start(path: Path, instant: float) -> HerdState:
    """Return the herd of a CSV file, or of a bag's folder at an instant [s] from its first state.

    A CSV file has a line `sheep,x,y` or `dog,x,y` [m] for each, of sheep with velocities `vx,vy`
    [m/s] or without; empty lines and those that begin with # do not count. Of a bag it is the
    state that is nearest to the instant; sheep whose velocities were not recorded are at rest, and
    those that are out of sight, and dogs that are silent, are left out. Raises ValueError if it
    cannot be read, or holds no sheep or no dog.
    """
    try:
        return _of_bag(path, instant) if path.is_dir() else _of_table(path)
    except (OSError, ValueError) as error:
        raise ValueError(f'start_from must be a CSV file or a bag, got {path}: {error}') from error


def _of_table(path: Path) -> HerdState:
    rows: dict[str, list[list[float]]] = {'sheep': [], 'dog': []}
    with path.open(encoding='utf-8', newline='') as file:
        for number, row in enumerate(csv.reader(file), 1):
            if not row or row[0].startswith('#'):
                continue
            kind, words = row[0].strip(), row[1:]
            lengths = (2, 4) if kind == 'sheep' else (2,)
            try:
                values = [float(word) for word in words]
            except ValueError:
                values = []
            if kind not in rows or len(values) not in lengths:
                raise ValueError(
                    f'line {number} must be sheep,x,y or sheep,x,y,vx,vy or dog,x,y, '
                    f'got {",".join(row)}'
                )
            rows[kind].append(values)
    moving = np.array([[*values, 0.0, 0.0][:4] for values in rows['sheep']]).reshape(-1, 4)
    return HerdState(moving[:, :2], moving[:, 2:], np.array(rows['dog']).reshape(-1, 2))


def _of_bag(folder: Path, instant: float) -> HerdState:
    from herding_ros.bag.reader import read_run  # it takes a moment, and is seldom needed

    run = read_run(folder)
    k = int(np.abs(run.times - instant).argmin())
    seen, heard = run.seen[k], np.isfinite(run.d[k, :, 0])
    return HerdState(run.x[k, seen], np.nan_to_num(run.v[k, seen]), run.d[k, heard])
