# SPDX-License-Identifier: Apache-2.0
"""Figures that several studies of whole runs have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes
import numpy as np

from herding_ros.report.style import draw_goal, draw_herd, draw_paths, new, save

from .runs import times
from .study import Results


def draw_runs(
    runs: Mapping[str, Results], goal: Sequence[float], path: Path, width: float, height: float
) -> None:
    """Draw the runs with seed 0 of six groups, named by the keys, side by side."""
    figure, axes = new(3, 2, width, height)
    for place, (name, found) in zip(axes.flat, runs.items(), strict=True):
        run = found.by_seed().get(0)
        if run is None:
            place.set_axis_off()
            continue
        dogs, centre = (np.array(run['paths'][each]) for each in ('dogs', 'centre'))
        draw_paths(place, dogs, centre)
        draw_herd(place, run['paths']['first'], dogs[0], 0.3)
        draw_herd(place, run['paths']['last'], dogs[-1])
        draw_goal(place, goal)
        end = '' if run['arrived'] else ', not there'
        place.set_title(f'{name}, {run["duration"]:.0f} s{end}', fontsize=9)
    save(figure, path)


def draw_times(
    axes: Axes, at: float, runs: Results, limit: float, half_width: float, colour: str, label: str
) -> None:
    """Draw the times of arrival above one place, and a bar at their median."""
    found = times(runs)
    if found:
        shown = np.minimum(found, limit)
        axes.plot(np.full(len(found), at), shown, '.', color=colour, alpha=0.6, label=label)
        middle = min(float(np.median(found)), limit)
        axes.plot([at - half_width, at + half_width], [middle, middle], color=colour)
