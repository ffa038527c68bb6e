# SPDX-License-Identifier: Apache-2.0
"""Noisy observations: their cost, and what the controller's filter makes of them."""

from __future__ import annotations

from itertools import product
import math
from pathlib import Path
from typing import Any

from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Mean
from herding_ros.report.style import BLUE, legend, new, RED, save
import numpy as np

from .runs import (
    arrival_row,
    draw_times,
    failures,
    LIMIT,
    median_time,
    run_task,
    safe,
    success,
    summary,
)
from .study import grid, NOT_IN_PAPER, Options, Results, Row, Section
from .task import Task

TITLE = 'Noisy observations'
DESCRIPTION = 'observation noise up to 0.05 m and 0.05 m/s, filtered or not, positions alone'

_NOISES = (0.0, 0.01, 0.02, 0.05)
"""Standard deviation of observed positions [m] and velocities [m/s]."""
_DOGS = (2, 5)
_MISJUDGED = (0.02, 0.1)
"""Noises that the filter expects while the largest noise is there."""
_COLOURS = {'as observed': RED, 'filtered': BLUE}

_FEW = 3
"""Dogs that herd sheep of which positions alone are seen."""
_SEEN = {'positions and velocities': True, 'positions': False}
_ENOUGH, _MORE_TIME = 0.95, 0.15
"""Without velocities this share of flocks should arrive, in this much more time."""


def _settings(expected: float) -> dict[str, Any]:
    """Settings of a controller that expects so much noise [m and m/s]; 0: no filter."""
    if not expected:
        return {}
    return {'sensor.position_noise': expected, 'sensor.velocity_noise': expected}


def _expected(plan: str, noise: float) -> float:
    return noise if plan == 'filtered' else 0.0


def tasks(options: Options) -> list[Task]:
    """Return runs of the same flocks under every noise, with and without the filter."""
    quick = options.quick
    noises, herds = ((0.0, 0.05), _DOGS[:1]) if quick else (_NOISES, _DOGS)
    pairs = {(noise, _expected(plan, noise)) for noise in noises for plan in _COLOURS}
    pairs |= {(noises[-1], expected) for expected in _MISJUDGED}
    cases: list[dict[str, Any]] = [
        {'noise': noise, 'settings': _settings(expected), **case}
        for noise, expected in sorted(pairs)
        for case in grid(dogs=herds, seed=options.seed_range(20))
    ]
    cases += [
        {'noise': noises[-1], 'settings': _seen_settings(velocities, noises[-1]),
         'velocities': velocities, 'dogs': _FEW, 'seed': seed}
        for velocities in _SEEN.values()
        for seed in options.seed_range(20)
    ]  # fmt: skip
    return [run_task(options, 0.2 if quick else 4.0 / case['dogs'], **case) for case in cases]


def _seen_settings(velocities: bool, noise: float) -> dict[str, Any]:
    """Settings of a controller that expects the noise of what it sees."""
    names = ('position_noise', 'velocity_noise') if velocities else ('position_noise',)
    return {f'sensor.{name}': noise for name in names}


_Runs = dict[tuple[int, float, float], Results]
"""Runs by dogs, noise and the noise that is expected."""


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and the picture."""
    runs = {
        (dogs, noise, expected): results.of(
            'herding', dogs=dogs, noise=noise, settings=_settings(expected)
        )
        for dogs, noise, expected in product(_DOGS, _NOISES, sorted({*_NOISES, *_MISJUDGED}))
    }
    alone = {
        what: results.of('herding', dogs=_FEW, velocities=velocities)
        for what, velocities in _SEEN.items()
    }
    _draw_times(runs, figures)
    groups = (
        ({'noise': f'{noise:g}', 'expected': f'{expected:g}'}, runs[dogs, noise, expected])
        for dogs, noise, expected in sorted(runs)
    )
    values = {
        'seeds': results.seeds,
        'tables': '\n\n'.join(f'### {dogs} dogs\n\n{_table(runs, dogs)}' for dogs in _DOGS),
        'paired': _paired_table(runs),
        'errors': _error_table(runs),
        'misjudged': _misjudged_table(runs),
        'failures': failures(groups),
        'alone': _alone_table(alone),
        'alone_failures': failures(({'observed': what}, each) for what, each in alone.items()),
    }
    goals = [*_goals(runs), *_goals_alone(*alone.values())]
    return Section(values, [*_rows(runs), *_rows_alone(*alone.values())], goals)


def _table(runs: _Runs, dogs: int) -> str:
    return table(
        {
            'noise [m, m/s]': f'{noise:g}',
            'planned from': plan,
            **summary(found),
            'spread at the end [m]': found.mean('final_spread'),
        }
        for noise, plan in product(_NOISES, _COLOURS)
        if (noise or plan == 'as observed')  # without noise there is nothing to filter
        and len(found := runs[dogs, noise, _expected(plan, noise)])
    )


def _slowdown(found: Results, exact: Results) -> tuple[Mean, int]:
    """Return the mean logarithm of the time, relative to that of the same flock observed exactly.

    And the number of flocks in it: those that arrived safely both times.
    """
    here, there = found.by_seed(), exact.by_seed()
    both = [seed for seed in here.keys() & there.keys() if safe(here[seed]) and safe(there[seed])]
    ratios = [math.log(here[seed]['time'] / there[seed]['time']) for seed in sorted(both)]
    return Mean.of(ratios), len(ratios)


def _percent(slowdown: Mean) -> str:
    """Write a mean logarithm of a ratio in percent, with its standard error."""
    if math.isnan(slowdown.value):
        return '–'
    middle = 100.0 * math.expm1(slowdown.value)
    error = 100.0 * math.exp(slowdown.value) * slowdown.error
    return f'{middle:+.0f}' if math.isnan(error) else f'{middle:+.0f} ± {error:.0f}'


def _paired_table(runs: _Runs) -> str:
    rows = []
    for dogs, noise in product(_DOGS, _NOISES[1:]):
        if not len(runs[dogs, noise, 0.0]):
            continue
        row = {'dogs': str(dogs), 'noise [m, m/s]': f'{noise:g}'}
        for plan in _COLOURS:
            found = runs[dogs, noise, _expected(plan, noise)]
            slowdown, count = _slowdown(found, runs[dogs, 0.0, 0.0])
            row[f'{plan} [%] (flocks)'] = f'{_percent(slowdown)} ({count})'
        rows.append(row)
    return table(rows)


def _error(runs: Results, name: str, quantity: str) -> float:
    """Return the root mean square over all runs."""
    return float(np.sqrt(np.square(runs.values('errors', name, quantity)).mean()))


def _error_table(runs: _Runs) -> str:
    columns = {
        'position of a sheep, {} [m]': 'position',
        'velocity, {} [m/s]': 'velocity',
        'position of a dog, {} [m]': 'dog',
    }
    return table(
        {
            'dogs': dogs,
            'noise [m, m/s]': f'{noise:g}',
            **{
                words.format(name): _error(found, name, quantity)
                for words, quantity in columns.items()
                for name in ('observed', 'estimated')
            },
        }
        for dogs, noise in product(_DOGS, _NOISES[1:])
        if len(found := runs[dogs, noise, noise])
    )


def _misjudged_table(runs: _Runs) -> str:
    noise = _NOISES[-1]
    return table(
        {
            'dogs': dogs,
            'expected noise [m, m/s]': f'{expected:g}',
            'safe arrivals': success(found),
            'median time [s]': median_time(found),
            'error of estimated positions [m]': _error(found, 'estimated', 'position'),
            'of velocities [m/s]': _error(found, 'estimated', 'velocity'),
        }
        for dogs, expected in product(_DOGS, sorted({0.0, noise, *_MISJUDGED}))
        if len(found := runs[dogs, noise, expected])
    )


def _alone_table(alone: dict[str, Results]) -> str:
    whole = alone['positions and velocities']
    rows = []
    for what, found in alone.items():
        if not len(found):
            continue
        slowdown, count = _slowdown(found, whole)
        rows.append(
            {
                'observed': what,
                **summary(found),
                'change of the time [%] (flocks)': (
                    '' if found is whole else f'{_percent(slowdown)} ({count})'
                ),
                'error of estimated positions [m]': _error(found, 'estimated', 'position'),
                'of velocities [m/s]': _error(found, 'estimated', 'velocity'),
            }
        )
    return table(rows)


def _rows_alone(whole: Results, alone: Results) -> list[Row]:
    what = f'Positions alone, noise {_NOISES[-1]:g} m, {_FEW} dogs'
    return arrival_row(what, NOT_IN_PAPER, alone, {'velocities too': whole})


def _goals_alone(whole: Results, alone: Results) -> list[Goal]:
    enough = min(len(whole), len(alone)) >= 20
    arrived, (slowdown, _) = success(alone), _slowdown(alone, whole)
    what = f'{_FEW} dogs, positions alone, noise {_NOISES[-1]:g} m'
    here = arrived.value >= _ENOUGH if enough else None
    soon = slowdown.value <= math.log1p(_MORE_TIME) if enough else None
    bound = f'≤ {100.0 * _MORE_TIME:g} % of that with velocities'
    return [
        Goal(f'{what}: safe arrivals', f'≥ {100.0 * _ENOUGH:g} %', arrived, here),
        Goal(f'{what}: mean change of the time', bound, f'{_percent(slowdown)} %', soon),
    ]


def _draw_times(runs: _Runs, figures: Path) -> None:
    figure, axes = new(len(_DOGS), 1, width=4.5, height=3.0)
    for place, dogs in zip(axes[0], _DOGS, strict=True):
        for offset, (plan, colour) in zip((-0.12, 0.12), _COLOURS.items(), strict=True):
            for k, noise in enumerate(_NOISES):
                found = runs[dogs, noise, _expected(plan, noise)]
                draw_times(place, k + offset, found, LIMIT, 0.1, colour, '' if k else plan)
        place.set(yscale='log', ylim=(20.0, 1.1 * LIMIT))
        place.set(xlabel='noise [m, m/s]', ylabel='time of arrival [s]')
        place.set_xticks(range(len(_NOISES)), [f'{noise:g}' for noise in _NOISES])
        place.set_title(f'{dogs} dogs', fontsize=9)
    legend(axes[0, 0])
    save(figure, figures / 'observation.png')


def _rows(runs: _Runs) -> list[Row]:
    rows = []
    for dogs, noise in product(_DOGS, _NOISES[1:]):
        what = f'Observation noise {noise:g} m and m/s, {dogs} dogs'
        others = {'as observed': runs[dogs, noise, 0.0], 'without noise': runs[dogs, 0.0, 0.0]}
        rows += arrival_row(what, NOT_IN_PAPER, runs[dogs, noise, noise], others)
    return rows


def _goals(runs: _Runs) -> list[Goal]:
    goals, noise = [], _NOISES[-1]
    for dogs in _DOGS:
        filtered, exact = runs[dogs, noise, noise], runs[dogs, 0.0, 0.0]
        enough = min(len(filtered), len(exact)) >= 20
        ours, theirs = success(filtered), success(exact)
        slowdown, _ = _slowdown(filtered, exact)
        what = f'{dogs} dogs, observation noise {noise:g} m and m/s, filtered'
        reached = ours.successes >= theirs.successes if enough else None
        goals.append(Goal(f'{what}: safe arrivals', f'as without noise, {theirs}', ours, reached))
        reached = slowdown.value <= math.log(1.1) if enough else None
        change = f'{_percent(slowdown)} %'
        goals.append(Goal(f'{what}: mean change of the time', '≤ 10 %', change, reached))
    return goals
