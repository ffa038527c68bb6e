# SPDX-License-Identifier: Apache-2.0
"""The paper's remark on other applications: guides that lead, instead of dogs that drive."""

from __future__ import annotations

from itertools import product
from pathlib import Path

from herding_ros.model.scenario import GOAL
from herding_ros.report.markdown import table
from herding_ros.report.style import COLOURS, GREY, legend, new, RED, save

from .runs import arrival_row, draw_runs, draw_times, failures, LIMIT, number, run_task, summary
from .study import Options, Results, Row, Section
from .task import Task

TITLE = 'Evacuation: guides in place of dogs'
DESCRIPTION = 'a crowd led by 1 to 5 guides, compared with dogs and with no leader'

_AGENTS = (1, 2, 3, 4, 5)
_LEADERS = {'dogs': 'cohesive', 'guides': 'guided'}
"""The crowd's preset of each kind of leaders."""
_COLOURS = dict(zip(_LEADERS, (RED, COLOURS[2]), strict=True))


def tasks(options: Options) -> list[Task]:
    """Return runs of the same crowds with each number of dogs and guides, and alone."""
    quick, found = options.quick, []
    for seed in options.seed_range(10):
        for crowd, agents in product(_LEADERS.values(), _AGENTS[:2] if quick else _AGENTS):
            cost = 0.2 if quick else 4.0 / agents
            found.append(run_task(options, cost, crowd=crowd, dogs=agents, seed=seed))
        found.append(run_task(options, 0.5, policy='none', dogs=1, seed=seed, every=10.0))
    return found


_Runs = dict[tuple[str, int], Results]
"""Runs by the kind of leaders and their number."""

_SHOWN = tuple(product(('dogs', 'guides'), (1, 2, 5)))
"""Those that are drawn."""


def draw(results: Results, figures: Path) -> Section:
    """Make the table, the distribution of times, and the pictures."""
    runs = {
        (name, agents): results.of('herding', policy='planner', dogs=agents, crowd=crowd)
        for (name, crowd), agents in product(_LEADERS.items(), _AGENTS)
    }
    alone = results.of('herding', policy='none')
    _draw_times(runs, alone, figures)
    shown = {f'{name}: {agents}': runs[name, agents] for name, agents in _SHOWN}
    draw_runs(shown, GOAL, figures / 'evacuation-trajectories.png', width=3.2, height=3.0)
    groups = (({'led by': name}, found) for (name, _), found in runs.items())
    values = {
        'seeds': results.seeds,
        'table': _table(runs, alone),
        'failures': failures(groups, agents='number'),
    }
    return Section(values, _rows(runs))


def _table(runs: _Runs, alone: Results) -> str:
    rows: list[dict[str, object]] = [
        {'number': agents, 'led by': name, **summary(found)}
        for (name, agents), found in runs.items()
        if len(found)
    ]
    if len(alone):
        columns = summary(alone)
        unknown = dict.fromkeys(list(columns)[-2:], '–')  # path and energy of a dog
        rows.append({'number': 0, 'led by': 'nobody', **columns, **unknown})
    return table(rows)


def _draw_times(runs: _Runs, alone: Results, figures: Path) -> None:
    figure, ((axes,),) = new(1, 1, width=6.5, height=3.4)
    for offset, (name, colour) in zip((-0.1, 0.1), _COLOURS.items(), strict=True):
        label = name
        for agents in _AGENTS:
            draw_times(axes, agents + offset, runs[name, agents], LIMIT, 0.09, colour, label)
            label = '' if len(runs[name, agents]) else label
    draw_times(axes, 0.0, alone, LIMIT, 0.09, GREY, 'nobody')
    axes.set(yscale='log', ylim=(10.0, 1.1 * LIMIT), ylabel='time of arrival [s]')
    axes.set(xlabel='number of dogs or guides')
    legend(axes)
    save(figure, figures / 'evacuation-times.png')


def _rows(runs: _Runs) -> list[Row]:
    rows = []
    for agents in _AGENTS:
        dogs, guides = (runs[name, agents] for name in _LEADERS)
        what = number(agents, 'guide')
        rows += arrival_row(what, 'a remark', guides, {'as many dogs': dogs})
    return rows
