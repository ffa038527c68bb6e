# SPDX-License-Identifier: Apache-2.0
"""Mapping and feedback when sheep have part of their random force in common."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from herding_ros.control.parameters import Mapping, PAPER
from herding_ros.report.markdown import table
from herding_ros.report.statistics import Mean
from herding_ros.report.style import BLUE, COLOURS, GREY, legend, new, save
import numpy as np

from .runs import median_time, PLAIN, run_task, settings_of, success
from .study import grid, NOT_IN_PAPER, Options, Results, Row, Section
from .task import Task

TITLE = 'Noise that all sheep have in common (remark in section 2.1)'
DESCRIPTION = 'mapping and herding under individual and common noise, and mixtures of both'

SHARES = (0.0, 0.25, 0.5, 1.0)
"""Share of the noise's variance that all sheep have in common."""
_SIGMA = 0.03
_RUN_SIGMAS = (0.01, 0.02)
_PLANS = {
    'mapped, multilevel': {},
    'mapped, plain paths': PLAIN,
    'not mapped': {**PLAIN, 'mapping.max_iterations': 0},
}
"""Settings of the controller in whole runs."""


def _control(estimator: str) -> dict[str, Any]:
    """Settings of the paper's window with our mapping, four iterations in any case."""
    mapping = Mapping('output', estimator, 0.0, max_iterations=4, tolerance=0.0)
    return settings_of(replace(PAPER, mapping=mapping))


_CONTROLS = {estimator: _control(estimator) for estimator in ('plain', 'multilevel')}


def tasks(options: Options) -> list[Task]:
    """Return the same windows under every share, mapped with few and many paths, and runs."""
    quick = options.quick
    few = options.path_number(100)
    herd = {'sheep': 6 if quick else 30, 'dogs': 2 if quick else 5, 'sigma': _SIGMA}
    found = []
    for case in grid(
        control=list(_CONTROLS.values()),
        paths=(few,) if quick else (few, 10 * few),
        common_noise=SHARES,
        seed=options.seed_range(10),
    ):
        drawn = case['control'] == _CONTROLS['plain'] and case['paths'] == few
        extreme = case['common_noise'] in (SHARES[0], SHARES[-1])
        parameters = {
            **herd,
            **case,
            'judge_paths': 16 if quick else 400,
            'trace': case['seed'] == 0 and drawn and extreme,
        }
        cost = 0.1 if quick else 2.5 + 0.0016 * case['paths']
        found.append(Task('common_noise', parameters, cost))
    cases = grid(
        settings=list(_PLANS.values()),
        sigma=_RUN_SIGMAS[:1] if quick else _RUN_SIGMAS,
        common_noise=(SHARES[0], SHARES[-1]),
        seed=options.seed_range(10),
    )
    limit, cost = (10.0, 0.1) if quick else (300.0, 1.5)
    return found + [run_task(options, cost, dogs=5, time_limit=limit, **case) for case in cases]


_Windows = dict[tuple[str, float], Results]
"""Windows by the words for their paths and the share in common."""


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and the picture."""
    every = results.of('common_noise')
    windows = {
        (f'{paths:,} {estimator}', share): found
        for (estimator, control), paths, share in product(
            _CONTROLS.items(), every.parameter('paths'), SHARES
        )
        if len(found := every.of('common_noise', control=control, paths=paths, common_noise=share))
    }
    _draw_errors_and_centres(every, windows, figures)
    values = {
        'seeds': results.seeds,
        'judge_paths': ', '.join(f'{paths:,}' for paths in every.parameter('judge_paths')),
        'table': table(_row(*key, found) for key, found in windows.items()),
        'runs': _runs_table(results),
    }
    rows = [
        Row(
            f'Common noise, share {share:g}, {words} paths: error after mapping',
            NOT_IN_PAPER,
            found.mean('judged_after'),
            f'on unseen noise, after / before {found.ratio("judged_after", "judged_before")}',
        )
        for (words, share), found in windows.items()
    ]
    return Section(values, rows)


def _row(words: str, share: float, found: Results) -> dict[str, object]:
    paths = found.parameter('paths')[0]
    return {
        'paths': words,
        'share in common': f'{share:g}',
        'before, seen': found.mean('before'),
        'after, seen': found.mean('after'),
        'before, unseen': found.mean('judged_before'),
        'after, unseen': found.mean('judged_after'),
        'after / before, unseen': found.ratio('judged_after', 'judged_before'),
        'error of the plain mean of so many': Mean.of(
            [each['wander'] / paths**0.5 for each in found]
        ),
        'a single path': found.mean('wander'),
    }


def _runs_table(results: Results) -> str:
    return table(
        {
            'σ': f'{sigma:g}',
            'share in common': f'{share:g}',
            'plans': words,
            'safe arrivals': success(found),
            'median time [s]': median_time(found),
            'largest spread, mean [m]': found.mean('max_spread'),
        }
        for sigma, share, (words, settings) in product(_RUN_SIGMAS, SHARES, _PLANS.items())
        if len(found := results.of('herding', settings=settings, sigma=sigma, common_noise=share))
    )


def _draw_errors_and_centres(every: Results, windows: _Windows, figures: Path) -> None:
    figure, ((errors, *places),) = new(3, 1, width=4.0, height=3.2)
    kinds = list(dict.fromkeys(words for words, _ in windows))
    for colour, words in zip(COLOURS, kinds, strict=False):
        found = [windows.get((words, share), Results([])) for share in SHARES]
        if words == kinds[0]:
            _draw_errors(
                errors, found, 'judged_before', color=GREY, linestyle='--', label='before'
            )
        _draw_errors(errors, found, 'judged_after', color=colour, label=f'after, {words}')
    errors.set(xlabel='share in common', ylabel='error on unseen noise [m s$^{0.5}$]')
    errors.set(ylim=(0, None))
    for place, share in zip(places, (SHARES[0], SHARES[-1]), strict=True):
        place.set_title(f'share in common {share:g}', fontsize=9)
        drawn = every.of('common_noise', common_noise=share, trace=True)
        for trace in drawn.values('trace'):
            for single in trace['singles']:
                place.plot(*np.transpose(single), color=BLUE, linewidth=0.7, alpha=0.5)
            place.plot(*np.transpose(trace['target']), color='black', linestyle='--')
        place.set(xlabel='x [m]', ylabel='y [m]')
        place.set_aspect('equal', adjustable='datalim')
    legend(errors)
    save(figure, figures / 'common_noise.png')


def _draw_errors(axes: Any, found: list[Results], key: str, **style: Any) -> None:
    means = [each.mean(key) for each in found]
    axes.errorbar(SHARES, [mean.value for mean in means], [mean.error for mean in means], **style)
