# SPDX-License-Identifier: Apache-2.0
"""The figure of a run, as in the paper: all paths, and what happened over time."""

from __future__ import annotations

import os

from herding_ros.bag.recorded_run import Array, RecordedRun
from herding_ros.model.flock import centre, spread
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
import numpy as np

from .style import (
    BLUE,
    draw_goal,
    draw_herd,
    draw_paths,
    draw_walls,
    GREY,
    legend,
    number_dogs,
    save,
)
from .summary import arrival, distances, field, initial_spread, over_time
from .walls import further

_MOST_NUMBERS = 60
"""More dogs than this go without their numbers: nobody could read them."""


def save_trajectories(run: RecordedRun, path: str | os.PathLike[str]) -> None:
    """Draw the run and save it as PNG, or as PDF if the path ends in .pdf."""
    figure = Figure(figsize=(11.0, 6.4), layout='constrained')
    grid = figure.add_gridspec(3, 2, width_ratios=[1.75, 1.0])
    _draw_map(figure.add_subplot(grid[:, 0]), run)
    solves = figure.add_subplot(grid[2, 1])
    _draw_solves(solves, run)
    when, widest = arrival(run)[0], arrival(run)[0].spread * initial_spread(run)
    for row, (label, values, limit) in enumerate(
        (
            ('distance to\ndestination [m]', distances(run), when.radius),
            ('spread of\nthe flock [m]', over_time(spread, run), widest),
        )
    ):
        axes = figure.add_subplot(grid[row, 1], sharex=solves)
        axes.set_ylabel(label, fontsize=9)
        _draw_with_limit(axes, run, values, limit)
        axes.tick_params(labelbottom=False)
    save(figure, path, dpi=160)


def _draw_map(axes: Axes, run: RecordedRun) -> None:
    place, last = field(run)[0], run.surroundings_at(float(run.times[-1]))
    draw_walls(axes, place, further(place, last.walls))
    draw_paths(axes, run.d, over_time(centre, run), 'centre of the flock')
    for k, alpha, when in ((0, 0.3, 'start'), (-1, 1.0, 'end')):
        x, d = run.x[k][run.seen[k]], run.d[k][np.isfinite(run.d[k, :, 0])]
        sheep = f'{len(x)} sheep' if len(x) > 1 else 'sheep'
        dogs = f'{len(d)} dogs' if len(d) > 1 else 'dog'
        labels = (f'{sheep}, {when}', f'{dogs}, {when}' if len(d) else None)
        draw_herd(axes, x, d, alpha, 4.5, labels)
    if len(run.dogs) <= _MOST_NUMBERS:
        number_dogs(axes, run.d[-1], run.dogs)
    draw_goal(axes, run.goal, 11.0, 'destination')
    axes.margins(0.06)
    axes.legend(fontsize=8, frameon=True, framealpha=0.9, edgecolor='none', loc='best')


def _draw_with_limit(axes: Axes, run: RecordedRun, values: Array, limit: float) -> None:
    axes.plot(run.times, values, color=BLUE)
    axes.axhline(limit, color=GREY, linestyle='--', linewidth=1.0)
    axes.annotate(
        f'{limit:.2g} m', (0.0, limit), xycoords=('axes fraction', 'data'), xytext=(3, 2),
        textcoords='offset points', va='bottom', fontsize=8, color=GREY,
    )  # fmt: skip
    axes.set_ylim(0.0, 1.2 * float(np.nanmax([*values, limit])) or 1.0)
    axes.yaxis.set_major_locator(MaxNLocator(4))


def _draw_solves(axes: Axes, run: RecordedRun) -> None:
    for kind, size in (('window', 4), ('feedback', 2)):
        replans = [replan for replan in run.replans if replan.kind == kind]
        times = [replan.time for replan in replans]
        solve_ms = [replan.solve_ms for replan in replans]
        axes.vlines(times, 0.0, solve_ms, color='0.75')
        label = f'{kind}s' if replans else None
        axes.plot(times, solve_ms, 'o', color='black', markersize=size, label=label)
    legend(axes)
    axes.set_xlabel('time [s]', fontsize=9)
    axes.set_ylabel('solving\na replan [ms]', fontsize=9)
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_locator(MaxNLocator(4))
