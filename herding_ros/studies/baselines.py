# SPDX-License-Identifier: Apache-2.0
"""Simpler controllers: when mapping pays, and when a heuristic is enough."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from herding_ros.report.markdown import table
from herding_ros.report.statistics import Fraction, Mean, significant
from herding_ros.report.style import COLOURS, legend, new, save
import numpy as np

from .experiments.strombom import Strombom
from .runs import PLAIN, run_task, safe, SETTINGS, success, summary, times_of_arrivals
from .study import grid, NOT_IN_PAPER, Options, Results, Row, Section
from .task import Task

TITLE = 'Against simpler controllers'
DESCRIPTION = 'no mapping, the paper, a heuristic (Strömbom et al. 2014), no dogs; by noise'

_SIGMAS = (0.01, 0.02, 0.03, 0.04)
_DOGS = (2, 5)
_POLICIES: dict[str, tuple[str, dict[str, Any]]] = {
    'our default': ('planner', SETTINGS['default']),
    'plain paths': ('planner', PLAIN),
    'without mapping': ('planner', {'mapping.max_iterations': 0}),
    "the paper's setting": ('planner', SETTINGS['paper']),
    'heuristic': ('strombom', {}),
    'no dogs': ('none', {}),
}
_Runs = dict[tuple[str, int, float], Results]
"""Runs by policy, number of dogs and noise."""

_DISTANCES = (0.1, 0.13, 0.16, 0.2, 0.25, 0.3)
"""Values of r_a, the length that scales the heuristic [m]."""


def tasks(options: Options) -> list[Task]:
    """Return runs of every policy on the same flocks under the same noise."""
    quick = options.quick
    sigmas = options.sigma_values(_SIGMAS, (0.02,))
    herds = (2,) if quick else _DOGS
    seeds = options.seed_range(20)
    found = []
    for policy, settings in _POLICIES.values():
        # The flock alone does not depend on the number of dogs that it does not notice.
        for case in grid(sigma=sigmas, dogs=herds[:1] if policy == 'none' else herds, seed=seeds):
            cost = 0.5
            if policy == 'planner':
                cost = 6.0 if case['sigma'] > 0.035 else 4.0 / case['dogs']
            cost *= 0.05 if quick else 1.0
            found.append(run_task(options, cost, policy=policy, settings=settings, **case))
    scanned = [{'sheep_distance': each} for each in (_DISTANCES[:1] if quick else _DISTANCES)]
    return found + [
        run_task(options, 0.5, policy='strombom', **case)
        for case in grid(settings=scanned, dogs=herds, seed=seeds)
    ]


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and the picture."""
    sigmas = results.parameter('sigma')
    herds = [dogs for dogs in _DOGS if len(results.of('herding', dogs=dogs))]
    runs = {
        (name, dogs, sigma): _runs(results, name, dogs, sigma)
        for name, dogs, sigma in product(_POLICIES, _DOGS, sigmas)
    }
    _draw_success(runs, herds, sigmas, figures)
    values = {
        'seeds': results.seeds,
        'tables': '\n\n'.join(_table(runs, dogs, sigmas) for dogs in herds),
        'paired': _paired_table(runs, herds, sigmas),
        'length': f'{Strombom.sheep_distance:g}',
        'scan': _scan_table(results, herds),
    }
    return Section(values, _rows(runs, herds, sigmas))


def _runs(results: Results, name: str, dogs: int, sigma: float) -> Results:
    policy, settings = _POLICIES[name]
    found = results.of('herding', policy=policy, settings=settings, sigma=sigma)
    return found if policy == 'none' else found.of('herding', dogs=dogs)


def _table(runs: _Runs, dogs: int, sigmas: list[float]) -> str:
    found = table(
        {
            'σ': f'{sigma:g}',
            'policy': name,
            **summary(here),
            'together': Fraction.of(here.values('arrived')),
            'compute [ms/s]': Mean.of([1e3 * run['policy_cpu'] / run['duration'] for run in here]),
        }
        for sigma, name in product(sigmas, _POLICIES)
        if len(here := runs[name, dogs, sigma])
    )
    return f'### {dogs} dogs\n\n{found}'


def _draw_success(runs: _Runs, herds: list[int], sigmas: list[float], figures: Path) -> None:
    figure, axes = new(2, max(len(herds), 1), width=4.5, height=2.8)
    for (left, right), dogs in zip(axes, herds, strict=False):
        for k, (colour, name) in enumerate(zip(COLOURS, _POLICIES, strict=False)):
            there = [sigma for sigma in sigmas if len(runs[name, dogs, sigma])]
            offset = 0.0004 * (k - 2)
            fractions = [success(runs[name, dogs, sigma]) for sigma in there]
            values = [each.value for each in fractions]
            below = [each.value - each.low for each in fractions]
            above = [each.high - each.value for each in fractions]
            left.errorbar(
                np.add(there, offset), values, [below, above], color=colour, marker='o',
                markersize=4, capsize=2, linewidth=1.0, label=name,
            )  # fmt: skip
            for sigma in there:
                arrived = times_of_arrivals(runs[name, dogs, sigma])
                at = np.full(len(arrived), sigma + offset)
                right.plot(at, arrived, '.', color=colour, alpha=0.6)
        left.set(xlabel='σ', ylabel='safe arrivals', ylim=(-0.03, 1.03), xlim=(0.005, 0.045))
        right.set(xlabel='σ', ylabel='time of arrival [s]', ylim=(0.0, None), xlim=(0.005, 0.045))
        left.set_title(f'{dogs} dogs', fontsize=9)
    legend(axes[0, 0])
    save(figure, figures / 'baselines.png')


def _paired_table(runs: _Runs, herds: list[int], sigmas: list[float]) -> str:
    rows = []
    for dogs, sigma in product(herds, sigmas):
        ours, plain = (
            runs[name, dogs, sigma].by_seed() for name in ('our default', 'without mapping')
        )
        pairs = [(ours[seed], plain[seed]) for seed in sorted(ours.keys() & plain.keys())]
        if not pairs:
            continue
        both = [(a, b) for a, b in pairs if safe(a) and safe(b)]
        ratios = [a['plans']['error_ratio'] for a, _ in pairs]
        rows.append(
            {
                'dogs': dogs,
                'σ': f'{sigma:g}',
                'safe only with mapping': sum(safe(a) and not safe(b) for a, b in pairs),
                'safe only without': sum(safe(b) and not safe(a) for a, b in pairs),
                'time with − without [s] (seeds)': (
                    f'{Mean.of([a["time"] - b["time"] for a, b in both])} ({len(both)})'
                ),
                'largest spread with − without [m]': Mean.of(
                    [a['max_spread'] - b['max_spread'] for a, b in pairs]
                ),
                'planning error after / before, corrected windows': Mean.of(
                    [ratio for ratio in ratios if ratio is not None]
                ),
            }
        )
    return table(rows)


def _scan_table(results: Results, herds: list[int]) -> str:
    return table(
        {'dogs': dogs, 'r_a [m]': significant(distance, 2), **summary(found)}
        for dogs, distance in product(herds, _DISTANCES)
        if len(found := results.of('herding', dogs=dogs, settings={'sheep_distance': distance}))
    )


def _rows(runs: _Runs, herds: list[int], sigmas: list[float]) -> list[Row]:
    rows = []
    for dogs, sigma in product(herds, sigmas):
        ours, *others = (
            (name, success(runs[name, dogs, sigma]))
            for name in _POLICIES
            if name == 'our default' or len(runs[name, dogs, sigma])
        )
        if ours[1].count:
            what = f'Baselines, {dogs} dogs, σ = {sigma:g}: safe arrivals'
            remark = '; '.join(f'{name} {fraction}' for name, fraction in others)
            rows.append(Row(what, NOT_IN_PAPER, ours[1], remark))
    return rows
