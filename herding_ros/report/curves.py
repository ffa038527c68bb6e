# SPDX-License-Identifier: Apache-2.0
"""What is told of a run as values over time."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.bag.recorded_run import Array, RecordedRun
from herding_ros.model.flock import share_within, spread
import numpy as np

from .summary import arrival, destinations, distances, initial_spread, over_time


@dataclass(frozen=True)
class RunCurve:
    """Values (K,) at times (K,) [s]; a value that is not known is NaN.

    label: with the unit; of_states: whether there is one for each state, else for each replan;
    limit: below which a flock has arrived, if one counts.
    """

    label: str
    times: Array
    values: Array
    of_states: bool
    limit: float | None = None


def curves(run: RecordedRun) -> tuple[RunCurve, ...]:
    """Return distance, spread, share of sheep at the destination, solve times, and margins.

    Those of which nothing is known are left out.
    """
    when, at_first = arrival(run)[0], initial_spread(run)
    widest = when.spread * at_first
    replanned = np.array([replan.time for replan in run.replans])
    solve_ms, margins = (
        np.array([getattr(replan, name) for replan in run.replans], float)
        for name in ('solve_ms', 'deadline_margin_s')
    )
    margins[margins == 0.0] = np.nan  # in lockstep there is no deadline
    shares = _shares(run, when.radius + widest)
    found = (
        RunCurve('distance [m]', run.times, distances(run), True, when.radius),
        RunCurve('spread [m]', run.times, over_time(spread, run), True, widest),
        RunCurve('share of sheep at the destination', run.times, shares, True),
        RunCurve('solve time [ms]', replanned, solve_ms, False),
        RunCurve('deadline margin [s]', replanned, margins, False),
    )
    return tuple(curve for curve in found if np.isfinite(curve.values).any())


def _shares(run: RecordedRun, radius: float) -> Array:
    """Return which share (T,) of the sheep that were seen is at the destination in force."""
    states = zip(run.x, run.seen, destinations(run), strict=True)
    shares = np.array([share_within(x[here], goal, radius) for x, here, goal in states])
    return np.where(np.isfinite(distances(run)), shares, np.nan)
