# SPDX-License-Identifier: Apache-2.0
"""How the controller decides, shown on runs, and what it makes of hard starts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from herding_ros.control.parameters import Control
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import spreading
from herding_ros.model.scenario import GOAL
from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Fraction, Mean, Median
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

from .runs import MAX_SPREAD, of_twenty, run_task, safe, success, times
from .study import grid, Options, Results, Section, tasks_of
from .task import Task

TITLE = 'How the controller decides'
DESCRIPTION = 'looks, candidates, strays: what the controller does, also from hard starts'

_FAR = (1.0, 1.0)
_LIMIT = 250.0
_GUST, _GUST_AT = (-0.03, 0.06), 23.5
_STARTS = ('strays', 'dogs inside', 'dogs in front', 'two clusters')
_SETTINGS: dict[str, dict[str, Any]] = {
    'default': {},
    'no feedback': {'horizon.feedback': Control().horizon.accepted},
}
_STRONG = {2: (0.02, 400.0), 3: (0.02, _LIMIT), 5: (0.03, _LIMIT)}
"""Noise [m/s^1.5] and time limits [s] by the number of dogs."""
_POLICIES = {'planner': 'ours', 'strombom': 'heuristic'}
_OVER = 5
"""Changes of the spread are taken over so many seconds."""
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
        *_strong_tasks(options),
    ]


def _strong_tasks(options: Options) -> list[Task]:
    """Return runs under strong noise, by the controller and the heuristic."""
    quick, cases = options.quick, list(_STRONG.items())[: 1 if options.quick else None]
    return [
        run_task(
            options, 0.3 if quick else 20.0, policy=policy, dogs=dogs, sigma=sigma, goal=_FAR,
            time_limit=3.0 if quick else limit, seed=seed,
        )
        for seed in options.seed_range(20)
        for dogs, (sigma, limit) in cases
        for policy in _POLICIES
    ]  # fmt: skip


def draw(results: Results, figures: Path) -> Section:
    """Draw the looks of a run and a stray that is fetched, and make the table of hard starts."""
    looks = results.of('looks').by_seed().get(0)
    _draw_looks(looks, figures)
    _draw_candidates(results.of('candidates').by_seed().get(0), figures)
    _draw_strays(results.of('herding', start='strays', settings={}), figures)
    _draw_strong(results, figures)
    values = {
        'looks': _looks_table(looks),
        'starts': _starts_table(results),
        'strong': _strong_table(results),
        'seeds': results.of('herding').seeds,
    }
    return Section(values, goals=_goals(results))


def _goals(results: Results) -> list[Goal]:
    cases = [(start, 19, results.of('herding', start=start, settings={})) for start in _STARTS]
    cases += [
        (f'{dogs} dogs, σ = {sigma:g}, safe', enough, _strong(results, dogs, 'planner'))
        for (dogs, (sigma, _)), enough in zip(_STRONG.items(), (10, 19, 15), strict=True)
    ]
    goals = []
    for what, enough, found in cases:
        judge = Fraction.of(found.values('arrived')) if what in _STARTS else success(found)
        goals += of_twenty(what, judge, enough)
    return goals


def _strong(results: Results, dogs: int, policy: str) -> Results:
    sigma, _ = _STRONG[dogs]
    return results.of('herding', policy=policy, dogs=dogs, sigma=sigma)


def _strong_table(results: Results) -> str:
    return table(
        {
            'dogs': dogs,
            'σ': sigma,
            'by': words,
            'arrivals': Fraction.of(found.values('arrived')),
            'safe arrivals': success(found),
            'times of these, quartiles [s]': _quartiles(times(found)),
            'largest spread, mean [m]': found.mean('max_spread'),
        }
        for dogs, (sigma, _) in _STRONG.items()
        for policy, words in _POLICIES.items()
        if len(found := _strong(results, dogs, policy))
    )


def _quartiles(values: list[float]) -> str:
    """Return the quartiles of all runs, of which those that failed took for ever."""
    found = np.quantile(values, (0.25, 0.5, 0.75), method='inverted_cdf')
    return ', '.join('never' if math.isinf(each) else f'{each:.0f}' for each in found)


def _draw_strong(results: Results, figures: Path) -> None:
    """Draw the spread of each run, and what noise adds to its square and sheep and dogs take."""
    figure, axes = new(len(_STRONG), 2, width=3.2, height=2.4)
    for (above, below), (dogs, (sigma, _)) in zip(axes.T, _STRONG.items(), strict=True):
        runs = _strong(results, dogs, 'planner')
        for run in runs:
            colour = BLUE if safe(run) else RED
            above.plot(run['paths']['t'], run['paths']['spread'], color=colour, linewidth=0.6)
        above.axhline(MAX_SPREAD, color='black', linestyle=':', linewidth=1.0)
        above.set(xlabel='time [s]', title=f'{dogs} dogs, σ = {sigma:g}', ylim=(0.2, 0.9))
        crowd = Crowd(noise=sigma)
        added = spreading(crowd, np.zeros((1, 2)))
        places, taken, error = _taken(runs, added)
        below.errorbar(places, 1e3 * taken, 1e3 * error, color=BLUE, marker='o', markersize=3)
        below.axhline(1e3 * added, color='black', linestyle='--', linewidth=1.0)
        below.set(xlabel='spread [m]', xlim=(0.25, 0.65), ylim=(0.0, None))
    axes[0, 0].set_ylabel('spread [m]')
    axes[1, 0].set_ylabel('taken from its square\n[10⁻³ m²/s]')
    save(figure, figures / 'controller-strong.png')


def _taken(runs: Results, added: float) -> tuple[Any, Any, Any]:
    """Return spreads [m], and how fast its square shrinks there but for noise, with errors."""
    spreads: list[float] = []
    rates: list[float] = []
    for run in runs:
        square = np.square(run['paths']['spread'])[::_OVER]
        spreads.extend(np.sqrt(0.5 * (square[1:] + square[:-1])))
        rates.extend(added - np.diff(square) / _OVER)
    edges = np.arange(0.25, 0.66, 0.05)
    bins = np.digitize(spreads, edges)
    groups = {k: np.array(rates)[bins == k] for k in range(1, len(edges))}
    means = {k: Mean.of(list(group)) for k, group in groups.items() if len(group) > 4}
    return (
        np.array([edges[k - 1] + 0.025 for k in means]),
        np.array([mean.value for mean in means.values()]),
        np.array([mean.error for mean in means.values()]),
    )


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
