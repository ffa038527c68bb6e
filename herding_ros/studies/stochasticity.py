"""Table 1 and Figure "compare iterations": how noise spoils a plan, and what mapping repairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from herding_ros.control.parameters import Control, Mapping, PAPER

from .direct_comparison import (
    comparison,
    cost_shares,
    draw_costs,
    Pair,
    SENSITIVITY,
    shares,
)
from .experiments.settings import differences
from .markdown import table
from .pictures import COLOURS, new, save
from .statistics import Mean, significant
from .study import Goal, Options, Results, Row, Section
from .task import Task

DESCRIPTION = 'Table 1, Figure "compare iterations": error by noise, before and after mapping'

SIGMAS = (0.01, 0.02, 0.03, 0.04)
_ITERATIONS = 4
_PAPER_BEFORE = {
    100: dict(zip(SIGMAS, (7.00e-3, 3.73e-2, 9.09e-2, 1.57e-1), strict=True)),
    1000: dict(zip(SIGMAS, (9.28e-3, 4.25e-2, 9.70e-2, 1.60e-1), strict=True)),
}
_PAPER_AFTER = {
    100: dict(zip(SIGMAS[:3], (7.00e-3, 1.05e-2, 7.05e-2), strict=True)),
    1000: dict(zip(SIGMAS[:3], (9.28e-3, 1.31e-2, 7.07e-2), strict=True)),
}
_PAPER_ITERATIONS = dict(zip(SIGMAS[:3], (0, 1, 3), strict=True))
_RATIO_GOALS = {0.02: 0.12, 0.03: 0.13, 0.04: 0.27}

_MAPPINGS = {
    'output': replace(PAPER.mapping, method='output', max_iterations=_ITERATIONS, accuracy=1e-9),
    'aggressive': replace(
        PAPER.mapping, max_iterations=_ITERATIONS, tolerance=0.0, min_decrease=-1e9
    ),
    'paper': PAPER.mapping,
    'multilevel': Mapping('output', max_iterations=_ITERATIONS, accuracy=1e-9),
}
"""Our mapping and the paper's, four iterations whatever happens; the paper's stopping rule.

All see plain paths as the paper's does, but for the last.
"""
_WORDS = {
    'output': 'output mapping, 4 iterations',
    'aggressive': 'aggressive mapping, 4 iterations',
    'paper': "aggressive mapping, the paper's stopping rule",
    'multilevel': 'output mapping, 4 iterations, multilevel Monte Carlo',
}
_VARIANT_SIGMAS = (0.03,)


def _settings(name: str, paths: int) -> dict[str, Any]:
    mapping = replace(_MAPPINGS[name], paths=paths)
    return differences(replace(PAPER, mapping=mapping), Control())


def tasks(options: Options) -> list[Task]:
    """Return windows mapped by the controller, by variants of Algorithm 1, and directly."""
    seeds, quick = options.seed_range(10), options.quick
    paths = options.path_number(100)
    sigmas = SIGMAS[1:3] if quick else SIGMAS
    judge = 16 if quick else 1000
    herd = {'sheep': 6 if quick else 30, 'dogs': 2 if quick else 5}
    windows = [
        Task(
            'window',
            {
                **herd,
                'sigma': sigma,
                'seed': seed,
                'judge_paths': judge,
                'trace': name == 'output' and number == paths,
                'control': _settings(name, number),
            },
            cost=0.1 if quick else 2.3 + 0.0016 * number,
        )
        for name, number, sigma, seed in product(_MAPPINGS, _path_numbers(options), sigmas, seeds)
    ]
    directs = [
        Task(
            'direct',
            {
                **herd,
                'sigma': sigma,
                'seed': seed,
                'paths': paths,
                'iterations': 4 if quick else 100,
                'judge_paths': judge,
                'control': _settings('output', paths),
            },
            cost=0.05 if quick else 0.33 * paths,
        )
        for sigma, seed in product(sigmas, seeds)
    ]
    variants = [
        Task(
            'variant',
            {
                **herd,
                'sigma': sigma,
                'seed': seed,
                'paths': paths,
                'judge_paths': judge,
                'iterations': 1 if quick else _ITERATIONS,
                'control': _settings('paper', paths),
                'optimiser': optimiser,
                'observable': observable,
                'common_numbers': common_numbers,
                'broyden': broyden,
            },
            cost=0.2 if quick else 3.5,
        )
        for optimiser, observable, common_numbers, broyden, sigma, seed in product(
            ('spg', 'ncg'),
            ('centre',) if quick else ('centre', 'individuals'),
            (True, False),
            (True, False),
            _VARIANT_SIGMAS,
            seeds[:1] if quick else seeds,
        )
    ]
    return directs + windows + variants


def _path_numbers(options: Options) -> tuple[int, ...]:
    paths = options.path_number(100)
    return (paths,) if options.quick else (paths, 10 * paths)


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and figures."""
    mapped = {name: _of(results, name) for name in _MAPPINGS}
    numbers = sorted({_paths(task.parameters) for task, _ in results.of('window').entries})
    few = numbers[0] if numbers else 100
    sigmas = results.of('window').parameter('sigma')
    windows = results.of('window')
    pairs = {sigma: _pairs(results, mapped['output'], few, sigma) for sigma in sigmas}
    aggressive = {sigma: list(_at(mapped['aggressive'], few, sigma)) for sigma in sigmas}
    values = {
        'seeds': str(len(results.parameter('seed'))),
        'paths': str(few),
        'judge_paths': ', '.join(f'{paths:,}' for paths in windows.parameter('judge_paths')),
        'floors': ', '.join(
            significant(float(np.mean(_at(windows, few, sigma).values('uncertainty'))), 2)
            for sigma in sigmas
        ),
        'main_table': _main_table(mapped, numbers, sigmas),
        'centres': _centres(mapped, few, figures),
        'sensitivity': str(SENSITIVITY),
        'direct_table': comparison(pairs, few),
        'cost': draw_costs(pairs, aggressive, few, figures / 'stochasticity-cost.png'),
        'variants': _variants(results, few),
    }
    return Section(values, _rows(mapped, numbers, sigmas), _goals(results, mapped))


def _paths(parameters: dict[str, Any]) -> int:
    return int(parameters['control']['mapping'].get('paths', Mapping().paths))


def _of(results: Results, name: str) -> Results:
    """Return the windows that were mapped in this way, with any number of paths."""
    return results.of('window').where(
        lambda task: task.parameters['control'] == _settings(name, _paths(task.parameters))
    )


def _at(windows: Results, paths: int, sigma: float) -> Results:
    return windows.of('window', sigma=sigma).where(lambda task: _paths(task.parameters) == paths)


def _pairs(results: Results, output: Results, paths: int, sigma: float) -> list[Pair]:
    directs = results.of('direct', sigma=sigma, paths=paths).by_seed()
    windows = _at(output, paths, sigma).by_seed()
    return [(window, directs[seed]) for seed, window in windows.items() if seed in directs]


def ratios(windows: Results, after: str = 'after', before: str = 'before') -> Mean:
    """Return the mean of after / before over the flocks."""
    return Mean.of([each[after] / each[before] for each in windows if each[before] > 0.0])


def _main_table(
    mapped: dict[str, Results], numbers: Sequence[int], sigmas: Sequence[float]
) -> str:
    rows = []
    for paths in numbers:
        any_mapping = next((each for each in mapped.values() if len(each)), Results([]))
        rows.append(
            [f'**{paths} paths**', 'before, seen']
            + [str(Mean.of(_at(any_mapping, paths, s).values('before'))) for s in sigmas]
        )
        rows.append(
            ['', '*the paper*'] + [_printed(_PAPER_BEFORE.get(paths, {}).get(s)) for s in sigmas]
        )
        rows.append(
            ['', 'before, unseen']
            + [str(Mean.of(_at(any_mapping, paths, s).values('judged_before'))) for s in sigmas]
        )
        for name, words in _WORDS.items():
            cells: dict[str, list[str]] = {}
            for s in sigmas:
                found = _at(mapped[name], paths, s)
                for key, text in (
                    ('iterations', 'iterations'),
                    ('residual', 'residual'),
                    ('after', 'after, seen'),
                    ('judged_after', 'after, unseen'),
                ):
                    cells.setdefault(text, []).append(str(Mean.of(found.values(key))))
                cells.setdefault('after / before, seen', []).append(str(ratios(found)))
                cells.setdefault('after / before, unseen', []).append(
                    str(ratios(found, 'judged_after', 'judged_before'))
                )
            for k, (text, values) in enumerate(cells.items()):
                rows.append(['' if k else words, text, *values])
        rows.append(
            ['*the paper*', 'iterations']
            + [str(_PAPER_ITERATIONS[s]) if s in _PAPER_ITERATIONS else 'none' for s in sigmas]
        )
        rows.append(['', 'after'] + [_printed(_PAPER_AFTER.get(paths, {}).get(s)) for s in sigmas])
    return table(['', '', *(f'σ = {sigma:g}' for sigma in sigmas)], rows)


def _printed(value: float | None) -> str:
    return 'none' if value is None else significant(value)


def _centres(mapped: dict[str, Results], paths: int, figures: Path) -> str:
    """Draw where centres go, and how far that is from the plan, for the flock with seed 0."""
    figure, axes = new(2, 2, width=5.0, height=2.8)
    traced = sorted(
        (
            (task.parameters['sigma'], result['trace'])
            for task, result in mapped['output'].entries
            if 'trace' in result and task.parameters['seed'] == 0
        ),
        key=lambda each: float(each[0]),
    )
    for (where, away), key in zip(axes, ('before', 'after'), strict=True):
        for colour, (sigma, trace) in zip(COLOURS, traced, strict=False):
            found, wanted = np.array(trace[key]), np.array(trace['wanted'])
            where.plot(*found.T, color=colour)
            deviation = 1e3 * np.linalg.norm(found - wanted, axis=1)
            away.plot(0.5 * np.arange(len(found)), deviation, color=colour, label=f'σ = {sigma:g}')
        if traced:
            wanted = np.array(traced[0][1]['wanted'])
            where.plot(*wanted.T, color='black', linestyle='--', linewidth=0.8)
            where.plot(*wanted[0], 'x', color='black')
            away.legend(fontsize=7, frameon=False)
        where.set(xlabel='x [m]', ylabel='y [m]')
        where.set_aspect('equal', adjustable='datalim')
        where.set_title(f'{key} mapping', fontsize=9)
        away.set(xlabel='time [s]', ylabel='|X̄ − x̄_c| [mm]', ylim=(0.0, None))
        away.sharey(axes[0, 1])
    return save(figure, figures / 'stochasticity-centres.png')


def _variants(results: Results, paths: int) -> str:
    """Return the table of variants: every combination of the four switches."""
    variants = results.of('variant')
    sigmas = variants.parameter('sigma')
    head = ['extraction', 'observable', 'noise', 'matrix']
    first = ['none: the deterministic control', '', '', '']
    for sigma in sigmas:
        head += [f'last, seen, σ = {sigma:g}', f'chosen, unseen, σ = {sigma:g}']
        # The deterministic control is the same whatever the mapping: once for each flock.
        windows = _at(results, paths, sigma).by_seed().values()
        for key in ('before', 'judged_before'):
            first.append(str(Mean.of([window[key] for window in windows])))
    rows = [[*first, '']]
    for optimiser, observable, common_numbers, broyden in product(
        ('spg', 'ncg'), ('centre', 'individuals'), (True, False), (True, False)
    ):
        found = variants.of(
            'variant',
            optimiser=optimiser,
            observable=observable,
            common_numbers=common_numbers,
            broyden=broyden,
        )
        cells = [
            optimiser.upper(),
            observable,
            'common' if common_numbers else 'new each time',
            'Broyden' if broyden else 'B = I',
        ]
        for sigma in sigmas:
            here = found.of('variant', sigma=sigma)
            cells.append(str(Mean.of([each['misfits'][-1] for each in here])))
            cells.append(str(Mean.of(here.values('judged', 'error'))))
        rows.append([*cells, str(Mean.of(found.values('calls', 'extraction')))])
    return table([*head, 'values and gradients in extraction'], rows)


def _rows(
    mapped: dict[str, Results], numbers: Sequence[int], sigmas: Sequence[float]
) -> list[Row]:
    rows = []
    if len(mapped['output']):
        what = 'Figure "compare iterations": centres before and after mapping'
        rows.append(Row(what, 'a picture', 'a picture, below'))
    for paths, sigma in product(numbers, sigmas):
        found = _at(mapped['output'], paths, sigma)
        if not len(found):
            continue
        paper = _PAPER_BEFORE.get(paths, {}).get(sigma)
        name = f'Table 1, {paths} paths, σ = {sigma:g}'
        rows.append(
            Row(
                f'{name}: error of the deterministic control',
                _printed(paper),
                str(Mean.of(found.values('before'))),
            )
        )
        unseen = ratios(found, 'judged_after', 'judged_before')
        rows.append(
            Row(
                f'{name}: error after mapping',
                _printed(_PAPER_AFTER.get(paths, {}).get(sigma)),
                str(Mean.of(found.values('after'))),
                f'after / before {ratios(found)}, on unseen noise {unseen}',
            )
        )
    return rows


def _goals(results: Results, mapped: dict[str, Results]) -> list[Goal]:
    goals = []
    for sigma, bound in _RATIO_GOALS.items():
        ratio = ratios(_at(mapped['output'], 100, sigma))
        goals.append(
            Goal(
                f'σ = {sigma:g}: error after / before mapping, at most 4 iterations',
                f'≤ {bound}',
                str(ratio),
                ratio.value <= bound if ratio.count >= 10 else None,
            )
        )
    for sigma in SIGMAS[:3]:
        pairs = _pairs(results, mapped['output'], 100, sigma)
        share, cost = shares(pairs), cost_shares(pairs, 100)
        goals.append(
            Goal(
                f"σ = {sigma:g}: share of direct optimisation's error reduction; of its cost",
                '≥ 0.9; ≤ 0.2',
                f'{share}; {cost}',
                share.value >= 0.9 and cost.value <= 0.2 if share.count >= 10 else None,
            )
        )
    before = {s: Mean.of(_at(mapped['output'], 1000, s).values('before')) for s in SIGMAS}
    if all(each.count >= 10 for each in before.values()):
        factors = [before[s].value / _PAPER_BEFORE[1000][s] for s in SIGMAS]
        goals.append(
            Goal(
                "Error before mapping, 1,000 paths: ours / the paper's, for the four σ",
                '1/1.5 to 1.5',
                ', '.join(f'{factor:.2f}' for factor in factors),
                all(1.0 / 1.5 <= factor <= 1.5 for factor in factors),
            )
        )
        slope = _growth({s: before[s].value for s in SIGMAS})
        paper = _growth(_PAPER_BEFORE[1000])
        goals.append(
            Goal(
                'Error before mapping: exponent p of its growth σ^p',
                f"about 2 (the paper's: {paper:.2f})",
                f'{slope:.2f}',
                abs(slope - paper) <= 0.3,
            )
        )
    return goals


def _growth(errors: dict[float, float]) -> float:
    slope, _ = np.polyfit(np.log(list(errors)), np.log(list(errors.values())), 1)
    return float(slope)
