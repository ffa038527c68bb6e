# SPDX-License-Identifier: Apache-2.0
"""The figure of a run, as in the paper: all paths, and what happened over time."""

from __future__ import annotations

import os

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from herding_ros.bag.recorded_run import Array, RecordedRun
from herding_ros.model.flock import ARRIVAL_DISTANCE, centre, distance, spread, TOGETHER

from .style import BLUE, draw_goal, draw_herd, draw_paths, GREY, save


def save_trajectories(run: RecordedRun, path: str | os.PathLike[str]) -> None:
    """Draw the run and save it as PNG."""
    figure = Figure(figsize=(11.0, 6.4), layout='constrained')
    grid = figure.add_gridspec(3, 2, width_ratios=[1.75, 1.0])
    _draw_map(figure.add_subplot(grid[:, 0]), run)
    solves = figure.add_subplot(grid[2, 1])
    _draw_solves(solves, run)
    spreads = spread(run.x)
    for row, (label, values, limit) in enumerate(
        (
            ('distance to\ndestination [m]', distance(run.x, run.goal), ARRIVAL_DISTANCE),
            ('spread of\nthe flock [m]', spreads, TOGETHER * float(spreads[0])),
        )
    ):
        axes = figure.add_subplot(grid[row, 1], sharex=solves)
        axes.set_ylabel(label, fontsize=9)
        _draw_with_limit(axes, run, values, limit)
        axes.tick_params(labelbottom=False)
    save(figure, path, dpi=160)


def _draw_map(axes: Axes, run: RecordedRun) -> None:
    sheep, dogs = run.x.shape[1], run.d.shape[1]
    herd = (f'{sheep} sheep' if sheep > 1 else 'sheep', f'{dogs} dogs' if dogs > 1 else 'dog')
    draw_paths(axes, run.d, centre(run.x), 'centre of the flock')
    for k, alpha, when in ((0, 0.3, 'start'), (-1, 1.0, 'end')):
        labels = (f'{herd[0]}, {when}', f'{herd[1]}, {when}')
        draw_herd(axes, run.x[k], run.d[k], alpha, 4.5, labels)
    draw_goal(axes, run.goal, 11.0, 'destination')
    axes.margins(0.06)
    axes.set(xlabel='x [m]', ylabel='y [m]')
    axes.legend(fontsize=8, frameon=True, framealpha=0.9, edgecolor='none', loc='best')


def _draw_with_limit(axes: Axes, run: RecordedRun, values: Array, limit: float) -> None:
    axes.plot(run.times, values, color=BLUE)
    axes.axhline(limit, color=GREY, linestyle='--', linewidth=1.0)
    axes.annotate(
        f'{limit:.2g} m', (0.0, limit), xycoords=('axes fraction', 'data'), xytext=(3, 2),
        textcoords='offset points', va='bottom', fontsize=8, color=GREY,
    )  # fmt: skip
    axes.set_ylim(0.0, 1.2 * max(float(values.max()), limit) or 1.0)
    axes.yaxis.set_major_locator(MaxNLocator(4))


def _draw_solves(axes: Axes, run: RecordedRun) -> None:
    times = [replan.time for replan in run.replans]
    solve_ms = [replan.solve_ms for replan in run.replans]
    axes.vlines(times, 0.0, solve_ms, color='0.75')
    axes.plot(times, solve_ms, 'o', color='black', markersize=4)
    axes.set_xlabel('time [s]', fontsize=9)
    axes.set_ylabel('solving\na replan [ms]', fontsize=9)
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_locator(MaxNLocator(4))
