# SPDX-License-Identifier: Apache-2.0
"""Plants that the controller is not made for: of others, and ours with another truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from itertools import product
import math
from pathlib import Path
from typing import Any

from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Fraction, Mean, Median
from herding_ros.report.style import COLOURS, legend, new, save
import numpy as np

from .experiments.lama import MAIN, SMALL
from .runs import SETTINGS
from .study import NOT_IN_PAPER, Options, Results, Row, Section
from .task import Task

TITLE = 'Strangers: plants that the controller is not made for'
DESCRIPTION = "other authors' herds with their own rules, and ours with another truth"

_CONTROLLERS: dict[str, tuple[str, dict[str, Any]]] = {
    'own rule': ('rule', {}),
    'ours': ('planner', SETTINGS['default']),
    "ours in the paper's setting": ('planner', SETTINGS['paper'] | {'horizon.feedback': 30.0}),
}
"""Policies and settings. The paper's has no feedback: nowhere is `accepted` longer than 30 s."""
_RULE, _OURS, _PAPER = _CONTROLLERS

_HERDS: dict[str, tuple[str, dict[str, Any], float, float]] = {
    '2 herders, 7 targets': ('targets', asdict(SMALL), 100.0, 40.0),
    '10 herders, 50 targets': ('targets', asdict(MAIN), 150.0, 450.0),
    '1 dog, 25 sheep': ('flock', {}, 700.0, 60.0),
}
"""Plants of others with their parameters, the time limit [s] and the cost of a run of ours."""

_HERDERS, _TARGETS = (1, 2, 3, 5), (4, 7, 14, 28)
"""Of the herdability map: otherwise the small setting."""
_MAP_SEEDS = 5

_TRUTHS: dict[str, tuple[int, dict[str, Any]]] = {
    '2 dogs, as told': (2, {}),
    '3 dogs, as told': (3, {}),
    '5 dogs, as told': (5, {}),
    'force of dogs × ½': (3, {'force': 0.5}),
    'force of dogs × 2': (3, {'force': 2.0}),
    'range of dogs × ½': (3, {'reach': 0.5}),
    'range of dogs × 2': (3, {'reach': 2.0}),
    'friction × ½': (3, {'friction': 0.5}),
    'friction × 2': (3, {'friction': 2.0}),
    'no attraction between sheep': (3, {'attraction': 0.0}),
    'sheep no faster than 0.03 m/s': (3, {'speed_limit': 0.03}),
    'response to dogs lognormal, 0.5': (3, {'diversity': 0.5}),
    '20 % of the sheep ignore dogs': (3, {'ignoring': 0.2}),
    'observations 0.5 s late': (3, {'delay': 0.5}),
    'observations 1 s late': (3, {'delay': 1.0}),
    '30 % of the commands lost': (3, {'loss': 0.3}),
    'a gust of 0.3 m after 20 s': (3, {'gust': 0.3}),
}
"""Numbers of dogs, and what is different from what the controller is told."""
_TRUTH_LIMIT = 250.0


def tasks(options: Options) -> list[Task]:
    """Return runs of all controllers on the same herds under the same noise."""
    quick, seeds = options.quick, options.seed_range(20)
    found: list[Task] = []
    for plant, given, limit, cost in list(_HERDS.values())[:: 2 if quick else 1]:
        found += _runs(options, seeds, plant, given, 2.0 if quick else limit, cost)
    for m, n in product(*([(1,), (4,)] if quick else [_HERDERS, _TARGETS])):
        given, limit = _on_map(m, n), 1.0 if quick else 100.0
        found += _runs(options, seeds[:_MAP_SEEDS], 'targets', given, limit, 2.0 * m * n, 2)
    for dogs, truth in list(_TRUTHS.values())[-1:] if quick else _TRUTHS.values():
        given = _world(dogs, truth) | ({'sheep': 6} if quick else {})
        found += _runs(options, seeds, 'truth', given, 2.0 if quick else _TRUTH_LIMIT, 30.0)
    return list({task.key: task for task in found}.values())


def _runs(
    options: Options,
    seeds: Iterable[int],
    plant: str,
    given: dict[str, Any],
    limit: float,
    cost: float,
    controllers: int = len(_CONTROLLERS),
) -> Iterator[Task]:
    """Yield runs of the first so many controllers; cost: of ours [s]."""
    for seed, (policy, settings) in product(seeds, list(_CONTROLLERS.values())[:controllers]):
        case: dict[str, Any] = {
            'plant': plant, 'given': given, 'policy': policy, 'settings': settings,
            'seed': seed, 'time_limit': limit,
        }  # fmt: skip
        if policy == 'planner':
            case['paths'] = options.path_number(100)
        takes = cost if policy == 'planner' else 3.0
        yield Task('strangers', case, 0.05 * takes if options.quick else takes)


def _on_map(herders: int, targets: int) -> dict[str, Any]:
    return asdict(SMALL) | {'herders': herders, 'targets': targets}


def _world(dogs: int, truth: dict[str, Any]) -> dict[str, Any]:
    return {'sheep': 20, 'dogs': dogs, 'goal': [1.0, 1.0], **truth}


_Runs = dict[tuple[str, str], Results]
"""Runs by herd or truth, and controller."""


def draw(results: Results, figures: Path) -> Section:
    """Make the tables, the fractions over time and the herdability maps."""
    herds = {name: (plant, given) for name, (plant, given, _, _) in _HERDS.items()}
    truths = {name: ('truth', _world(*each)) for name, each in _TRUTHS.items()}
    runs = {
        (name, controller): _of(results, plant, given, controller)
        for (name, (plant, given)), controller in product((herds | truths).items(), _CONTROLLERS)
    }
    _draw_chi(runs, figures)
    _draw_maps(results, figures)
    values = {
        'seeds': results.seeds,
        'herds': _table(runs, _HERDS),
        'truths': _table(runs, _TRUTHS),
        'map_seeds': str(_MAP_SEEDS),
    }
    return Section(values, _rows(runs), _goals(runs))


def _of(results: Results, plant: str, given: dict[str, Any], controller: str) -> Results:
    policy, settings = _CONTROLLERS[controller]
    return results.of('strangers', plant=plant, given=given, policy=policy, settings=settings)


def _times(runs: Results) -> list[float]:
    """Return the times of arrival [s], infinite where there was none."""
    return [float(run['time']) if run['arrived'] else math.inf for run in runs]


def _success(runs: Results) -> Fraction:
    return Fraction.of(runs.values('arrived'))


def _table(runs: _Runs, names: Iterable[str]) -> str:
    return table(
        {
            'plant': name,
            'controller': controller,
            'arrivals': _success(found),
            'median time [s]': Median.of(_times(found)),
            'mean time of arrivals [s]': found.mean('time'),
            'χ at the end': found.mean('final_chi'),
            'largest spread [m]': found.mean('max_spread'),
            'path of a dog [m]': Mean.of([run['dogs_run'] / run['dogs'] for run in found]),
            'energy ∫ Σ\\|u\\|² dt [m²/s]': found.mean('energy'),
        }
        for name, controller in product(names, _CONTROLLERS)
        if len(found := runs[name, controller])
    )


def _draw_chi(runs: _Runs, figures: Path) -> None:
    figure, axes = new(len(_HERDS), 1, width=3.4, height=2.8)
    for place, name in zip(axes.flat, _HERDS, strict=True):
        limit = _HERDS[name][2]
        for controller, colour in zip(_CONTROLLERS, COLOURS, strict=False):
            found = runs[name, controller]
            if len(found):
                # A run that has arrived is over: all are home, as far as anybody counts.
                instants = np.linspace(0.0, limit, 101)
                chi = [
                    np.interp(instants, run['t'], run['chi'], right=run['final_chi'])
                    for run in found
                ]
                place.plot(instants, np.mean(chi, axis=0), color=colour, label=controller)
        place.set(ylim=(0.0, 1.03), xlabel='time [s]', ylabel='χ')
        place.set_title(name, fontsize=9)
    legend(axes[0, -1])
    save(figure, figures / 'strangers-chi.png')


def _draw_maps(results: Results, figures: Path) -> None:
    figure, axes = new(2, 1, width=3.4, height=2.8)
    for place, controller in zip(axes.flat, (_RULE, _OURS), strict=True):
        success = np.array(
            [[_success(_on(results, m, n, controller)).value for n in _TARGETS] for m in _HERDERS]
        )
        place.imshow(
            success, vmin=0.0, vmax=1.0, origin='lower', cmap='Blues', aspect='auto', zorder=2
        )
        for (i, j), value in np.ndenumerate(success):
            if np.isfinite(value):
                colour = 'white' if value > 0.5 else 'black'
                place.text(j, i, f'{value:.1f}', ha='center', va='center', color=colour)
        place.set_xticks(range(len(_TARGETS)), _TARGETS)
        place.set_yticks(range(len(_HERDERS)), _HERDERS)
        place.set(xlabel='targets', ylabel='herders')
        place.set_title(controller, fontsize=9)
    save(figure, figures / 'strangers-herdability.png')


def _on(results: Results, herders: int, targets: int, controller: str) -> Results:
    """Return the runs of a field of the map; the small setting has more seeds than it needs."""
    found = _of(results, 'targets', _on_map(herders, targets), controller)
    return found.where(lambda task: task.parameters['seed'] < _MAP_SEEDS)


def _rows(runs: _Runs) -> list[Row]:
    rows = []
    for name in _HERDS:
        rule, ours = (runs[name, each] for each in (_RULE, _OURS))
        if len(rule) and len(ours):
            remark = f'{_success(ours)}; {_RULE}: {Median.of(_times(rule))} s, {_success(rule)}'
            rows.append(Row(name, NOT_IN_PAPER, f'{Median.of(_times(ours))} s', remark))
    return rows


def _goals(runs: _Runs) -> list[Goal]:
    goals = []
    for name in _HERDS:
        rule, ours = (runs[name, each] for each in (_RULE, _OURS))
        if not len(ours):
            continue
        known = min(len(rule), len(ours)) >= 20
        success = _success(ours)
        reached = success.value >= _success(rule).value if known else None
        goals.append(Goal(f'{name}: arrivals', f'≥ {_success(rule)}', success, reached))
        time, bound = ours.mean('time'), rule.mean('time')
        reached = time.value <= bound.value if known else None
        goals.append(Goal(f'{name}: mean time', f'≤ {bound} s', f'{time} s', reached))
    for name, (dogs, _) in _TRUTHS.items():
        each = {controller: _success(runs[name, controller]) for controller in _CONTROLLERS}
        if dogs == 3 and each[_OURS].count:
            goals.append(_goal_of_truth(name, each))
    return goals


def _goal_of_truth(name: str, success: dict[str, Fraction]) -> Goal:
    """At least 17 of 20 where any controller reaches half, and never below the heuristic."""
    rule, ours = success[_RULE], success[_OURS]
    bound = 0.85 if any(each.value >= 0.5 for each in success.values()) else 0.0
    bound = max(bound, rule.value) if rule.count else bound
    known = min(rule.count, ours.count) >= 20
    return Goal(name, f'≥ {100.0 * bound:.0f} %', ours, ours.value >= bound if known else None)
