"""The paper's remark on other applications: guides that lead, in place of dogs that drive."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from .markdown import table
from .pictures import BLUE, COLOURS, draw_run, GREY, new, RED, save
from .runs import (
    FAILURES,
    failures,
    median_time,
    paths_of,
    run_task,
    success,
    SUMMARY,
    summary,
    times,
    under,
)
from .study import Options, Results, Row, Section
from .task import Task

DESCRIPTION = 'a crowd led by 1 to 5 guides, against dogs and against nobody'

_AGENTS = (1, 2, 3, 4, 5)
_GOAL = [0.5, 0.5]
_LIMIT = 400.0
_FAST = {'reference': {'speed': 0.05}}
_WAYS: dict[str, tuple[str, dict[str, Any]]] = {
    'dogs': ('cohesive', {}),
    'guides': ('guided', {}),
    'guides, reference.speed 0.05': ('guided', _FAST),
}
"""Who leads: the crowd's preset, and what differs from the default controller."""
_MARKS = dict(zip(_WAYS, (RED, COLOURS[2], BLUE), strict=True))


def tasks(options: Options) -> list[Task]:
    """Return runs of the same crowds under each number of dogs and guides, and alone."""
    quick = options.quick
    sheep, limit = (6, 10.0) if quick else (20, _LIMIT)
    found = []
    for seed in options.seed_range(10):
        for (crowd, settings), agents in product(
            _WAYS.values(), _AGENTS[:2] if quick else _AGENTS
        ):
            given = paths_of(settings, options.path_number(100))
            found.append(
                run_task(
                    'planner', given, agents, 0.01, _GOAL, seed, limit,
                    cost=0.2 if quick else 4.0 / agents, sheep=sheep, crowd=crowd,
                )
            )  # fmt: skip
        alone = run_task(
            'none', {}, 1, 0.01, _GOAL, seed, limit, cost=0.5, sheep=sheep, every=10.0
        )
        found.append(alone)
    return found


_Runs = dict[tuple[str, int], Results]
"""Runs by who leads and how many they are."""


def draw(results: Results, figures: Path) -> Section:
    """Make the table, the distribution of times, and the pictures."""
    led = results.of('herding', policy='planner')
    runs = {
        (way, agents): under(settings, led.of('herding', crowd=crowd, dogs=agents))
        for (way, (crowd, settings)), agents in product(_WAYS.items(), _AGENTS)
    }
    alone = results.of('herding', policy='none')
    values = {
        'seeds': str(len(results.parameter('seed'))),
        'table': _table(runs, alone),
        'failures': _failures(runs),
        'times': _distributions(runs, alone, figures),
        'pictures': _pictures(runs, figures),
    }
    return Section(values, _rows(runs))


def _table(runs: _Runs, alone: Results) -> str:
    rows = [
        (str(agents), way, *summary(found)) for (way, agents), found in runs.items() if len(found)
    ]
    if len(alone):
        rows.append(('0', 'nobody', *summary(alone)[:-2], '–', '–'))
    return table(('number', 'led by', *SUMMARY), rows)


def _failures(runs: _Runs) -> str:
    rows = [(way, *row) for (way, _), found in runs.items() for row in failures(found)]
    if not rows:
        return ''
    return 'Runs without safe arrival:\n\n' + table(('led by', 'number', *FAILURES[1:]), rows)


def _distributions(runs: _Runs, alone: Results, figures: Path) -> str:
    figure, ((axes,),) = new(1, 1, width=6.5, height=3.4)
    for offset, (way, colour) in zip((-0.2, 0.0, 0.2), _MARKS.items(), strict=True):
        label: str | None = way
        for agents in _AGENTS:
            found = np.minimum(times(runs[way, agents]), _LIMIT)
            if len(found):
                at = np.full(len(found), agents + offset)
                axes.plot(at, found, '.', color=colour, alpha=0.6, label=label)
                middle = float(np.median(found))
                axes.plot(at[0] + [-0.09, 0.09], [middle, middle], color=colour)
                label = None
    if len(alone):
        found = np.minimum(times(alone), _LIMIT)
        axes.plot(np.zeros(len(found)), found, '.', color=GREY, alpha=0.6, label='nobody')
    axes.set(yscale='log', ylim=(10.0, 1.1 * _LIMIT), ylabel='time of arrival [s]')
    axes.set(xlabel='number of dogs or guides')
    if axes.lines:
        axes.legend(fontsize=7, frameon=False)
    return save(figure, figures / 'evacuation-times.png')


def _pictures(runs: _Runs, figures: Path) -> str:
    shown = list(product(('dogs', 'guides'), (1, 2, 5)))
    figure, axes = new(3, 2, width=3.2, height=3.0)
    for place, (way, agents) in zip(axes.flat, shown, strict=True):
        first = runs[way, agents].by_seed().get(0)
        if first:
            end = f'{first["duration"]:.0f} s' + ('' if first['arrived'] else ', not there')
            draw_run(place, first, _GOAL, f'{way}: {agents}, {end}')
        else:
            place.set_axis_off()
    return save(figure, figures / 'evacuation-trajectories.png')


def _rows(runs: _Runs) -> list[Row]:
    rows = []
    for agents in _AGENTS:
        dogs, guides, fast = (runs[way, agents] for way in _WAYS)
        if len(guides):
            rows.append(
                Row(
                    f'{agents} guide{"s" * (agents > 1)}: time of arrival',
                    'a remark',
                    f'{median_time(guides)} s',
                    f'{success(guides)} safe; faster reference: {median_time(fast)} s, '
                    f'{success(fast)}; as many dogs: {median_time(dogs)} s, {success(dogs)}',
                )
            )
    return rows
