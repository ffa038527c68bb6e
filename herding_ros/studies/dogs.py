# SPDX-License-Identifier: Apache-2.0
"""Figure "trajectories": the number of dogs, and how long they take."""

from __future__ import annotations

from itertools import product
import math
from pathlib import Path

from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Fraction
from herding_ros.report.style import COLOURS, legend, new, save
import numpy as np

from .runs import (
    arrival_row,
    draw_runs,
    failures,
    LIMIT,
    median_time,
    NAMES,
    number,
    point,
    run_task,
    SETTINGS,
    success,
    summary,
    times_of_arrivals,
)
from .study import grid, Options, Results, Row, Section
from .task import Task

TITLE = 'Influence of the number of dogs (Figure "trajectories")'
DESCRIPTION = 'Figure "trajectories": 1 to 6 dogs, time of arrival, success, spread, energy'

_GOALS = ([0.5, 0.5], [1.0, 1.0])
_NEAR = (0.5, 0.5)
_SETTINGS = {**SETTINGS, 'paper': {**SETTINGS['paper'], 'mapping.residual': 0.5}}
"""In this study eps_SM = 0.5 in the paper's setting."""
_PAPER_TIMES = {1: 3400.0, 2: 80.0, 3: 60.0, 4: 60.0, 5: 70.0, 6: 40.0}
_LIMIT_OF_ONE = 3400.0
_MEDIAN_GOALS = {2: 60.0, 3: 45.0, 4: 40.0, 5: 35.0, 6: 32.0}

_Runs = dict[tuple[str, int, tuple[float, ...]], Results]
"""Runs by setting, number of dogs and goal."""


def tasks(options: Options) -> list[Task]:
    """Return runs of each number of dogs to both goals, under both settings."""
    quick, found = options.quick, []
    herds = (1, 3) if quick else list(_PAPER_TIMES)
    settings = list(_SETTINGS.values())
    for case in grid(settings=settings, dogs=herds, goal=_GOALS, seed=options.seed_range(20)):
        one = case['dogs'] == 1
        cost = 15.0 if one else 3.0 / case['dogs'] * math.hypot(*case['goal'])
        limit = 20.0 if quick else _LIMIT_OF_ONE if one else LIMIT
        every = 2.0 if one else 1.0
        cost *= 0.05 if quick else 1.0
        found.append(run_task(options, cost, **case, time_limit=limit, every=every))
    return found


def draw(results: Results, figures: Path) -> Section:
    """Make the tables, the distributions and the pictures."""
    runs = {
        (name, dogs, tuple(goal)): results.of(
            'herding', settings=_SETTINGS[name], dogs=dogs, goal=goal
        )
        for name, dogs, goal in product(_SETTINGS, _PAPER_TIMES, _GOALS)
    }
    _draw_times(runs, figures)
    values = {'seeds': results.seeds}
    for name in NAMES:
        of_name = [found for key, found in runs.items() if key[0] == name]
        values[f'{name}_table'] = _table(runs, name)
        values[f'{name}_failures'] = failures(({}, found) for found in of_name)
        nearer = {number(dogs, 'dog'): runs[name, dogs, _NEAR] for dogs in _PAPER_TIMES}
        path = figures / f'dogs-trajectories-{name}.png'
        draw_runs(nearer, _GOALS[0], path, width=3.4, height=3.2)
    return Section(values, _rows(runs), _goals(runs))


def _table(runs: _Runs, name: str) -> str:
    return table(
        {
            'goal': point(goal),
            'dogs': dogs,
            "paper's time [s]": f'{_PAPER_TIMES[dogs]:g}' if goal == _GOALS[0] else '',
            **summary(found),
        }
        for goal, dogs in product(_GOALS, _PAPER_TIMES)
        if len(found := runs[name, dogs, tuple(goal)])
    )


def _draw_times(runs: _Runs, figures: Path) -> None:
    figure, axes = new(2, 2, width=4.5, height=2.8)
    places = product(NAMES.items(), _GOALS)
    for place, ((name, words), goal) in zip(axes.flat, places, strict=True):
        for colour, dogs in zip(COLOURS, _PAPER_TIMES, strict=False):
            found = runs[name, dogs, tuple(goal)]
            if arrived := times_of_arrivals(found):
                steps = np.arange(1, len(arrived) + 1) / len(found)
                limit = _LIMIT_OF_ONE if dogs == 1 else LIMIT
                place.step(
                    [arrived[0], *arrived, limit], [0.0, *steps, steps[-1]], where='post',
                    color=colour, label=number(dogs, 'dog'),
                )  # fmt: skip
        place.set(xscale='log', xlim=(20.0, _LIMIT_OF_ONE), ylim=(0.0, 1.03), xlabel='time [s]')
        place.set(ylabel='share of the runs that arrived')
        place.set_title(f'{words}, goal {point(goal)}', fontsize=9)
    legend(axes[0, 0])
    save(figure, figures / 'dogs-times.png')


def _rows(runs: _Runs) -> list[Row]:
    rows = []
    for dogs, paper in _PAPER_TIMES.items():
        ours, theirs = (runs[name, dogs, _NEAR] for name in NAMES)
        what = f'Figure "trajectories", {number(dogs, "dog")}'
        rows += arrival_row(what, f'{paper:g} s', ours, {NAMES['paper']: theirs})
    return rows


def _goals(runs: _Runs) -> list[Goal]:
    several = [
        entry
        for dogs, goal in product(range(2, 7), _GOALS)
        for entry in runs['default', dogs, tuple(goal)].entries
    ]
    all_runs = success(Results(several))
    what = '2 to 6 dogs, both goals: safe arrivals within 400 s'
    reached = all_runs.successes == all_runs.count if all_runs.count >= 200 else None
    goals = [Goal(what, 'all of 200', all_runs, reached)]
    for dogs, bound in _MEDIAN_GOALS.items():
        found = runs['default', dogs, _NEAR]
        median = median_time(found)
        reached = median.value <= bound if len(found) >= 20 else None
        what = f'{dogs} dogs to (0.5, 0.5): median time'
        goals.append(Goal(what, f'≤ {bound:g} s', f'{median} s', reached))
    for goal in _GOALS:
        found = runs['default', 1, tuple(goal)]
        arrived = Fraction.of(found.values('arrived'))
        reached = arrived.value >= 0.95 if arrived.count >= 20 else None
        what = f'One dog to {point(goal)}: arrivals within 3,400 s'
        measured = f'{arrived}; {success(found).successes} with a spread of at most 0.6 m'
        goals.append(Goal(what, '≥ 19 of 20', measured, reached))
    return goals
