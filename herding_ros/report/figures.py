"""The picture of a run, as in the paper: where everyone went, and how it went over time."""

from __future__ import annotations

import os

from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from herding_ros.bag.recorded_run import Array, RecordedRun
from herding_ros.model.flock import ARRIVAL_DISTANCE, centre, distance, spread, TOGETHER

# Blue and red of this lightness stay apart with any kind of colour vision, and in grey.
BLUE, RED, GREY = '#2166ac', '#c2292b', '#5f6368'

_MOST_DOTS = 1000
"""More sheep than this would be a blob of dots: their density is drawn."""
_CELLS = 40
"""Cells of the density across the flock."""


def save_trajectories(run: RecordedRun, path: str | os.PathLike[str]) -> None:
    """Draw the run and save it; the suffix of the path tells the format."""
    figure = Figure(figsize=(11.0, 6.4), layout='constrained')
    grid = figure.add_gridspec(3, 2, width_ratios=[1.75, 1.0])
    _draw_map(figure.add_subplot(grid[:, 0]), run)
    solves = figure.add_subplot(grid[2, 1])
    _draw_solves(solves, run)
    for row, draw in enumerate((_draw_distance, _draw_spread)):
        axes = figure.add_subplot(grid[row, 1], sharex=solves)
        draw(axes, run)
        axes.tick_params(labelbottom=False)
    for axes in figure.axes:
        axes.spines[['top', 'right']].set_visible(False)
        axes.tick_params(labelsize=8)
    figure.savefig(path, dpi=160)


def _draw_map(axes: Axes, run: RecordedRun) -> None:
    sheep, dogs = run.x.shape[1], run.d.shape[1]
    for m in range(dogs):
        axes.plot(*run.d[:, m].T, color=RED, linewidth=1.0, alpha=0.6)
    axes.plot(*centre(run.x).T, color=BLUE, linewidth=1.8, label='centre of the flock')
    for k, alpha, when in ((0, 0.3, 'start'), (-1, 1.0, 'end')):
        draw_flock = _draw_dots if sheep <= _MOST_DOTS else _draw_density
        draw_flock(
            axes, run.x[k], alpha, f'{sheep} sheep, {when}' if sheep > 1 else f'sheep, {when}'
        )
        axes.plot(
            *run.d[k].T, '^', color=RED, markersize=8, markeredgewidth=0, alpha=alpha,
            label=f'{dogs} dogs, {when}' if dogs > 1 else f'dog, {when}',
        )  # fmt: skip
    axes.plot(
        *run.goal, 'x', color='black', markersize=11, markeredgewidth=2.2, label='destination'
    )
    axes.set_aspect('equal', adjustable='datalim')
    axes.margins(0.06)
    axes.set_xlabel('x [m]')
    axes.set_ylabel('y [m]')
    axes.grid(color='0.92')
    axes.set_axisbelow(True)
    axes.legend(fontsize=8, frameon=True, framealpha=0.9, edgecolor='none', loc='best')


def _draw_dots(axes: Axes, x: Array, alpha: float, label: str) -> None:
    axes.plot(
        *x.T, 'o', color=BLUE, markersize=4.5, markeredgewidth=0, alpha=alpha, label=label
    )  # fmt: skip


def _draw_density(axes: Axes, x: Array, alpha: float, label: str) -> None:
    """Draw how many sheep there are in each cell: the more, the darker."""
    shades = [to_rgba(BLUE, 0.15 * alpha), to_rgba(BLUE, alpha)]
    axes.hexbin(
        *x.T, gridsize=_CELLS, mincnt=1, linewidths=0, zorder=2,
        cmap=LinearSegmentedColormap.from_list('density', shades),
    )  # fmt: skip
    axes.plot([], [], 'h', color=BLUE, markersize=9, markeredgewidth=0, alpha=alpha, label=label)


def _draw_distance(axes: Axes, run: RecordedRun) -> None:
    axes.set_ylabel('distance to\ndestination [m]', fontsize=9)
    _draw_with_limit(axes, run, distance(run.x, run.goal), ARRIVAL_DISTANCE)


def _draw_spread(axes: Axes, run: RecordedRun) -> None:
    spreads = spread(run.x)
    axes.set_ylabel('spread of\nthe flock [m]', fontsize=9)
    _draw_with_limit(axes, run, spreads, TOGETHER * float(spreads[0]))


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
