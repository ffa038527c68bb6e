# SPDX-License-Identifier: Apache-2.0
"""Cost of an expected centre by Monte Carlo estimator."""

from __future__ import annotations

import math
from pathlib import Path

from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Mean, significant
from herding_ros.report.style import COLOURS, new, save
import numpy as np

from .experiments.sampling import COMPARED
from .study import grid, NOT_IN_PAPER, Options, Results, Row, Section
from .task import Task

TITLE = 'Cost of an expectation'
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
    common = {
        'sheep': 6 if quick else 30,
        'dogs': 2 if quick else 5,
        'standard_error': 20.0 * _STANDARD_ERROR if quick else _STANDARD_ERROR,
    }
    return [
        Task('sampling', {**common, **case}, 0.2 if quick else 1e4 * case['sigma'] ** 2)
        for case in grid(
            sigma=options.sigma_values(_SIGMAS, (_SHOWN,)), seed=options.seed_range(5)
        )
    ]


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and the picture."""
    sigmas = results.parameter('sigma')
    found = results.of('sampling', sigma=_SHOWN)
    _draw_errors_and_gains(results, sigmas, figures)
    values = {
        'seeds': results.seeds,
        'shown': f'{_SHOWN:g}',
        'costs': table(_costs(found, name) for name in COMPARED if len(found)),
        'gains': _gain_table(results, sigmas),
    }
    rows, goals = [], []
    for cost, words in _COSTS.items():
        gain = _gain(found, _OURS, cost)
        what = f'σ = {_SHOWN:g}: cost of the expected centre, plain / ours, in {words}'
        rows.append(Row(what, NOT_IN_PAPER, gain, 'at equal standard error'))
        reached = None if math.isnan(gain.value) else gain.value >= _GOAL
        goals.append(Goal(what, f'≥ {_GOAL:g}', gain, reached))
    return Section(values, rows, goals)


def _product(found: Results, name: str, cost: str) -> list[float]:
    """Return variance times cost, which does not depend on the number of paths."""
    return [each[name]['standard_error'] ** 2 * each[name][cost] for each in found]


def _gain(found: Results, name: str, cost: str) -> Mean:
    """Return the cost of plain Monte Carlo over that of this estimator, at equal error."""
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


def _costs(found: Results, name: str) -> dict[str, object]:
    """Return an estimator's row in the table of costs."""
    error, work, first, again = (
        float(np.mean(found.values(name, each)))
        for each in ('standard_error', 'work', 'first', 'again')
    )
    paths = np.mean(found.values(name, 'paths'), axis=0)
    return {
        'estimator': _WORDS[name],
        'standard error reached [mm]': significant(1e3 * error, 2),
        'paths by level': ' + '.join(f'{n:.0f}' for n in paths),
        'work [paths]': work,
        'CPU, first [ms]': 1e3 * first,
        'CPU, later [ms]': 1e3 * again,
        'from plain [standard errors]': _off(found, name),
    }


def _gain_table(results: Results, sigmas: list[float]) -> str:
    here = {sigma: results.of('sampling', sigma=sigma) for sigma in sigmas}
    return table(
        {
            'plain / estimator': _WORDS[name],
            **{f'CPU, σ = {s:g}': _gain(found, name, 'first') for s, found in here.items()},
            **{f'work, {s:g}': _gain(found, name, 'work') for s, found in here.items()},
        }
        for name in COMPARED
        if name != 'plain' and sigmas
    )


def _draw_errors_and_gains(results: Results, sigmas: list[float], figures: Path) -> None:
    figure, ((left, right),) = new(2, 1, width=4.8, height=3.8)
    found = results.of('sampling', sigma=_SHOWN)
    times = np.array([1e-2, 1e1])
    many = range(len(_WORDS))
    styles = [(COLOURS[k % len(COLOURS)], '-' if k < len(COLOURS) else '--') for k in many]
    for (name, words), (colour, style) in zip(_WORDS.items(), styles, strict=True):
        if len(found):
            product = float(np.mean(_product(found, name, 'first')))
            left.plot(times, np.sqrt(product / times), style, color=colour, label=words)
            reached = np.array(found.values(name, 'standard_error'))
            left.plot(found.values(name, 'first'), reached, '.', color=colour)
        gains = [_gain(results.of('sampling', sigma=s), name, 'first').value for s in sigmas]
        right.plot(sigmas, gains, style, marker='.', color=colour, label=words)
    left.set(xscale='log', yscale='log', xlabel='CPU time of the first evaluation [s]')
    left.set(ylabel='standard error [m]')
    left.set_title(f'σ = {_SHOWN:g}', fontsize=9)
    right.set(yscale='log', xlabel='σ [m/s^1.5]', ylabel='plain / estimator, CPU time')
    handles, labels = right.get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=7, loc='outside right center', frameon=False)
    save(figure, figures / 'sampling.png')
