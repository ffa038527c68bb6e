"""Figure "trajectories": how many dogs it takes, and how long."""

from __future__ import annotations

from itertools import product
import math
from pathlib import Path

import numpy as np

from .markdown import table
from .pictures import COLOURS, draw_run, new, save
from .runs import (
    FAILURES,
    failures,
    median_time,
    paths_of,
    run_task,
    SETTINGS,
    success,
    SUMMARY,
    summary,
    times,
    tolerant,
    under,
)
from .statistics import Fraction
from .study import Goal, Options, Results, Row, Section
from .task import Task

DESCRIPTION = 'Figure "trajectories": 1 to 6 dogs, time of arrival, success, spread, energy'

_GOALS = ([0.5, 0.5], [1.0, 1.0])
_SETTINGS = {'default': SETTINGS['default'], 'paper': tolerant(SETTINGS['paper'], 0.5)}
"""The paper's has eps_SM = 0.5 in this study."""
_WORDS = {'default': 'our default', 'paper': "the paper's setting"}
_PAPER_TIMES = {1: 3400.0, 2: 80.0, 3: 60.0, 4: 60.0, 5: 70.0, 6: 40.0}
_LIMIT, _LIMIT_OF_ONE = 400.0, 3400.0
_MEDIAN_GOALS = {2: 60.0, 3: 45.0, 4: 40.0, 5: 35.0, 6: 32.0}


_Runs = dict[tuple[str, int, tuple[float, ...]], Results]


def tasks(options: Options) -> list[Task]:
    """Return runs of each number of dogs to both goals, under both settings."""
    found = []
    for name, dogs, goal, seed in product(
        _SETTINGS, (1, 3) if options.quick else _PAPER_TIMES, _GOALS, options.seed_range(20)
    ):
        limit = 20.0 if options.quick else _LIMIT_OF_ONE if dogs == 1 else _LIMIT
        found.append(
            run_task(
                'planner',
                paths_of(_SETTINGS[name], options.path_number(100)),
                dogs,
                0.01,
                goal,
                seed,
                limit,
                cost=_cost(dogs, goal) * (0.05 if options.quick else 1.0),
                sheep=6 if options.quick else 20,
                every=2.0 if dogs == 1 else 1.0,
            )
        )
    return found


def _cost(dogs: int, goal: list[float]) -> float:
    """Return about how long a run takes to compute [s]."""
    return 15.0 if dogs == 1 else 3.0 / dogs * math.hypot(*goal)


def draw(results: Results, figures: Path) -> Section:
    """Make the tables, the distributions and the pictures."""
    runs = {
        (name, dogs, tuple(goal)): under(settings, results.of('herding', dogs=dogs, goal=goal))
        for name, settings in _SETTINGS.items()
        for dogs in _PAPER_TIMES
        for goal in _GOALS
    }
    values = {
        'seeds': str(len(results.parameter('seed'))),
        'times': _distributions(runs, figures),
    }
    for name in _WORDS:
        values[f'{name}_table'] = _table(runs, name)
        values[f'{name}_failures'] = _failures(runs, name)
        values[f'{name}_pictures'] = _pictures(runs, name, figures)
    return Section(values, _rows(runs), _goals(runs))


def _table(runs: _Runs, name: str) -> str:
    rows = []
    for goal, dogs in product(_GOALS, _PAPER_TIMES):
        found = runs[name, dogs, tuple(goal)]
        if len(found):
            paper = f'{_PAPER_TIMES[dogs]:g}' if goal == _GOALS[0] else ''
            rows.append(('({:g}, {:g})'.format(*goal), str(dogs), paper, *summary(found)))
    return table(('goal', 'dogs', "paper's time [s]", *SUMMARY), rows)


def _failures(runs: _Runs, name: str) -> str:
    rows = [row for key, found in runs.items() if key[0] == name for row in failures(found)]
    return f'Runs without safe arrival:\n\n{table(FAILURES, rows)}' if rows else ''


def _distributions(runs: _Runs, figures: Path) -> str:
    figure, axes = new(2, 2, width=4.5, height=2.8)
    for (row, name), (column, goal) in product(enumerate(_WORDS), enumerate(_GOALS)):
        for colour, dogs in zip(COLOURS, _PAPER_TIMES, strict=False):
            found = runs[name, dogs, tuple(goal)]
            arrived = sorted(time for time in times(found) if math.isfinite(time))
            if arrived:
                steps = np.arange(1, len(arrived) + 1) / len(found)
                limit = _LIMIT_OF_ONE if dogs == 1 else _LIMIT
                axes[row, column].step(
                    [arrived[0], *arrived, limit], [0.0, *steps, steps[-1]], where='post',
                    color=colour, label=f'{dogs} dog' + 's' * (dogs > 1),
                )  # fmt: skip
        axes[row, column].set(
            xscale='log', xlim=(20.0, _LIMIT_OF_ONE), ylim=(0.0, 1.03), xlabel='time [s]'
        )
        axes[row, column].set_title(
            '{}, goal ({:g}, {:g})'.format(_WORDS[name], *goal), fontsize=9
        )
    if axes[0, 0].lines:
        axes[0, 0].legend(fontsize=7, frameon=False)
    return save(figure, figures / 'dogs-times.png')


def _pictures(runs: _Runs, name: str, figures: Path) -> str:
    figure, axes = new(3, 2, width=3.4, height=3.2)
    goal = _GOALS[0]
    for place, dogs in zip(axes.flat, _PAPER_TIMES, strict=True):
        first = runs[name, dogs, tuple(goal)].by_seed().get(0)
        if first:
            end = f'{first["duration"]:.0f} s' + ('' if first['arrived'] else ', not there')
            draw_run(place, first, goal, f'{dogs} dog{"s" * (dogs > 1)}, {end}')
        else:
            place.set_axis_off()
    return save(figure, figures / f'dogs-trajectories-{name}.png')


def _rows(runs: _Runs) -> list[Row]:
    rows = []
    for dogs, paper in _PAPER_TIMES.items():
        ours, theirs = (runs[name, dogs, tuple(_GOALS[0])] for name in _WORDS)
        if len(ours):
            rows.append(
                Row(
                    f'Figure "trajectories", {dogs} dog{"s" * (dogs > 1)}: time of arrival',
                    f'{paper:g} s',
                    f'{median_time(ours)} s',
                    f"{success(ours)} safe; the paper's setting: {median_time(theirs)} s, "
                    f'{success(theirs)}',
                )
            )
    return rows


def _goals(runs: _Runs) -> list[Goal]:
    several = [
        run for dogs, goal in product(range(2, 7), _GOALS)
        for run in runs['default', dogs, tuple(goal)].entries
    ]  # fmt: skip
    all_runs = success(Results(several))
    goals = [
        Goal(
            '2 to 6 dogs, both goals: safe arrivals within 400 s',
            'all of 200',
            str(all_runs),
            all_runs.successes == all_runs.count if all_runs.count >= 200 else None,
        )
    ]
    for dogs, bound in _MEDIAN_GOALS.items():
        found = runs['default', dogs, tuple(_GOALS[0])]
        goals.append(
            Goal(
                f'{dogs} dogs to (0.5, 0.5): median time',
                f'≤ {bound:g} s',
                f'{median_time(found)} s',
                median_time(found).value <= bound if len(found) >= 20 else None,
            )
        )
    for goal in _GOALS:
        found = runs['default', 1, tuple(goal)]
        one: Fraction = success(found)
        arrived = Fraction.of(found.values('arrived'))
        goals.append(
            Goal(
                'One dog to ({:g}, {:g}): arrivals within 3,400 s'.format(*goal),
                '≥ 19 of 20',
                f'{arrived}; {one.successes} with a spread of at most 0.6 m',
                arrived.value >= 0.95 if arrived.count >= 20 else None,
            )
        )
    return goals
