"""Noisy observations: what they cost, and what the controller's filter makes of them."""

from __future__ import annotations

from itertools import product
import math
from pathlib import Path
from typing import Any

import numpy as np

from .markdown import table
from .pictures import BLUE, new, RED, save
from .runs import (
    FAILURES,
    failures,
    median_time,
    paths_of,
    safe,
    success,
    SUMMARY,
    summary,
    times,
    under,
)
from .statistics import Mean, significant
from .study import Goal, Options, Results, Row, Section
from .task import Task

DESCRIPTION = 'observation noise up to 0.05 m and 0.05 m/s, filtered and as it is'

_NOISES = (0.0, 0.01, 0.02, 0.05)
"""Standard deviation of observed positions [m] and velocities [m/s]."""
_DOGS = (2, 5)
_GOAL = [0.5, 0.5]
_LIMIT = 400.0
_MISJUDGED = (0.02, 0.1)
"""What the filter expects while the largest noise is there."""
_COLOURS = {'as observed': RED, 'filtered': BLUE}


def _settings(expected: float) -> dict[str, Any]:
    """Settings of a controller that expects so much noise [m and m/s]; 0: no filter."""
    if not expected:
        return {}
    return {'sensor': {'position_noise': expected, 'velocity_noise': expected}}


def _expected(way: str, noise: float) -> float:
    return noise if way == 'filtered' else 0.0


def tasks(options: Options) -> list[Task]:
    """Return runs of the same flocks under every noise, with and without the filter."""
    quick = options.quick
    noises, herds = ((0.0, 0.05), _DOGS[:1]) if quick else (_NOISES, _DOGS)
    pairs = {(noise, _expected(way, noise)) for noise in noises for way in _COLOURS}
    pairs |= {(noises[-1], expected) for expected in _MISJUDGED}
    return [
        Task(
            'observation',
            {
                'sheep': 6 if quick else 20,
                'dogs': dogs,
                'sigma': 0.01,
                'goal': _GOAL,
                'noise': noise,
                'seed': seed,
                'time_limit': 10.0 if quick else _LIMIT,
                'settings': paths_of(_settings(expected), options.path_number(100)),
            },
            cost=0.2 if quick else 4.0 / dogs,
        )
        for (noise, expected), dogs, seed in product(sorted(pairs), herds, options.seed_range(20))
    ]


_Runs = dict[tuple[int, float, float], Results]
"""Runs by dogs, noise and the noise that is expected."""


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and the picture."""
    runs = {
        (dogs, noise, expected): under(
            _settings(expected), results.of('observation', dogs=dogs, noise=noise)
        )
        for dogs, noise, expected in product(_DOGS, _NOISES, sorted({*_NOISES, *_MISJUDGED}))
    }
    values = {
        'seeds': str(len(results.parameter('seed'))),
        'tables': '\n\n'.join(f'### {dogs} dogs\n\n{_table(runs, dogs)}' for dogs in _DOGS),
        'paired': _paired_table(runs),
        'errors': _error_table(runs),
        'misjudged': _misjudged_table(runs),
        'failures': _failures(runs),
        'picture': _figure(runs, figures),
    }
    return Section(values, _rows(runs), _goals(runs))


def _ways(noise: float) -> list[str]:
    """Without noise there is nothing to filter."""
    return list(_COLOURS) if noise else ['as observed']


def _table(runs: _Runs, dogs: int) -> str:
    rows = []
    for noise in _NOISES:
        for way in _ways(noise):
            found = runs[dogs, noise, _expected(way, noise)]
            if len(found):
                end = Mean.of(found.values('final_spread'))
                rows.append((f'{noise:g}', way, *summary(found), str(end)))
    return table(('noise [m, m/s]', 'planned from', *SUMMARY, 'spread at the end [m]'), rows)


def _slowdown(found: Results, exact: Results) -> tuple[Mean, int]:
    """Return the mean logarithm of the time, relative to that of the same flock seen exactly.

    And over how many flocks: those that arrived safely both times.
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
        cells = []
        for way in _COLOURS:
            found = runs[dogs, noise, _expected(way, noise)]
            slowdown, count = _slowdown(found, runs[dogs, 0.0, 0.0])
            cells.append(f'{_percent(slowdown)} ({count})')
        if len(runs[dogs, noise, 0.0]):
            rows.append((str(dogs), f'{noise:g}', *cells))
    head = ('dogs', 'noise [m, m/s]', *(f'{way} [%] (flocks)' for way in _COLOURS))
    return table(head, rows)


def _error(runs: Results, name: str, quantity: str) -> str:
    """Return the root mean square over all runs."""
    squares = np.square(runs.values('errors', name, quantity))
    return significant(float(np.sqrt(squares.mean())))


def _error_table(runs: _Runs) -> str:
    rows = []
    for dogs, noise in product(_DOGS, _NOISES[1:]):
        found = runs[dogs, noise, noise]
        if len(found):
            errors = [
                _error(found, name, quantity)
                for quantity in ('position', 'velocity', 'dog')
                for name in ('seen', 'believed')
            ]
            rows.append((str(dogs), f'{noise:g}', *errors))
    head = (
        'dogs', 'noise [m, m/s]', 'position of a sheep, seen [m]', 'believed',
        'velocity, seen [m/s]', 'believed', 'position of a dog, seen [m]', 'believed',
    )  # fmt: skip
    return table(head, rows)


def _misjudged_table(runs: _Runs) -> str:
    noise, rows = _NOISES[-1], []
    for dogs, expected in product(_DOGS, sorted({0.0, noise, *_MISJUDGED})):
        found = runs[dogs, noise, expected]
        if len(found):
            errors = [_error(found, 'believed', each) for each in ('position', 'velocity')]
            cells = (str(success(found)), str(median_time(found)))
            rows.append((str(dogs), f'{expected:g}', *cells, *errors))
    head = (
        'dogs', 'expected noise [m, m/s]', 'safe arrivals', 'median time [s]',
        'error of believed positions [m]', 'of velocities [m/s]',
    )  # fmt: skip
    return table(head, rows)


def _failures(runs: _Runs) -> str:
    rows = [
        (f'{noise:g}', f'{expected:g}', *row)
        for (_, noise, expected), found in sorted(runs.items(), key=lambda entry: entry[0])
        for row in failures(found)
    ]
    if not rows:
        return ''
    return 'Runs without safe arrival:\n\n' + table(('noise', 'expected', *FAILURES), rows)


def _figure(runs: _Runs, figures: Path) -> str:
    figure, axes = new(len(_DOGS), 1, width=4.5, height=3.0)
    for place, dogs in zip(axes[0], _DOGS, strict=True):
        for offset, (way, colour) in zip((-0.12, 0.12), _COLOURS.items(), strict=True):
            for k, noise in enumerate(_NOISES):
                found = times(runs[dogs, noise, _expected(way, noise)])
                at = np.full(len(found), k + offset)
                place.plot(
                    at, np.minimum(found, _LIMIT), '.', color=colour, alpha=0.6,
                    label='' if k else way,
                )  # fmt: skip
                if found:
                    middle = min(float(np.median(found)), _LIMIT)
                    place.plot(at[0] + [-0.1, 0.1], [middle, middle], color=colour)
        place.set(
            yscale='log', ylim=(20.0, 1.1 * _LIMIT), xlabel='noise [m, m/s]',
            ylabel='time of arrival [s]',
        )  # fmt: skip
        place.set_xticks(range(len(_NOISES)), [f'{noise:g}' for noise in _NOISES])
        place.set_title(f'{dogs} dogs', fontsize=9)
    axes[0, 0].legend(fontsize=7, frameon=False)
    return save(figure, figures / 'observation.png')


def _rows(runs: _Runs) -> list[Row]:
    rows = []
    for dogs, noise in product(_DOGS, _NOISES[1:]):
        filtered, raw = runs[dogs, noise, noise], runs[dogs, noise, 0.0]
        exact = runs[dogs, 0.0, 0.0]
        if len(filtered):
            rows.append(
                Row(
                    f'Observation noise {noise:g} m and m/s, {dogs} dogs: time of arrival',
                    'not in the paper',
                    f'{median_time(filtered)} s',
                    f'{success(filtered)} safe; as observed: {median_time(raw)} s, '
                    f'{success(raw)}; without noise: {median_time(exact)} s, {success(exact)}',
                )
            )
    return rows


def _goals(runs: _Runs) -> list[Goal]:
    goals, noise = [], _NOISES[-1]
    for dogs in _DOGS:
        filtered, exact = runs[dogs, noise, noise], runs[dogs, 0.0, 0.0]
        enough = min(len(filtered), len(exact)) >= 20
        slowdown, _ = _slowdown(filtered, exact)
        what = f'{dogs} dogs, observation noise {noise:g} m and m/s, filtered'
        goals += [
            Goal(
                f'{what}: safe arrivals', f'as without noise, {success(exact)}',
                str(success(filtered)),
                success(filtered).successes >= success(exact).successes if enough else None,
            ),
            Goal(
                f'{what}: mean change of the time', '≤ 10 %', f'{_percent(slowdown)} %',
                slowdown.value <= math.log(1.1) if enough else None,
            ),
        ]  # fmt: skip
    return goals
