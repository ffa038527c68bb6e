# SPDX-License-Identifier: Apache-2.0
"""What the studies of whole runs share: settings, criterion of success, tables, figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
from pathlib import Path
from typing import Any

from herding_ros.control.parameters import Control, PAPER
from herding_ros.model.flock import Arrival
from herding_ros.model.scenario import GOAL
from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Fraction, Mean, Median, significant
from herding_ros.report.style import draw_goal, draw_herd, draw_paths, new, save
from matplotlib.axes import Axes
import numpy as np

from .study import Options, Results, Row
from .task import Task


def settings_of(control: Control) -> dict[str, Any]:
    """Return the parameters by dotted names in which a controller is not the default one."""
    usual = Control().flat()
    return {name: value for name, value in control.flat().items() if value != usual[name]}


PLAIN: dict[str, Any] = {'mapping.estimator': 'plain', 'mapping.standard_error': 0.0}
"""Settings of a mapping that uses the mean of plain paths, as the paper's does."""

SETTINGS: dict[str, dict[str, Any]] = {'default': {}, 'paper': settings_of(PAPER)}
"""Settings of the controller by name, as differences from its defaults."""

NAMES = {'default': 'our default', 'paper': "the paper's setting"}
"""Their names on pages."""

MAX_SPREAD = 0.6
"""A flock whose spread exceeded this on the way was chased rather than herded [m]."""


LIMIT = 400.0
"""Usual length of a run that does not arrive [s]."""


def run_task(options: Options, cost: float, **parameters: Any) -> Task:
    """Return the task of a run; what is not given is as in most studies, or small if quick."""
    quick = options.quick
    usual: dict[str, Any] = {
        'policy': 'planner',
        'settings': {},
        'sheep': 6 if quick else 20,
        'sigma': 0.01,
        'goal': GOAL,
        'time_limit': 10.0 if quick else LIMIT,
    }
    if parameters.get('policy', 'planner') == 'planner':
        usual['paths'] = options.path_number(100)
    return Task('herding', {**usual, **parameters}, cost)


def point(goal: Iterable[float]) -> str:
    """Return a goal for people."""
    return '({:g}, {:g})'.format(*goal)


def number(count: int, what: str) -> str:
    """Return a number of things: `1 dog`, `2 dogs`."""
    return f'{count} {what}{"s" * (count > 1)}'


def safe(run: dict[str, Any]) -> bool:
    """Whether the flock arrived and was never scattered on the way."""
    return bool(run['arrived'] and run['max_spread'] <= MAX_SPREAD)


def success(runs: Results) -> Fraction:
    """Return the fraction of safe arrivals."""
    return Fraction.of([safe(run) for run in runs])


def of_twenty(what: str, arrivals: Fraction, enough: int) -> list[Goal]:
    """Return the goal that so many of 20 arrive, known once 20 have run; none without a run."""
    reached = arrivals.successes >= enough if arrivals.count == 20 else None
    return [Goal(what, f'≥ {enough} of 20', arrivals, reached)] if arrivals.count else []


def times(runs: Results) -> list[float]:
    """Return the times of arrival [s], infinite where the flock did not arrive safely."""
    return [float(run['time']) if safe(run) else math.inf for run in runs]


def times_of_arrivals(runs: Results) -> list[float]:
    """Return the times of safe arrivals alone [s], in order."""
    return sorted(time for time in times(runs) if math.isfinite(time))


def median_time(runs: Results) -> Median:
    """Return the median time of arrival over all runs, failed ones included."""
    return Median.of(times(runs))


def arrival_row(what: str, paper: str, runs: Results, others: Mapping[str, Results]) -> list[Row]:
    """Return the row about the time of arrival of runs, if any, with others in its remark."""
    if not len(runs):
        return []
    remarks = [f'{success(runs)} safe']
    remarks += [f'{name}: {median_time(each)} s, {success(each)}' for name, each in others.items()]
    return [Row(f'{what}: time of arrival', paper, f'{median_time(runs)} s', '; '.join(remarks))]


def summary(runs: Results) -> dict[str, object]:
    """Return the columns of a row about runs."""
    arrived = times_of_arrivals(runs)
    return {
        'safe arrivals': success(runs),
        'median time [s]': median_time(runs),
        'times of these, range [s]': (
            f'{significant(arrived[0])} to {significant(arrived[-1])}' if arrived else '–'
        ),
        'largest spread, mean [m]': runs.mean('max_spread'),
        'largest of all [m]': float(max(runs.values('max_spread'), default=math.nan)),
        'path of a dog [m]': Mean.of(
            [run['dogs_run'] / len(run['paths']['dogs'][0]) for run in runs]
        ),
        'energy ∫ Σ\\|u\\|² dt [m²/s]': runs.mean('energy'),
    }


def failures(groups: Iterable[tuple[Mapping[str, str], Results]], agents: str = 'dogs') -> str:
    """Return a table of all runs without safe arrival and their causes; nothing if all arrived.

    groups: runs with the columns that distinguish them; agents: head of the number of dogs.
    """
    rows = [{**label, **row} for label, runs in groups for row in _failures(runs, agents)]
    return f'Runs without safe arrival:\n\n{table(rows)}' if rows else ''


def _failures(runs: Results, agents: str) -> list[dict[str, str]]:
    rows = []
    for task, run in runs.entries:
        if safe(run):
            continue
        if run['arrived']:
            why = f'arrived after {run["time"]:g} s, but spread up to {run["max_spread"]:.2f} m'
        elif run['closest'] < Arrival.radius:
            why = 'the centre was there, but not with the flock together'
        else:
            why = 'the centre never got there'
        rows.append(
            {
                agents: str(task.parameters['dogs']),
                'goal': point(task.parameters['goal']),
                'seed': str(task.parameters['seed']),
                'what happened': why,
                'closest [m]': f'{run["closest"]:.3f}',
                'distance at the end [m]': f'{run["final_distance"]:.3f}',
                'largest spread [m]': f'{run["max_spread"]:.2f}',
            }
        )
    return sorted(rows, key=lambda row: tuple(row.values()))


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
