"""Monte Carlo that spends no more than it must: cost of an expected centre by estimator."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from .experiments.sampling import COMPARED
from .markdown import table
from .pictures import COLOURS, new, save
from .statistics import Mean, significant
from .study import Goal, Options, Results, Row, Section
from .task import Task

DESCRIPTION = 'variance per cost of Monte Carlo estimators of the expected centre'

_SIGMAS = (0.01, 0.02, 0.03, 0.04)
_STANDARD_ERROR = 1e-3
_SHOWN = 0.03
_OURS = 'multilevel'
_GOAL = 5.0
_COSTS = {
    'first': 'CPU time, first evaluation',
    'again': 'CPU time, later',
    'work': 'weighted path-steps',
}
_WORDS = {
    'plain': 'plain',
    'antithetic': 'antithetic pairs',
    'free': 'control variate: centre of free sheep',
    'two steps': 'levels: time step 0.1, 0.05 s',
    'three steps': 'levels: time step 0.2, 0.1, 0.05 s',
    'halves': 'levels: sheep alone, half flocks, flock',
    'single': 'levels: sheep alone, flock',
    'multilevel': 'the same in antithetic pairs (default)',
}


def tasks(options: Options) -> list[Task]:
    """Return flocks under every noise; all estimators of one run in the same process."""
    quick = options.quick
    herd = {'sheep': 6, 'dogs': 2} if quick else {'sheep': 30, 'dogs': 5}
    return [
        Task(
            'sampling',
            {
                **herd,
                'sigma': sigma,
                'seed': seed,
                'standard_error': 20.0 * _STANDARD_ERROR if quick else _STANDARD_ERROR,
            },
            cost=0.2 if quick else 1e4 * sigma**2,
        )
        for sigma in ((_SHOWN,) if quick else _SIGMAS)
        for seed in options.seed_range(5)
    ]


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and the picture."""
    sigmas = results.parameter('sigma')
    values = {
        'seeds': str(len(results.parameter('seed'))),
        'shown': f'{_SHOWN:g}',
        'costs': _cost_table(results.of('sampling', sigma=_SHOWN)),
        'gains': _gain_table(results, sigmas),
        'picture': _figure(results, sigmas, figures),
    }
    found = results.of('sampling', sigma=_SHOWN)
    rows, goals = [], []
    for cost, words in _COSTS.items():
        gain = _gain(found, _OURS, cost)
        what = f'σ = {_SHOWN:g}: cost of the expected centre, plain / ours, in {words}'
        rows.append(Row(what, 'not in the paper', f'{gain}', 'at equal standard error'))
        reached = None if math.isnan(gain.value) else gain.value >= _GOAL
        goals.append(Goal(what, f'≥ {_GOAL:g}', f'{gain}', reached))
    return Section(values, rows, goals)


def _product(found: Results, name: str, cost: str) -> list[float]:
    """Return variance times cost, which does not depend on the number of paths."""
    return [each[name]['standard_error'] ** 2 * each[name][cost] for each in found]


def _gain(found: Results, name: str, cost: str) -> Mean:
    """Return what plain Monte Carlo costs over what this costs, at the same standard error."""
    plain, ours = _product(found, 'plain', cost), _product(found, name, cost)
    return Mean.of([a / b for a, b in zip(plain, ours, strict=True)])


def _off(found: Results, name: str) -> str:
    """Return the distance from plain in standard errors of the difference, over all flocks."""
    squares = [
        each[name]['off'] ** 2
        / (each[name]['standard_error'] ** 2 + each['plain']['standard_error'] ** 2)
        for each in found
    ]
    return '' if name == 'plain' else significant(math.sqrt(float(np.mean(squares))), 2)


def _cost_table(found: Results) -> str:
    rows = []
    for name in COMPARED if len(found) else ():
        paths = np.mean(found.values(name, 'paths'), axis=0)
        rows.append(
            (
                _WORDS[name],
                significant(1e3 * float(np.mean(found.values(name, 'standard_error'))), 2),
                ' + '.join(f'{n:.0f}' for n in paths),
                significant(float(np.mean(found.values(name, 'work')))),
                significant(1e3 * float(np.mean(found.values(name, 'first')))),
                significant(1e3 * float(np.mean(found.values(name, 'again')))),
                _off(found, name),
            )
        )
    head = (
        'estimator', 'standard error reached [mm]', 'paths by level', 'work [paths]',
        'CPU, first [ms]', 'CPU, later [ms]', 'from plain [standard errors]',
    )  # fmt: skip
    return table(head, rows)


def _gain_table(results: Results, sigmas: list[float]) -> str:
    rows = [
        (
            _WORDS[name],
            *(str(_gain(results.of('sampling', sigma=sigma), name, 'first')) for sigma in sigmas),
            *(str(_gain(results.of('sampling', sigma=sigma), name, 'work')) for sigma in sigmas),
        )
        for name in COMPARED
        if name != 'plain' and sigmas
    ]
    head = [f'CPU, σ = {sigma:g}' for sigma in sigmas] + [f'work, {sigma:g}' for sigma in sigmas]
    return table(('plain / estimator', *head), rows)


def _figure(results: Results, sigmas: list[float], figures: Path) -> str:
    figure, axes = new(2, 1, width=4.8, height=3.8)
    left, right = axes[0]
    found = results.of('sampling', sigma=_SHOWN)
    times = np.array([1e-2, 1e1])
    styles = [(COLOURS[k % len(COLOURS)], '-' if k < len(COLOURS) else '--') for k in range(9)]
    for (name, words), (colour, style) in zip(_WORDS.items(), styles, strict=True):
        if len(found):
            product = float(np.mean(_product(found, name, 'first')))
            left.plot(times, np.sqrt(product / times), style, color=colour, label=words)
            reached = np.array(found.values(name, 'standard_error'))
            left.plot(found.values(name, 'first'), reached, '.', color=colour)
        gains = [_gain(results.of('sampling', sigma=s), name, 'first').value for s in sigmas]
        right.plot(sigmas, gains, style, marker='.', color=colour, label=words)
    left.set(
        xscale='log', yscale='log', xlabel='CPU time of the first evaluation [s]',
        ylabel='standard error [m]',
    )  # fmt: skip
    left.set_title(f'σ = {_SHOWN:g}', fontsize=9)
    right.set(yscale='log', xlabel='σ [m/s^1.5]', ylabel='plain / estimator, CPU time')
    handles, labels = right.get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=7, loc='outside right center', frameon=False)
    return save(figure, figures / 'sampling.png')
