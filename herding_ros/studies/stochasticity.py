# SPDX-License-Identifier: Apache-2.0
"""Table 1 and Figure "compare iterations": how noise spoils a plan, and what mapping repairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from herding_ros.control.parameters import Mapping, PAPER
from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Mean, significant
from herding_ros.report.style import COLOURS, legend, new, save
import numpy as np

from .direct_comparison import comparison, cost_shares, draw_costs, Pair, SENSITIVITY, shares
from .runs import settings_of
from .study import grid, Options, Results, Row, Section, tasks_of
from .task import Task

TITLE = 'Influence of the noise (Table 1, Figure "compare iterations")'
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
    'output': replace(PAPER.mapping, method='output', max_iterations=_ITERATIONS, tolerance=0.0),
    'aggressive': replace(PAPER.mapping, max_iterations=_ITERATIONS, residual=0.0),
    'paper': PAPER.mapping,
    'multilevel': Mapping('output', max_iterations=_ITERATIONS, tolerance=0.0),
}
"""Our mapping and the paper's with four iterations in any case; the paper's stopping rule.

All see plain paths as the paper's does, except the last.
"""
_CONTROLS = {
    name: settings_of(replace(PAPER, mapping=mapping)) for name, mapping in _MAPPINGS.items()
}
_WORDS = {
    'output': 'output mapping, 4 iterations',
    'aggressive': 'aggressive mapping, 4 iterations',
    'paper': "aggressive mapping, the paper's stopping rule",
    'multilevel': 'output mapping, 4 iterations, multilevel Monte Carlo',
}
_VARIANT_SIGMA = 0.03
_SWITCHES: dict[str, Sequence[Any]] = {
    'optimiser': ('spg', 'ncg'),
    'observable': ('centre', 'individuals'),
    'common_numbers': (True, False),
    'broyden': (True, False),
}
"""What can be exchanged in Algorithm 1."""


def tasks(options: Options) -> list[Task]:
    """Return windows mapped by the controller, by variants of Algorithm 1, and directly."""
    seeds, quick = options.seed_range(10), options.quick
    paths = options.path_number(100)
    sigmas = options.sigma_values(SIGMAS, SIGMAS[1:3])
    common = {
        'sheep': 6 if quick else 30,
        'dogs': 2 if quick else 5,
        'judge_paths': 16 if quick else 1000,
    }
    cases = list(grid(sigma=sigmas, seed=seeds))
    directs = tasks_of(
        'direct', 0.05 if quick else 0.33 * paths, cases, **common,
        paths=paths, iterations=4 if quick else 100, control=_CONTROLS['output'],
    )  # fmt: skip
    windows = [
        task
        for (name, control), number in product(
            _CONTROLS.items(), (paths,) if quick else (paths, 10 * paths)
        )
        for task in tasks_of(
            'window', 0.1 if quick else 2.3 + 0.0016 * number, cases, **common,
            paths=number, control=control, trace=name == 'output' and number == paths,
        )
    ]  # fmt: skip
    variants = tasks_of(
        'variant', 0.2 if quick else 3.5,
        grid(
            **(_SWITCHES | {'observable': ('centre',)} if quick else _SWITCHES),
            sigma=(_VARIANT_SIGMA,),
            seed=seeds[:1] if quick else seeds,
        ),
        **common, paths=paths, iterations=1 if quick else _ITERATIONS,
        control=_CONTROLS['paper'],
    )  # fmt: skip
    return directs + windows + variants


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and figures."""
    windows = results.of('window')
    numbers, sigmas = windows.parameter('paths'), windows.parameter('sigma')
    few = numbers[0] if numbers else 100
    pairs = {sigma: _pairs(results, few, sigma) for sigma in sigmas}
    aggressive = {sigma: list(_mapped(results, 'aggressive', few, sigma)) for sigma in sigmas}
    _draw_centres(windows.of('window', control=_CONTROLS['output']), figures)
    draw_costs(pairs, aggressive, few, figures / 'stochasticity-cost.png')
    values = {
        'seeds': results.seeds,
        'paths': str(few),
        'judge_paths': ', '.join(f'{paths:,}' for paths in windows.parameter('judge_paths')),
        'floors': ', '.join(
            significant(windows.of('window', paths=few, sigma=s).mean('uncertainty').value, 2)
            for s in sigmas
        ),
        'main_table': table(
            row for paths in numbers for row in _main_rows(results, paths, sigmas)
        ),
        'sensitivity': str(SENSITIVITY),
        'direct_table': comparison(pairs, few),
        'variants': _variant_table(results, few),
    }
    return Section(values, _rows(results, numbers, sigmas), _goals(results))


def _mapped(results: Results, name: str, paths: int, sigma: float) -> Results:
    """Return the windows of one mapping."""
    return results.of('window', control=_CONTROLS[name], paths=paths, sigma=sigma)


def _pairs(results: Results, paths: int, sigma: float) -> list[Pair]:
    directs = results.of('direct', sigma=sigma, paths=paths).by_seed()
    windows = _mapped(results, 'output', paths, sigma).by_seed()
    return [(window, directs[seed]) for seed, window in windows.items() if seed in directs]


def _main_rows(results: Results, paths: int, sigmas: Sequence[float]) -> list[dict[str, object]]:
    """Return the rows of Table 1 for a number of paths, the paper's among ours."""

    def line(mapping: str, quantity: str, cells: dict[float, Any]) -> dict[str, object]:
        found = {f'σ = {sigma:g}': cells.get(sigma, 'none') for sigma in sigmas}
        return {'mapping': mapping, 'quantity': quantity, **found}

    every = {name: {s: _mapped(results, name, paths, s) for s in sigmas} for name in _WORDS}
    # The deterministic control is the same for every mapping.
    unmapped = next(found for found in every.values() if any(map(len, found.values())))
    rows = [
        line(
            f'**{paths} paths**',
            'before, seen',
            {s: each.mean('before') for s, each in unmapped.items()},
        ),
        line('', '*the paper*', _PAPER_BEFORE.get(paths, {})),
        line('', 'before, unseen', {s: e.mean('judged_before') for s, e in unmapped.items()}),
    ]
    quantities: dict[str, Callable[[Results], Mean]] = {
        'iterations': lambda each: each.mean('iterations'),
        'residual': lambda each: each.mean('residual'),
        'after, seen': lambda each: each.mean('after'),
        'after, unseen': lambda each: each.mean('judged_after'),
        'after / before, seen': lambda each: each.ratio('after', 'before'),
        'after / before, unseen': lambda each: each.ratio('judged_after', 'judged_before'),
    }
    for name, words in _WORDS.items():
        for k, (quantity, of) in enumerate(quantities.items()):
            cells = {sigma: of(found) for sigma, found in every[name].items()}
            rows.append(line('' if k else words, quantity, cells))
    return [
        *rows,
        line('*the paper*', 'iterations', _PAPER_ITERATIONS),
        line('', 'after', _PAPER_AFTER.get(paths, {})),
    ]


def _printed(value: float | None) -> str:
    return 'none' if value is None else significant(value)


def _draw_centres(mapped: Results, figures: Path) -> None:
    """Draw the centres, and their distance from the plan, for the flock with seed 0."""
    figure, axes = new(2, 2, width=5.0, height=2.8)
    traced = mapped.of('window', seed=0, trace=True)
    traces = {task.parameters['sigma']: result['trace'] for task, result in traced.entries}
    for (where, away), key in zip(axes, ('before', 'after'), strict=True):
        for colour, (sigma, trace) in zip(COLOURS, traces.items(), strict=False):
            found, target = np.array(trace[key]), np.array(trace['target'])
            where.plot(*found.T, color=colour)
            deviation = 1e3 * np.linalg.norm(found - target, axis=1)
            away.plot(0.5 * np.arange(len(found)), deviation, color=colour, label=f'σ = {sigma:g}')
        for trace in list(traces.values())[:1]:
            target = np.array(trace['target'])
            where.plot(*target.T, color='black', linestyle='--', linewidth=0.8)
            where.plot(*target[0], 'x', color='black')
        legend(away)
        where.set(xlabel='x [m]', ylabel='y [m]')
        where.set_aspect('equal', adjustable='datalim')
        where.set_title(f'{key} mapping', fontsize=9)
        away.set(xlabel='time [s]', ylabel='|X̄ − x̄_c| [mm]', ylim=(0.0, None))
        away.sharey(axes[0, 1])
    save(figure, figures / 'stochasticity-centres.png')


def _variant_table(results: Results, paths: int) -> str:
    """Return the table of variants: every combination of the four switches."""
    variants = results.of('variant')
    last, chosen = (
        f'{words}, σ = {_VARIANT_SIGMA:g}' for words in ('last, seen', 'chosen, unseen')
    )
    calls = 'values and gradients in extraction'
    # The deterministic control is the same for every mapping: once for each flock.
    windows = results.of('window', paths=paths, sigma=_VARIANT_SIGMA).by_seed().values()
    rows: list[dict[str, object]] = [
        {
            'extraction': 'none: the deterministic control',
            'observable': '',
            'noise': '',
            'matrix': '',
            last: Mean.of([each['before'] for each in windows]),
            chosen: Mean.of([each['judged_before'] for each in windows]),
            calls: '',
        }
    ]
    for case in grid(**_SWITCHES):
        found = variants.of('variant', **case)
        rows.append(
            {
                'extraction': case['optimiser'].upper(),
                'observable': case['observable'],
                'noise': 'common' if case['common_numbers'] else 'new each time',
                'matrix': 'Broyden' if case['broyden'] else 'B = I',
                last: Mean.of([each['misfits'][-1] for each in found]),
                chosen: found.mean('judged', 'error'),
                calls: found.mean('calls', 'extraction'),
            }
        )
    return table(rows)


def _rows(results: Results, numbers: Sequence[int], sigmas: Sequence[float]) -> list[Row]:
    rows = []
    if len(results.of('window', control=_CONTROLS['output'])):
        what = 'Figure "compare iterations": centres before and after mapping'
        rows.append(Row(what, 'a picture', 'a picture, below'))
    for paths, sigma in product(numbers, sigmas):
        found = _mapped(results, 'output', paths, sigma)
        if not len(found):
            continue
        name = f'Table 1, {paths} paths, σ = {sigma:g}'
        before, after = (each.get(paths, {}).get(sigma) for each in (_PAPER_BEFORE, _PAPER_AFTER))
        unseen = found.ratio('judged_after', 'judged_before')
        remark = f'after / before {found.ratio("after", "before")}, on unseen noise {unseen}'
        rows += [
            Row(
                f'{name}: error of the deterministic control',
                _printed(before),
                found.mean('before'),
            ),
            Row(f'{name}: error after mapping', _printed(after), found.mean('after'), remark),
        ]
    return rows


def _goals(results: Results) -> list[Goal]:
    goals = []
    for sigma, bound in _RATIO_GOALS.items():
        ratio = _mapped(results, 'output', 100, sigma).ratio('after', 'before')
        what = f'σ = {sigma:g}: error after / before mapping, at most 4 iterations'
        reached = ratio.value <= bound if ratio.count >= 10 else None
        goals.append(Goal(what, f'≤ {bound}', ratio, reached))
    for sigma in SIGMAS[:3]:
        pairs = _pairs(results, 100, sigma)
        share, cost = shares(pairs), cost_shares(pairs, 100)
        what = f"σ = {sigma:g}: share of direct optimisation's error reduction; of its cost"
        reached = share.value >= 0.9 and cost.value <= 0.2 if share.count >= 10 else None
        goals.append(Goal(what, '≥ 0.9; ≤ 0.2', f'{share}; {cost}', reached))
    before = {s: _mapped(results, 'output', 1000, s).mean('before') for s in SIGMAS}
    if all(each.count >= 10 for each in before.values()):
        factors = [before[s].value / _PAPER_BEFORE[1000][s] for s in SIGMAS]
        what = "Error before mapping, 1,000 paths: ours / the paper's, for the four σ"
        measured = ', '.join(f'{factor:.2f}' for factor in factors)
        reached = all(1.0 / 1.5 <= factor <= 1.5 for factor in factors)
        goals.append(Goal(what, '1/1.5 to 1.5', measured, reached))
        slope = _growth({s: before[s].value for s in SIGMAS})
        paper = _growth(_PAPER_BEFORE[1000])
        what = 'Error before mapping: exponent p of its growth σ^p'
        about = f"about 2 (the paper's: {paper:.2f})"
        goals.append(Goal(what, about, f'{slope:.2f}', abs(slope - paper) <= 0.3))
    return goals


def _growth(errors: dict[float, float]) -> float:
    slope, _ = np.polyfit(np.log(list(errors)), np.log(list(errors.values())), 1)
    return float(slope)
