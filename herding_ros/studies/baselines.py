"""Against simpler controllers: when mapping pays, and when a heuristic is enough."""

from __future__ import annotations

from itertools import product
import math
from pathlib import Path
from typing import Any

import numpy as np

from .experiments.strombom import Strombom
from .markdown import table
from .pictures import COLOURS, new, save
from .runs import (
    paths_of,
    PLAIN,
    run_task,
    safe,
    SETTINGS,
    success,
    SUMMARY,
    summary,
    times,
    under,
    with_mapping,
)
from .statistics import Fraction, Mean, significant
from .study import Options, Results, Row, Section
from .task import Task

DESCRIPTION = 'no mapping, the paper, a heuristic (Strömbom et al. 2014), no dogs; by noise'

_SIGMAS = (0.01, 0.02, 0.03, 0.04)
_DOGS = (2, 5)
_GOAL = [0.5, 0.5]
_LIMIT = 400.0
_POLICIES: dict[str, tuple[str, dict[str, Any]]] = {
    'our default': ('planner', SETTINGS['default']),
    'plain paths': ('planner', PLAIN),
    'without mapping': ('planner', with_mapping(SETTINGS['default'], max_iterations=0)),
    "the paper's setting": ('planner', SETTINGS['paper']),
    'heuristic': ('strombom', {}),
    'no dogs': ('none', {}),
}
_Runs = dict[tuple[str, int, float], Results]

_DISTANCES = (0.1, 0.13, 0.16, 0.2, 0.25, 0.3)
"""Values of r_a, the length that scales the heuristic [m]."""
_SCANNED_SIGMA = 0.01


def tasks(options: Options) -> list[Task]:
    """Return runs of every policy on the same flocks under the same noise."""
    quick = options.quick
    seeds, limit = options.seed_range(20), 10.0 if quick else _LIMIT
    sheep = 6 if quick else 20
    sigmas, herds = ((0.02,), (2,)) if quick else (_SIGMAS, _DOGS)
    found = []
    for (policy, settings), sigma, dogs, seed in product(_POLICIES.values(), sigmas, herds, seeds):
        # The flock alone does not care how many dogs it does not notice.
        if policy == 'none' and dogs != herds[0]:
            continue
        if policy == 'planner' and settings.get('mapping', {}).get('max_iterations') != 0:
            settings = paths_of(settings, options.path_number(100))
        cost = (6.0 if sigma > 0.035 else 4.0 / dogs) if policy == 'planner' else 0.5
        found.append(
            run_task(
                policy, settings, dogs, sigma, _GOAL, seed, limit,
                cost=0.05 * cost if quick else cost, sheep=sheep,
            )
        )  # fmt: skip
    for distance, dogs, seed in product(_DISTANCES[:1] if quick else _DISTANCES, herds, seeds):
        settings = {'sheep_distance': distance}
        found.append(
            run_task('strombom', settings, dogs, _SCANNED_SIGMA, _GOAL, seed, limit, 0.5, sheep)
        )
    return found


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and the picture."""
    sigmas = results.parameter('sigma')
    herds = [dogs for dogs in _DOGS if len(results.of('herding', dogs=dogs))]
    runs = {
        (name, dogs, sigma): _runs(results, name, dogs, sigma)
        for name in _POLICIES
        for dogs in _DOGS
        for sigma in _SIGMAS
    }
    values = {
        'seeds': str(len(results.parameter('seed'))),
        'tables': '\n\n'.join(_table(runs, dogs, sigmas) for dogs in herds),
        'picture': _figure(runs, herds, figures),
        'paired': _paired_table(runs, herds, sigmas),
        'length': f'{Strombom.sheep_distance:g}',
        'scan': _scan_table(results, herds),
    }
    return Section(values, _rows(runs, herds, sigmas))


def _table(runs: _Runs, dogs: int, sigmas: list[float]) -> str:
    rows = []
    for sigma, name in product(sigmas, _POLICIES):
        found = runs[name, dogs, sigma]
        if len(found):
            together = Fraction.of(found.values('arrived'))
            cpu = Mean.of([1e3 * run['policy_cpu'] / run['duration'] for run in found])
            rows.append((f'{sigma:g}', name, *summary(found), str(together), str(cpu)))
    head = ('σ', 'policy', *SUMMARY, 'together', 'compute [ms/s]')
    return f'### {dogs} dogs\n\n{table(head, rows)}'


def _runs(results: Results, name: str, dogs: int, sigma: float) -> Results:
    policy, settings = _POLICIES[name]
    if policy == 'none':
        return results.of('herding', policy='none', sigma=sigma)
    return under(settings, results.of('herding', policy=policy, dogs=dogs, sigma=sigma))


def _figure(runs: _Runs, herds: list[int], figures: Path) -> str:
    figure, axes = new(2, max(len(herds), 1), width=4.5, height=2.8)
    for row, dogs in enumerate(herds):
        for k, (colour, name) in enumerate(zip(COLOURS, _POLICIES, strict=False)):
            there = [sigma for sigma in _SIGMAS if len(runs[name, dogs, sigma])]
            offset = 0.0004 * (k - 2)
            fractions = [success(runs[name, dogs, sigma]) for sigma in there]
            values = np.array([each.value for each in fractions])
            bars = [
                values - [each.low for each in fractions],
                [each.high for each in fractions] - values,
            ]
            axes[row, 0].errorbar(
                np.add(there, offset), values, bars, color=colour, marker='o', markersize=4,
                capsize=2, linewidth=1.0, label=name,
            )  # fmt: skip
            for sigma in there:
                arrived = [t for t in times(runs[name, dogs, sigma]) if math.isfinite(t)]
                axes[row, 1].plot(
                    np.full(len(arrived), sigma + offset), arrived, '.', color=colour, alpha=0.6
                )
        axes[row, 0].set(xlabel='σ', ylabel='safe arrivals', ylim=(-0.03, 1.03))
        axes[row, 1].set(xlabel='σ', ylabel='time of arrival [s]', ylim=(0.0, None))
        for place in axes[row]:
            place.set_xlim(0.005, 0.045)
        axes[row, 0].set_title(f'{dogs} dogs', fontsize=9)
    if axes[0, 0].get_legend_handles_labels()[0]:
        axes[0, 0].legend(fontsize=7, frameon=False)
    return save(figure, figures / 'baselines.png')


def _paired_table(runs: _Runs, herds: list[int], sigmas: list[float]) -> str:
    rows = []
    for dogs, sigma in product(herds, sigmas):
        ours, plain = (
            runs[name, dogs, sigma].by_seed() for name in ('our default', 'without mapping')
        )
        seeds = sorted(ours.keys() & plain.keys())
        if not seeds:
            continue
        both = [seed for seed in seeds if safe(ours[seed]) and safe(plain[seed])]
        faster = Mean.of([ours[seed]['time'] - plain[seed]['time'] for seed in both])
        spread = Mean.of([ours[seed]['max_spread'] - plain[seed]['max_spread'] for seed in seeds])
        ratio = Mean.of(
            [
                ours[seed]['plans']['error_ratio']
                for seed in seeds
                if ours[seed]['plans']['error_ratio'] is not None
            ]
        )
        rows.append(
            (
                str(dogs), f'{sigma:g}',
                str(sum(safe(ours[seed]) and not safe(plain[seed]) for seed in seeds)),
                str(sum(safe(plain[seed]) and not safe(ours[seed]) for seed in seeds)),
                f'{faster} ({len(both)})', str(spread), str(ratio),
            )
        )  # fmt: skip
    head = (
        'dogs', 'σ', 'safe only with mapping', 'safe only without',
        'time with − without [s] (seeds)',
        'largest spread with − without [m]', 'planning error after / before, corrected windows',
    )  # fmt: skip
    return table(head, rows)


def _scan_table(results: Results, herds: list[int]) -> str:
    rows = []
    for dogs, distance in product(herds, _DISTANCES):
        found = results.of('herding', dogs=dogs, settings={'sheep_distance': distance})
        if len(found):
            rows.append((str(dogs), significant(distance, 2), *summary(found)))
    return table(('dogs', 'r_a [m]', *SUMMARY), rows)


def _rows(runs: _Runs, herds: list[int], sigmas: list[float]) -> list[Row]:
    rows = []
    for dogs, sigma in product(herds, sigmas):
        words = [
            f'{name} {success(runs[name, dogs, sigma])}'
            for name in _POLICIES
            if name != 'our default' and len(runs[name, dogs, sigma])
        ]
        ours = runs['our default', dogs, sigma]
        if len(ours):
            rows.append(
                Row(
                    f'Baselines, {dogs} dogs, σ = {sigma:g}: safe arrivals',
                    'not in the paper',
                    str(success(ours)),
                    '; '.join(words),
                )
            )
    return rows
