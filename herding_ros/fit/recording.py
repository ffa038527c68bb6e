# SPDX-License-Identifier: Apache-2.0
"""What was seen of sheep and dogs, as a fit wants it: from a bag or from a table (CSV)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
import logging
import os
from pathlib import Path
from typing import Any

from herding_ros.bag.reader import read_run
from herding_ros.bag.recorded_run import RecordedRun
from herding_ros.bag.table import read_table
from herding_ros.model.state import Array, finite
import numpy as np

_log = logging.getLogger(__name__)

_LEAST = 3
"""A recording has at least so many instants."""


@dataclass(frozen=True)
class Recording:
    """Sheep and dogs at T instants.

    times: (T,) [s], increasing; x: (T, N, 2) observed positions of the sheep [m] and v: (T, N, 2)
    their velocities [m/s], NaN where there are none; d: (T, M, 2) positions of the dogs [m].
    position_noise [m], velocity_noise [m/s]: standard deviations of what is observed of the sheep,
    None where they are not known. Raises ValueError on wrong shapes and numbers.
    """

    times: Array
    x: Array
    v: Array
    d: Array
    name: str = 'recording'
    position_noise: float | None = None
    velocity_noise: float | None = None

    def __post_init__(self) -> None:
        """Check shapes, order of the times, and that there is something to see."""
        times, d = finite('times', self.times, (None,)), finite('dogs d', self.d, (None, None, 2))
        x, v = (np.array(each, dtype=np.float64) for each in (self.x, self.v))
        if len(times) < _LEAST:
            raise ValueError(f'{self.name}: times must be at least {_LEAST}, got {len(times)}')
        for before, after in pairwise(times):
            if not after > before:
                raise ValueError(
                    f'{self.name}: times must increase, got {after:g} after {before:g}'
                )
        if x.ndim != 3 or x.shape != v.shape or x.shape[::2] != (len(times), 2):
            raise ValueError(
                f'{self.name}: x and v must have shape ({len(times)}, sheep, 2), '
                f'got {x.shape} and {v.shape}'
            )
        for name, seen in (('x', x), ('v', v)):
            whole = np.isfinite(seen).all(axis=2) | np.isnan(seen).all(axis=2)
            if not whole.all():
                k, i = np.argwhere(~whole)[0]
                raise ValueError(
                    f'{self.name}: {name} must be finite, or NaN in both coordinates where it was '
                    f'not seen, got {seen[k, i]} at {times[k]:g} s'
                )
        if len(d) != len(times):
            raise ValueError(f'{self.name}: d must have {len(times)} instants, got {len(d)}')
        if not x.shape[1] or not np.isfinite(x).all(axis=2).any(axis=0).all():
            raise ValueError(f'{self.name}: there must be sheep, each seen at least once')
        for name, value in (('times', times), ('d', d), ('x', x), ('v', v)):
            object.__setattr__(self, name, value)

    @property
    def duration(self) -> float:
        """Time from the first to the last instant [s]."""
        return float(self.times[-1] - self.times[0])


def from_bag(path: str | os.PathLike[str], namespace: str | None = None) -> Recording:
    """Return what was observed in a bag; the truth, which a simulation records too, is not used.

    The noise of the sensors is that of our sim, if its parameters are in the bag. What was left
    out, and why, is logged (`logging`). Raises what `read_run` raises, and ValueError for a bag
    without dogs.
    """
    run = read_run(path, namespace, observed=True)
    for note in run.notes:
        _log.warning('%s: %s', path, note)
    if not run.dogs:
        raise ValueError(f'{path} has no dogs: none has messages on {run.namespace}/dog_<i>/odom')
    sensors = _sensors(run)
    v = np.where(np.isfinite(run.v).all(axis=2, keepdims=True), run.v, np.nan)
    return Recording(
        run.times, run.x, v, without_gaps(run.times, run.d), str(path),
        sensors.get('position_noise'), sensors.get('velocity_noise'),
    )  # fmt: skip


def _sensors(run: RecordedRun) -> Mapping[str, Any]:
    return run.parameters.get(f'{run.namespace}/sim', {})


def without_gaps(times: Array, d: Array) -> Array:
    """Return positions (T, M, 2) of dogs, straight lines where one was silent (NaN) in between.

    Before it is seen first, and after it is seen last, it stands.
    """
    out = np.array(d, dtype=np.float64)
    for m in range(out.shape[1]):
        for c in range(2):
            known = np.isfinite(out[:, m, c])
            if not known.any():
                raise ValueError(f'dog {m} must be seen at least once')
            out[:, m, c] = np.interp(times, times[known], out[known, m, c])
    return out


def from_table(path: str | os.PathLike[str]) -> Recording:
    """Return what a CSV file says, see `read_table`, which also says what it raises."""
    table = read_table(path)
    d = without_gaps(table.times, table.dogs[..., :2])
    return Recording(table.times, table.sheep[..., :2], table.sheep[..., 2:], d, str(path))


def read(path: str | os.PathLike[str], namespace: str | None = None) -> Recording:
    """Return a recording: a folder is a bag, a file a table. Raises what these raise."""
    return from_bag(path, namespace) if Path(path).is_dir() else from_table(path)
