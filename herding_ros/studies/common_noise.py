"""What mapping and feedback do when all sheep have the same random force, or each its own."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from herding_ros.control.parameters import Control, Mapping, PAPER
from herding_ros.model.scenario import GOAL

from .experiments.settings import differences
from .markdown import table
from .pictures import BLUE, COLOURS, GREY, new, save
from .runs import median_time, paths_of, PLAIN, run_task, success, under, with_mapping
from .statistics import Mean
from .stochasticity import ratios
from .study import Options, Results, Row, Section
from .task import Task

DESCRIPTION = 'mapping and herding under individual and common noise, and mixtures of both'

SHARES = (0.0, 0.25, 0.5, 1.0)
"""Share of the noise's variance that all sheep have in common."""
_SIGMA = 0.03

_RUN_SIGMAS = (0.01, 0.02)
_PLANS = {
    'mapped, multilevel': {},
    'mapped, plain paths': PLAIN,
    'not mapped': with_mapping(PLAIN, max_iterations=0),
}
"""Settings of the controller in whole runs."""

_Way = tuple[str, int]
"""An estimator of the expected centre, and how many paths it may cost."""


def _settings(way: _Way) -> dict[str, Any]:
    """Settings of the paper's window with our mapping, four iterations whatever happens."""
    estimator, paths = way
    mapping = Mapping(
        'output', estimator, 0.0, paths=paths, max_iterations=4, accuracy=1e-9
    )  # fmt: skip
    return differences(replace(PAPER, mapping=mapping), Control())


def tasks(options: Options) -> list[Task]:
    """Return the same windows under every share, mapped with few and many paths, and runs."""
    quick = options.quick
    few = options.path_number(100)
    ways = product(('plain', 'multilevel'), (few,) if quick else (few, 10 * few))
    herd = {'sheep': 6 if quick else 30, 'dogs': 2 if quick else 5}
    windows = [
        Task(
            'common_noise',
            {
                **herd,
                'sigma': _SIGMA,
                'common_noise': share,
                'seed': seed,
                'judge_paths': 16 if quick else 400,
                'trace': seed == 0 and way == ('plain', few) and share in (SHARES[0], SHARES[-1]),
                'control': _settings(way),
            },
            cost=0.1 if quick else 2.5 + 0.0016 * way[1],
        )
        for way, share, seed in product(ways, SHARES, options.seed_range(10))
    ]
    runs = [
        _run(paths_of(settings, few), sigma, share, seed, quick)
        for settings, sigma, share, seed in product(
            _PLANS.values(), _RUN_SIGMAS[:1] if quick else _RUN_SIGMAS, (SHARES[0], SHARES[-1]),
            options.seed_range(10),
        )
    ]  # fmt: skip
    return windows + runs


def _run(settings: dict[str, Any], sigma: float, share: float, seed: int, quick: bool) -> Task:
    """Return the task of herding a flock home under common noise."""
    limit, sheep, cost = (10.0, 6, 0.1) if quick else (300.0, 20, 1.5)
    task = run_task('planner', settings, 5, sigma, GOAL, seed, limit, cost, sheep)
    return replace(task, parameters={**task.parameters, 'common_noise': share})


def _way(parameters: dict[str, Any]) -> _Way:
    mapping = parameters['control']['mapping']
    given = {name: mapping.get(name, getattr(Mapping(), name)) for name in ('estimator', 'paths')}
    return str(given['estimator']), int(given['paths'])


def _at(results: Results, way: _Way, share: float) -> Results:
    windows = results.of('common_noise', common_noise=share)
    return windows.where(lambda task: _way(task.parameters) == way)


def draw(results: Results, figures: Path) -> Section:
    """Make the table and the picture."""
    windows = results.of('common_noise')
    ways = sorted(
        {_way(task.parameters) for task, _ in windows.entries},
        key=lambda way: (way[0] != 'plain', way),
    )
    values = {
        'seeds': str(len(results.parameter('seed'))),
        'judge_paths': ', '.join(f'{paths:,}' for paths in windows.parameter('judge_paths')),
        'table': _table(results, ways),
        'runs': _runs_table(results),
        'picture': _figure(results, ways, figures),
    }
    return Section(values, _rows(results, ways))


def _words(way: _Way) -> str:
    return f'{way[1]:,} {way[0]}'


def _table(results: Results, ways: list[_Way]) -> str:
    rows = []
    for way, share in product(ways, SHARES):
        found = _at(results, way, share)
        if len(found):
            keys = ('before', 'after', 'judged_before', 'judged_after')
            cells = [str(Mean.of(found.values(key))) for key in keys]
            unseen = ratios(found, 'judged_after', 'judged_before')
            wander = Mean.of(found.values('wander'))
            floor = Mean.of([each['wander'] / way[1] ** 0.5 for each in found])
            rows.append((_words(way), f'{share:g}', *cells, str(unseen), str(floor), str(wander)))
    head = (
        'paths', 'share in common', 'before, seen', 'after, seen', 'before, unseen',
        'after, unseen', 'after / before, unseen', 'error of the plain mean of so many',
        'a single path',
    )  # fmt: skip
    return table(head, rows)


def _runs_table(results: Results) -> str:
    rows = []
    for sigma, share, (words, settings) in product(_RUN_SIGMAS, SHARES, _PLANS.items()):
        found = under(settings, results.of('herding', sigma=sigma, common_noise=share))
        if len(found):
            cells = (str(success(found)), str(median_time(found)))
            wide = str(Mean.of(found.values('max_spread')))
            rows.append((f'{sigma:g}', f'{share:g}', words, *cells, wide))
    head = (
        'σ', 'share in common', 'plans', 'safe arrivals', 'median time [s]',
        'largest spread, mean [m]',
    )  # fmt: skip
    return table(head, rows)


def _figure(results: Results, ways: list[_Way], figures: Path) -> str:
    figure, ((errors, *places),) = new(3, 1, width=4.0, height=3.2)
    for colour, way in zip(COLOURS, ways, strict=False):
        for key, style in (('judged_before', '--'), ('judged_after', '-')):
            means = [Mean.of(_at(results, way, share).values(key)) for share in SHARES]
            word = 'before' if style == '--' else f'after, {_words(way)}'
            if style == '-' or way == ways[0]:
                errors.errorbar(
                    SHARES, [mean.value for mean in means], [mean.error for mean in means],
                    color=GREY if style == '--' else colour, linestyle=style, label=word,
                )  # fmt: skip
    errors.set(
        xlabel='share in common', ylabel='error on unseen noise [m s$^{0.5}$]', ylim=(0, None)
    )
    for place, share in zip(places, (SHARES[0], SHARES[-1]), strict=True):
        place.set_title(f'share in common {share:g}', fontsize=9)
        found = results.of('common_noise', common_noise=share)
        for trace in [each['trace'] for each in found if 'trace' in each]:
            for single in trace['singles']:
                place.plot(*np.transpose(single), color=BLUE, linewidth=0.7, alpha=0.5)
            place.plot(*np.transpose(trace['wanted']), color='black', linestyle='--')
        place.set(xlabel='x [m]', ylabel='y [m]')
        place.set_aspect('equal', adjustable='datalim')
    if ways:
        errors.legend(fontsize=7, frameon=False)
    return save(figure, figures / 'common_noise.png')


def _rows(results: Results, ways: list[_Way]) -> list[Row]:
    rows = []
    for way, share in product(ways, SHARES):
        found = _at(results, way, share)
        if len(found):
            rows.append(
                Row(
                    f'Common noise, share {share:g}, {_words(way)} paths: error after mapping',
                    'not in the paper',
                    str(Mean.of(found.values('judged_after'))),
                    f'on unseen noise, after / before '
                    f'{ratios(found, "judged_after", "judged_before")}',
                )
            )
    return rows
