"""Section 7: the mean-field limit as the coarse model of large flocks."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from .markdown import table
from .pictures import BLUE, GREY, new, RED, save
from .statistics import Mean, significant
from .study import Goal, Options, Results, Row, Section
from .task import Task

DESCRIPTION = 'section 7: the mean-field limit as coarse model: convergence, mapping, cost'

_FLOCKS = {100: 10, 300: 8, 1000: 6, 3000: 4, 10_000: 3}
"""Sheep, and how many flocks of so many are compared with the limit."""
_MARKERS = (128, 256, 512)
_LIMIT = 512
"""Markers whose own error is small against that of all but the largest flocks."""
_DENSITY = 1024
_QUANTITIES = ('centre', 'spread')
_MAPPED = 1000
_SIGMAS = (0.01, 0.02, 0.03)
_PATHS = 16
_ITERATIONS = 4
_TIMED = (200, 1000, 10_000, 100_000)
_BOUND = 0.2
_COARSE = {'mean-field limit': 128, 'all sheep': 500}
"""The number of markers that makes a flock of a thousand be planned for in either way."""


def tasks(options: Options) -> list[Task]:
    """Return flocks to compare with the limit, windows to map, and plans to time."""
    quick = options.quick
    found = [
        Task(
            'mean_field_convergence',
            {
                'sheep': sheep,
                'dogs': 5,
                'seed': seed,
                'duration': 2.0 if quick else 20.0,
                'dt': 0.05,
                'markers': list(_MARKERS),
                'density_markers': _DENSITY,
            },
            cost=0.5 if quick else 4.0 + 3e-7 * sheep**2,
        )
        for sheep, usual in _FLOCKS.items()
        if not quick or sheep < 1000
        for seed in options.seed_range(usual)
    ]
    sheep, sigmas = (300, _SIGMAS[-1:]) if quick else (_MAPPED, _SIGMAS)
    windows = [(markers, sigma) for markers, sigma in product(_COARSE.values(), sigmas)]
    found += [
        Task(
            'mean_field_mapping',
            {
                'sheep': sheep,
                'dogs': 5,
                'sigma': sigma,
                'seed': seed,
                'judge_paths': options.path_number(_PATHS),
                'control': _control(markers, options, quick),
            },
            cost=0.5 if quick else 60.0 * (1.0 if markers == min(_COARSE.values()) else 4.0),
        )
        for markers, sigma in windows
        # All sheep in the coarse model cost minutes: one noise and one flock show how it does.
        if markers <= min(_COARSE.values()) or sigma == _SIGMAS[-1]
        for seed in options.seed_range(2 if markers == min(_COARSE.values()) else 1)
    ]
    flocks = [20, 300] if quick else list(_TIMED)
    return [
        *found,
        Task(
            'mean_field_replan',
            {'flocks': flocks, 'dogs': 5, 'seed': 0, 'iterations': 2 if quick else 30},
            cost=1.0 if quick else 40.0,
        ),
    ]


def _control(markers: int, options: Options, quick: bool) -> dict[str, Any]:
    settings: dict[str, Any] = {
        'mapping': {
            'paths': options.path_number(_PATHS),
            'max_iterations': 1 if quick else _ITERATIONS,
            'accuracy': 1e-4,
        },
        'coarse': {'markers': markers},
    }
    if quick:
        settings['horizon'] = {'length': 2.0, 'accepted': 1.0}
    return settings


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and the picture."""
    rates = {
        f'{name}_{words}': _exponent(_rate(results, *path, name))
        for name in _QUANTITIES
        for words, path in {'same': ('flock', str(_LIMIT)), 'density': ('density',)}.items()
    }
    mapped = [
        result['after'] / result['before']
        for task, result in results.of(
            'mean_field_mapping', sheep=_MAPPED, sigma=_SIGMAS[-1]
        ).entries
        if task.parameters['control']['coarse']['markers'] == _COARSE['mean-field limit']
    ]
    worst = max(mapped, default=None)
    replan = _replan(results)
    large = str(10_000)
    ratio = _total(replan[large]) / _total(replan['200']) if large in replan else None
    values = {
        'convergence': _convergence_table(results),
        **rates,
        'mapping': _mapping_table(results),
        'replan': _replan_table(replan),
        'picture': _figure(results, figures),
    }
    rows = [
        Row(
            f'§7, mean-field limit: {name} of N sheep drawn from its density',
            'formal limit',
            f'error ~ N^{rates[f"{name}_density"]}',
            'without noise; i.i.d. draws: N^-0.5',
        )
        for name in _QUANTITIES
    ]
    measured = '–' if worst is None else significant(worst)
    goals = [
        Goal(
            f'N = {_MAPPED}, σ = {_SIGMAS[-1]:g}, mean-field coarse model, at most {_ITERATIONS} '
            'iterations: error after / before',
            f'≤ {_BOUND:g}', measured, None if worst is None else worst <= _BOUND,
        ),
        Goal(
            'Replan for N = 10,000 / for N = 200, the fine model apart', '≤ 1',
            '–' if ratio is None else significant(ratio),
            None if ratio is None else ratio <= 1.0,
        ),
    ]  # fmt: skip
    return Section(values, rows, goals)


def _errors(results: Results, sheep: int, *path: str) -> list[float]:
    return results.of('mean_field_convergence', sheep=sheep).values(*path)


def _rate(results: Results, *path: str) -> float | None:
    """Return the exponent of N in the mean error under this path of keys."""
    found = {
        sheep: float(np.mean(errors))
        for sheep in _FLOCKS
        if (errors := _errors(results, sheep, *path))
    }
    if len(found) < 2:
        return None
    return float(np.polyfit(np.log(list(found)), np.log(list(found.values())), 1)[0])


def _exponent(rate: float | None) -> str:
    return '–' if rate is None else f'{rate:.2f}'


def _convergence_table(results: Results) -> str:
    rows = []
    for sheep in _FLOCKS:
        here = results.of('mean_field_convergence', sheep=sheep)
        if len(here):
            errors = [
                str(Mean.of(here.values('flock', str(count), name)))
                for name in _QUANTITIES
                for count in _MARKERS
            ]
            density = [str(Mean.of(here.values('density', name))) for name in _QUANTITIES]
            widened = str(Mean.of(here.values('widened')))
            rows.append((f'{sheep:,}', str(len(here)), *errors, *density, widened))
    head = (
        'N', 'flocks', *(f'{name}, {count} [m]' for name in _QUANTITIES for count in _MARKERS),
        *(f'{name}, from the density [m]' for name in _QUANTITIES), 'growth of the spread [m]',
    )  # fmt: skip
    return table(head, rows)


def _mapping_table(results: Results) -> str:
    rows = []
    for sigma, (words, markers) in product(_SIGMAS, _COARSE.items()):
        found = results.of('mean_field_mapping', sigma=sigma).where(
            lambda task, markers=markers: (  # type: ignore[misc]
                task.parameters['control']['coarse']['markers'] == markers
            )
        )
        for result in found:
            after = result['after'] / result['before']
            judged = result['judged_after'] / result['judged_before']
            rows.append(
                (
                    f'{sigma:g}', words, f'{result["before"]:.1e}', f'{result["after"]:.1e}',
                    significant(after), significant(judged), str(result['iterations']),
                    *(f'{result["seconds"][name]:.1f}' for name in ('coarse', 'extraction')),
                    f'{result["seconds"]["fine"]:.0f}',
                )
            )  # fmt: skip
    head = (
        'σ', 'coarse model', 'before', 'after', 'after / before', 'on other paths',
        'iterations', 'coarse solve [s]', 'extraction [s]', 'fine [s]',
    )  # fmt: skip
    return table(head, rows)


def _replan(results: Results) -> dict[str, dict[str, float]]:
    found = [result for result in results.of('mean_field_replan')]
    return found[0] if found else {}


def _total(seconds: dict[str, float]) -> float:
    return sum(seconds.values())


def _replan_table(replan: dict[str, dict[str, float]]) -> str:
    rows = [
        (
            f'{int(sheep):,}', f'{seconds["coarse"]:.2f}', f'{seconds["sensitivity"]:.2f}',
            f'{_total(seconds):.2f}',
        )
        for sheep, seconds in replan.items()
    ]  # fmt: skip
    return table(('N', 'coarse solve [s]', 'sensitivity [s]', 'together [s]'), rows)


def _figure(results: Results, figures: Path) -> str:
    figure, axes = new(len(_QUANTITIES), 1)
    series = {
        f'limit of the same flock, {_LIMIT} markers': (('flock', str(_LIMIT)), BLUE, 'o-'),
        f'{_MARKERS[0]} markers, the default': (('flock', str(_MARKERS[0])), RED, 's--'),
        'limit of the density it is drawn from': (('density',), GREY, '^:'),
    }
    for place, name in zip(axes[0], _QUANTITIES, strict=True):
        for label, (path, colour, style) in series.items():
            found = {
                sheep: Mean.of(errors)
                for sheep in _FLOCKS
                if (errors := _errors(results, sheep, *path, name))
            }
            if not found:
                continue
            place.errorbar(
                list(found), [each.value for each in found.values()],
                yerr=[np.nan_to_num(each.error) for each in found.values()],
                fmt=style, color=colour, markersize=4, linewidth=1.2, capsize=2, label=label,
            )  # fmt: skip
        first = _errors(results, min(_FLOCKS), 'density', name)
        if first:
            n = np.array([min(_FLOCKS), max(_FLOCKS)])
            place.plot(n, np.mean(first) * np.sqrt(n[0] / n), color='black', linewidth=0.6)
            place.set(xscale='log', yscale='log')
        place.set(xlabel='N', ylabel=f'error of the {name} [m]')
    if axes[0, 1].get_legend_handles_labels()[0]:
        axes[0, 1].legend(fontsize=7, frameon=False)
    return save(figure, figures / 'mean_field.png')
