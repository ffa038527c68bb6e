# SPDX-License-Identifier: Apache-2.0
"""How the controller decides, shown on runs, and what it makes of hard starts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from herding_ros.control.parameters import Control
from herding_ros.model.scenario import GOAL
from herding_ros.report.markdown import table
from herding_ros.report.statistics import Fraction, Median
from herding_ros.report.style import (
    BLUE,
    draw_goal,
    draw_herd,
    draw_paths,
    legend,
    new,
    RED,
    save,
)
import numpy as np

from .runs import run_task
from .study import grid, Options, Results, Section, tasks_of
from .task import Task

TITLE = 'How the controller decides'
DESCRIPTION = 'looks, candidates, strays: what the controller does, and from hard starts'

_FAR = (1.0, 1.0)
_LIMIT = 250.0
_GUST, _GUST_AT = (-0.03, 0.06), 23.5
_STARTS = ('strays', 'dogs inside', 'dogs in front', 'two clusters')
_SETTINGS: dict[str, dict[str, Any]] = {
    'default': {},
    'no feedback': {'horizon.feedback': Control().horizon.accepted},
}
_SNAPSHOTS = (0.0, 20.0, 40.0, 60.0, 90.0)
_KINDS = {'window': 'black', 'feedback': BLUE, 'feedback on a surprise': RED}


def tasks(options: Options) -> list[Task]:
    """Return a run whose looks are kept, and runs from hard starts with and without feedback."""
    quick = options.quick
    looks = {
        'sheep': 6 if quick else 20, 'dogs': 3, 'sigma': 0.02, 'goal': _FAR, 'gust': _GUST,
        'gust_at': 1.5 if quick else _GUST_AT, 'time_limit': 3.0 if quick else 40.0,
    }  # fmt: skip
    candidates = {
        'sheep': 6 if quick else 20, 'dogs': 3, 'sigma': 0.01, 'goal': GOAL,
        'at': 0.5 if quick else 10.0, 'start': 'strays',
    }  # fmt: skip
    cases = grid(
        settings=[*_SETTINGS.values()][: 1 if quick else None],
        start=_STARTS[: 1 if quick else None],
        seed=options.seed_range(20),
    )
    limit = 3.0 if quick else _LIMIT
    runs = [
        run_task(
            options, 0.3 if quick else 20.0, dogs=3, time_limit=limit, snapshots=_SNAPSHOTS, **case
        )
        for case in cases
    ]
    return [
        *tasks_of('looks', 0.2 if quick else 5.0, [{'seed': 0}], **looks),
        *tasks_of('candidates', 0.2 if quick else 5.0, [{'seed': 0}], **candidates),
        *runs,
    ]


def draw(results: Results, figures: Path) -> Section:
    """Draw the looks of a run and a stray that is fetched, and make the table of hard starts."""
    looks = results.of('looks').by_seed().get(0)
    _draw_looks(looks, figures)
    _draw_candidates(results.of('candidates').by_seed().get(0), figures)
    _draw_strays(results.of('herding', start='strays', settings={}), figures)
    values = {
        'looks': _looks_table(looks),
        'starts': _starts_table(results),
        'seeds': results.of('herding').seeds,
    }
    return Section(values)


def _kind(look: dict[str, Any]) -> str:
    """Return the kind of a look; feedback that comes early answers a surprise."""
    early = look['age'] is not None and look['age'] < Control().horizon.feedback - 0.01
    return 'feedback on a surprise' if look['kind'] == 'feedback' and early else look['kind']


def _looks_table(run: dict[str, Any] | None) -> str:
    looks = run['looks'] if run else []
    groups = {kind: [look for look in looks if _kind(look) == kind] for kind in _KINDS}
    return table(
        {
            'look': kind,
            'how many': len(group),
            'time that it takes, median [ms]': Median.of([look['ms'] for look in group]),
        }
        for kind, group in groups.items()
        if group
    )


def _draw_looks(run: dict[str, Any] | None, figures: Path) -> None:
    """Draw how far the flock is from where it is expected, and how long looks take."""
    figure, axes = new(1, 2, width=8.0, height=2.4)
    (above,), (below,) = axes
    if run:
        for kinds, colour, words in (
            (('window',), 'black', 'the last window'), (tuple(_KINDS), BLUE, 'the last look'),
        ):  # fmt: skip
            looks = [look for look in run['looks'] if _kind(look) in kinds]
            above.plot(*_surprise(run, looks), color=colour, label=f'off what {words} expects')
        for kind, colour in _KINDS.items():
            looks = [look for look in run['looks'] if _kind(look) == kind]
            t = [look['t'] for look in looks]
            below.plot(
                t, [look['ms'] for look in looks], 'o', color=colour, markersize=4, label=kind
            )
            if kind != 'feedback':
                above.plot(t, [0.0] * len(t), '^', color=colour, markersize=6, clip_on=False)
        for place in (above, below):
            place.set_xlim(0.0, run['paths']['t'][-1])
            legend(place)
    above.set(ylabel="the flock's centre [m]", ylim=(0.0, None))
    below.set(xlabel='time [s]', ylabel='a look takes [ms]', yscale='log')
    save(figure, figures / 'controller-looks.png')


def _surprise(run: dict[str, Any], looks: list[dict[str, Any]]) -> tuple[Any, Any]:
    """Return times (T,) [s] and how far the centre is off what the last look expects (T,) [m]."""
    t, centre = (np.array(run['paths'][each]) for each in ('t', 'centre'))
    starts = [look['t'] for look in looks]
    off = []
    for now, here in zip(t, centre, strict=True):
        # At the instant of a look the one before is still in force.
        look = looks[max(int(np.searchsorted(starts, now - 1e-6)) - 1, 0)]
        expected, ages = np.array(look['centre']), np.arange(len(look['centre']))
        there = [np.interp(now - look['t'], ages, expected[:, k]) for k in range(2)]
        off.append(float(np.hypot(*(here - there))))
    return t, np.array(off)


def _draw_candidates(run: dict[str, Any] | None, figures: Path) -> None:
    """Draw where each plan takes dogs and sheep; thick: the cheapest, and what comes of it."""
    figure, axes = new(3, 2, width=3.0, height=2.8)
    plans = run['plans'] if run else []
    for place in axes.flat[len(plans) :]:
        place.set_axis_off()
    cheapest = min((plan['cost'] for plan in plans[:-1]), default=None)
    for place, plan in zip(axes.flat, plans, strict=False):
        x, d = np.array(plan['x']), np.array(plan['d'])
        thick = plan is plans[-1] or plan['cost'] == cheapest
        for paths, colour in ((x, BLUE), (d, RED)):
            width = (2.0 if thick else 0.8) * (0.6 if paths is x else 1.0)
            place.plot(*np.moveaxis(paths, -1, 0), color=colour, linewidth=width, alpha=0.7)
        draw_herd(place, x[-1], d[-1])
        draw_goal(place, GOAL)
        words = f'{plan["name"]}: {plan["cost"]:.3g}'
        place.set_title(words, fontsize=9, fontweight='bold' if thick else None)
    save(figure, figures / 'controller-candidates.png')


def _draw_strays(runs: Results, figures: Path) -> None:
    """Draw the first run at some instants and the end, with the paths since the last picture."""
    figure, axes = new(3, 2, width=3.0, height=3.0)
    run, shots = runs.by_seed().get(0), []
    if run:
        paths = run['paths']
        end = {'t': paths['t'][-1], 'x': paths['last'], 'd': paths['dogs'][-1]}
        shots = [*run['snapshots'], end]
    for place in axes.flat[len(shots) :]:
        place.set_axis_off()
    before = 0.0
    for place, shot in zip(axes.flat, shots, strict=False):
        t = np.array(paths['t'])
        since = (before <= t) & (t <= shot['t'])
        dogs, centre = (np.array(paths[each])[since] for each in ('dogs', 'centre'))
        draw_paths(place, dogs, centre)
        draw_herd(place, shot['x'], shot['d'])
        draw_goal(place, GOAL)
        place.set_title(f't = {shot["t"]:g} s', fontsize=9)
        before = shot['t']
    save(figure, figures / 'controller-strays.png')


def _starts_table(results: Results) -> str:
    return table(
        {
            'start': start,
            'controller': name,
            'arrivals': Fraction.of(found.values('arrived')),
            'median time [s]': Median.of(
                [run['time'] if run['arrived'] else math.inf for run in found]
            ),
            'largest spread, mean [m]': found.mean('max_spread'),
        }
        for start in _STARTS
        for name, settings in _SETTINGS.items()
        if len(found := results.of('herding', start=start, settings=settings))
    )
