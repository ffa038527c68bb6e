# SPDX-License-Identifier: Apache-2.0
"""Section 7: the mean-field limit as the coarse model of large flocks."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Mean
from herding_ros.report.style import BLUE, GREY, legend, new, RED, save
import numpy as np

from .study import grid, Options, Results, Row, Section, tasks_of
from .task import Task

TITLE = 'Large flocks: the mean-field limit as coarse model (section 7)'
DESCRIPTION = 'section 7: the mean-field limit as coarse model: convergence, mapping, cost'

_FLOCKS = {100: 10, 300: 8, 1000: 6, 3000: 4, 10_000: 3}
"""Numbers of sheep, and for each the number of flocks that are compared with the limit."""
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
"""Coarse models of a flock of a thousand, and the number of markers that selects them."""


def tasks(options: Options) -> list[Task]:
    """Return flocks to compare with the limit, windows to map, and plans to time."""
    quick = options.quick
    comparison = {
        'dogs': 5,
        'duration': 2.0 if quick else 20.0,
        'dt': 0.05,
        'markers': list(_MARKERS),
        'density_markers': _DENSITY,
    }
    found = [
        task
        for sheep, usual in _FLOCKS.items()
        if not quick or sheep < 1000
        for task in tasks_of(
            'mean_field_convergence', 0.5 if quick else 4.0 + 3e-7 * sheep**2,
            grid(sheep=(sheep,), seed=options.seed_range(usual)), **comparison,
        )
    ]  # fmt: skip
    window = {
        'sheep': 300 if quick else _MAPPED,
        'dogs': 5,
        'judge_paths': options.path_number(_PATHS),
    }
    limit, all_sheep = _COARSE.values()
    # All sheep in the coarse model cost minutes: one noise and one flock suffice.
    for markers, sigmas, flocks, cost in (
        (limit, _SIGMAS[-1:] if quick else _SIGMAS, 2, 60.0),
        (all_sheep, _SIGMAS[-1:], 1, 240.0),
    ):
        cases = grid(sigma=sigmas, seed=options.seed_range(flocks))
        control = _control(markers, options)
        found += tasks_of(
            'mean_field_mapping', 0.5 if quick else cost, cases, **window, control=control
        )
    replan = {
        'flocks': [5, 20] if quick else list(_TIMED),
        'dogs': 5,
        'seed': 0,
        'iterations': 2 if quick else 30,
    }
    return [*found, Task('mean_field_replan', replan, cost=1.0 if quick else 40.0)]


def _control(markers: int, options: Options) -> dict[str, Any]:
    settings = {
        'mapping.paths': options.path_number(_PATHS),
        'mapping.max_iterations': 1 if options.quick else _ITERATIONS,
        'mapping.tolerance': 1e-4,
        'coarse.markers': markers,
    }
    short = {'horizon.length': 2.0, 'horizon.accepted': 1.0}
    return {**settings, **short} if options.quick else settings


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and the picture."""
    rates = {
        f'{name}_{words}': _exponent(_rate(results, *path, name))
        for name in _QUANTITIES
        for words, path in {'same': ('flock', str(_LIMIT)), 'density': ('density',)}.items()
    }
    replans = list(results.of('mean_field_replan'))
    replan = replans[0] if replans else {}
    _draw_convergence(results, figures)
    values = {
        'convergence': _convergence_table(results),
        **rates,
        'mapping': _mapping_table(results),
        'replan': _replan_table(replan),
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
    return Section(values, rows, _goals(results, replan))


def _goals(results: Results, replan: dict[str, dict[str, float]]) -> list[Goal]:
    mapped = _mapped(results, _SIGMAS[-1], _COARSE['mean-field limit'])
    mapped = mapped.of('mean_field_mapping', sheep=_MAPPED)
    ratios = [each['after'] / each['before'] for each in mapped]
    few, many = replan.get('200'), replan.get('10000')
    costs = [sum(many.values()) / sum(few.values())] if few and many else []
    return [
        Goal(text, f'≤ {bound:g}', max(found, default='–'), max(found) <= bound if found else None)
        for text, bound, found in (
            (
                f'N = {_MAPPED}, σ = {_SIGMAS[-1]:g}, mean-field coarse model, at most '
                f'{_ITERATIONS} iterations: error after / before',
                _BOUND,
                ratios,
            ),
            ('Replan for N = 10,000 / for N = 200, the fine model apart', 1.0, costs),
        )
    ]


def _errors(results: Results, sheep: int, *path: str) -> list[float]:
    return results.of('mean_field_convergence', sheep=sheep).values(*path)


def _mapped(results: Results, sigma: float, markers: int) -> Results:
    windows = results.of('mean_field_mapping', sigma=sigma)
    return windows.where(lambda task: task.parameters['control']['coarse.markers'] == markers)


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
    return table(
        {
            'N': f'{sheep:,}',
            'flocks': len(here),
            **{
                f'{name}, {count} [m]': here.mean('flock', str(count), name)
                for name, count in product(_QUANTITIES, _MARKERS)
            },
            **{
                f'{name}, from the density [m]': here.mean('density', name) for name in _QUANTITIES
            },
            'growth of the spread [m]': here.mean('widened'),
        }
        for sheep in _FLOCKS
        if len(here := results.of('mean_field_convergence', sheep=sheep))
    )


def _mapping_table(results: Results) -> str:
    return table(
        {
            'σ': f'{sigma:g}',
            'coarse model': words,
            'before': f'{result["before"]:.1e}',
            'after': f'{result["after"]:.1e}',
            'after / before': result['after'] / result['before'],
            'on other paths': result['judged_after'] / result['judged_before'],
            'iterations': result['iterations'],
            'coarse solve [s]': f'{result["seconds"]["coarse"]:.1f}',
            'extraction [s]': f'{result["seconds"]["extraction"]:.1f}',
            'fine [s]': f'{result["seconds"]["fine"]:.0f}',
        }
        for sigma, (words, markers) in product(_SIGMAS, _COARSE.items())
        for result in _mapped(results, sigma, markers)
    )


def _replan_table(replan: dict[str, dict[str, float]]) -> str:
    return table(
        {
            'N': f'{int(sheep):,}',
            'coarse solve [s]': f'{seconds["coarse"]:.2f}',
            'sensitivity [s]': f'{seconds["sensitivity"]:.2f}',
            'together [s]': f'{sum(seconds.values()):.2f}',
        }
        for sheep, seconds in replan.items()
    )


def _draw_convergence(results: Results, figures: Path) -> None:
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
    legend(axes[0, 1])
    save(figure, figures / 'mean_field.png')
