# SPDX-License-Identifier: Apache-2.0
"""Real sheep: which crowd predicts recorded ones, how well, and how it is herded."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
import math
from pathlib import Path
from typing import Any

from herding_ros.fit.least_squares import LEADS
from herding_ros.model.state import Array
from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Fraction, Mean, Median, significant
from herding_ros.report.style import COLOURS, draw_goal, draw_herd, draw_paths, legend, new, save
import numpy as np

from .experiments.real import (
    ALIGNED,
    FORMS,
    HOME,
    identify,
    MAX_SPEED,
    PLANTS,
    STRAIGHT,
    UNALIGNED,
)
from .study import NOT_IN_PAPER, Options, Results, Row, Section
from .task import Task

TITLE = 'Real sheep'
DESCRIPTION = 'a crowd fitted to recorded drives (DATA), what it predicts, and how it is herded'

_PUBLISHED = ('78918eb96ffc4119', 29)
"""Name and number of the published drives, as `identify` returns them."""

_FOLDS = 4
"""The training drives are divided in so many for cross-validation."""

_KINDS = [STRAIGHT, *FORMS]

_PRESETS = {ALIGNED: PLANTS['as fitted'], UNALIGNED: PLANTS['not aligned']}
"""Crowds of this package that are fits to the training drives."""

_WITHOUT_EFFECT = {
    'dog.attraction_length', 'noise_field.period', 'noise_field.patch_radius',
}  # fmt: skip
"""Numbers of a crowd that belong to parts that these crowds do not have."""

_SAME = 0.005
"""A fit is a preset if no number differs by more than this share; presets are rounded."""

_GOAL = (24.0, 32.0)
_DOGS = (1, 3)
_POLICIES = {'ours': 'planner', 'rule': 'rule'}
_LIMIT = 200.0
"""Length of a run that does not arrive [s]."""

_BOUNDS = (0.38, 1.5, 2.8, 5.5)
"""Goals for the errors of single sheep [m] at the leads."""


def tasks(options: Options) -> list[Task]:
    """Return the fits, to all training drives and across them, and the runs."""
    quick, data = options.quick, options.recordings
    name, drives = identify(data) if data else _PUBLISHED
    inputs = {'path': str(data.absolute()) if data else ''}
    test = list(range(0, drives, 3))
    train = [i for i in range(drives) if i % 3]
    limits = {'data': name, 'known': train, 'folds': _FOLDS}
    found = [
        Task('real_drives', {'data': name}, 1.0, inputs),
        Task('real_limits', limits, 3.0, inputs),
    ]
    for form in _KINDS[:2] if quick else _KINDS:
        folds = [train[k::_FOLDS] for k in range(_FOLDS)]
        splits = [(train, test), *(([i for i in train if i not in fold], fold) for fold in folds)]
        for known, unknown in splits:
            noise = form in _PRESETS and unknown is test
            case = {'data': name, 'form': form, 'train': known, 'test': unknown, 'noise': noise}
            found.append(Task('real_prediction', case, 1.0 if form == STRAIGHT else 30.0, inputs))
    for plant, policy, dogs, seed in product(
        PLANTS, _POLICIES.values(), _DOGS, options.seed_range(20)
    ):
        run: dict[str, Any] = {
            'plant': plant, 'policy': policy, 'dogs': dogs, 'seed': seed, 'goal': _GOAL,
            'time_limit': 2.0 if quick else _LIMIT,
        }  # fmt: skip
        if policy == 'planner':
            run['paths'] = options.path_number(100)
        cost = 40.0 if policy == 'planner' else 10.0
        found.append(Task('real_herding', run, 0.05 * cost if quick else cost))
    return found


class _Prediction:
    """Errors of a form on drives that it was not fitted to."""

    def __init__(self, results: list[Any]) -> None:
        """Take the results of tasks, on different drives."""
        drives = [drive for result in results for drive in result['drives']]
        self.sums = {
            name: np.array([drive[name] for drive in drives]).reshape(-1, len(LEADS))
            for name in ('squares', 'of_centre', 'sheep', 'flocks')
        }

    @property
    def rms(self) -> Array:
        """Of single sheep at the leads (L,) [m]."""
        return _root(self.sums['squares'], self.sums['sheep'])

    @property
    def rms_of_centre(self) -> Array:
        """Of the flock's centre at the leads (L,) [m]."""
        return _root(self.sums['of_centre'], self.sums['flocks'])

    def less(self, other: _Prediction) -> list[Mean]:
        """Return by how much the error is less than another one's on the same drives [m].

        With the standard error over drives (delete-one jackknife).
        """
        value, n = other.rms - self.rms, len(self.sums['squares'])
        without = np.array([other._without(i) - self._without(i) for i in range(n)])
        error = np.sqrt((n - 1) * np.var(without, axis=0))
        return [Mean(float(a), float(b), n) for a, b in zip(value, error, strict=True)]

    def _without(self, drive: int) -> Array:
        kept = np.arange(len(self.sums['squares'])) != drive
        return _root(self.sums['squares'][kept], self.sums['sheep'][kept])


def _root(sums: Array, counts: Array) -> Array:
    with np.errstate(invalid='ignore'):
        return np.asarray(np.sqrt(sums.sum(axis=0) / counts.sum(axis=0)))


def draw(results: Results, figures: Path) -> Section:
    """Make the tables and the pictures."""
    fits = {form: results.of('real_prediction', form=form) for form in _KINDS}
    # The fit that is judged on the drives held out has more drives than any fold.
    most = max((len(task.parameters['train']) for task, _ in _all(fits)), default=0)
    final = {
        form: list(found.where(lambda task: len(task.parameters['train']) == most))
        for form, found in fits.items()
    }
    crossed = {
        form: list(found.where(lambda task: len(task.parameters['train']) < most))
        for form, found in fits.items()
    }
    held = {form: _Prediction(found) for form, found in final.items() if found}
    cross = {form: _Prediction(found) for form, found in crossed.items() if len(found) == _FOLDS}
    runs = {
        (plant, who, dogs): results.of('real_herding', plant=plant, policy=policy, dogs=dogs)
        for plant, (who, policy), dogs in product(PLANTS, _POLICIES.items(), _DOGS)
    }
    sizes = final[ALIGNED][0]['sizes'] if final[ALIGNED] else None
    _draw_errors(held, figures)
    _draw_runs(runs, figures)
    values = {
        'seeds': results.of('real_herding').seeds,
        'speed': f'{MAX_SPEED:g}',
        'home': f'{HOME:g}',
        'cross': _table(cross),
        'cross_gain': _gains(cross),
        'held': _table(held),
        'gain': _gains(held),
        'crowds': _crowds(final),
        'sizes': (
            f'{sizes[1]:.2f} m, where it is {sizes[0]:.2f} m in the recordings'
            if sizes
            else 'not known'
        ),
        'drives': _drives(results),
        'limits': _limits(results, cross.get(ALIGNED)),
        'later': _later(results),
        'runs': _runs_table(runs),
    }
    return Section(values, _rows(runs), [*_goals_of_fit(held, final, sizes), *_goals(runs)])


def _all(fits: dict[str, Results]) -> list[tuple[Task, Any]]:
    return [entry for found in fits.values() for entry in found.entries]


def _table(found: dict[str, _Prediction]) -> str:
    return table(
        {
            'crowd': form,
            **_at_leads(each.rms),
            'centre, 3 s': float(each.rms_of_centre[1]),
            'centre, 10 s': float(each.rms_of_centre[3]),
        }
        for form, each in found.items()
    )


def _gains(held: dict[str, _Prediction]) -> str:
    best = held.get(ALIGNED)
    return table(
        {
            'instead of': form,
            **{
                f'{lead:g} s': str(gain)
                for lead, gain in zip(LEADS, best.less(other), strict=True)
            },
        }
        for form, other in held.items()
        if best is not None and form != ALIGNED
    )


def _crowds(final: dict[str, list[Any]]) -> str:
    found = {form: final[form][0]['crowd'] for form in _PRESETS if final[form]}
    names = [name for name in next(iter(found.values()), {}) if name not in _WITHOUT_EFFECT]
    return table(
        {
            'parameter': f'`crowd.{name}`',
            **{form: float(crowd[name]) if crowd[name] else None for form, crowd in found.items()},
        }
        for name in names
        if any(crowd[name] for crowd in found.values())
    )


def _is_preset(form: str, fitted: Any) -> bool:
    there = _PRESETS[form].flat()
    return all(
        math.isclose(value, there[name], rel_tol=_SAME) for name, value in fitted['crowd'].items()
    )


def _drives(results: Results) -> str:
    rows = []
    for found in results.of('real_drives'):
        drives = found['drives']

        def total(name: str) -> float:
            return float(sum(drive[name] for drive in drives))  # noqa: B023, used at once

        pace = total('flock_path') / total('duration')
        rows.append(
            {
                'drives': len(drives),
                'time [s]': total('duration'),
                'path of the flock [m]': total('flock_path'),
                'its pace [m/s]': pace,
                'time for 40 m of it [s]': 40.0 / pace,
                'path of the dog over that of the flock': total('dog_path') / total('flock_path'),
                'dog to centre [m]': Mean.of([d['dog_distance'] for d in drives]),
                'spread [m]': Mean.of([d['spread'] for d in drives]),
            }
        )
    return table(rows)


def _limits(results: Results, ours: _Prediction | None) -> str:
    rows = [] if ours is None else [('the crowd `aligned`', ours.rms_of_centre)]
    for found in results.of('real_limits'):
        rows += found['centre'].items()
    return table({'known of the centre': name, **_at_leads(errors)} for name, errors in rows)


def _later(results: Results) -> str:
    return table(
        {'velocities': name, **_at_leads(errors)}
        for found in results.of('real_limits')
        for name, errors in found['sheep'].items()
    )


def _at_leads(values: Iterable[float]) -> dict[str, float]:
    return {f'{lead:g} s': float(value) for lead, value in zip(LEADS, values, strict=True)}


_Runs = dict[tuple[str, str, int], Results]
"""Runs by plant, who herds, and number of dogs."""


def _times(found: Results) -> list[float]:
    return [float(run['time']) if run['arrived'] else math.inf for run in found]


def _runs_table(runs: _Runs) -> str:
    return table(
        {
            'sheep': plant,
            'dogs': dogs,
            'herded by': who,
            'arrivals': Fraction.of(found.values('arrived')),
            'median time [s]': Median.of(_times(found)),
            'largest spread, mean [m]': found.mean('max_spread'),
            'path of a dog [m]': Mean.of([run['dogs_run'] / dogs for run in found]),
        }
        for (plant, who, dogs), found in runs.items()
        if len(found)
    )


def _rows(runs: _Runs) -> list[Row]:
    rows = []
    for plant, dogs in product(PLANTS, _DOGS):
        ours, rule = (runs[plant, who, dogs] for who in _POLICIES)
        if len(ours):
            remark = f'{Fraction.of(ours.values("arrived"))}'
            if len(rule):
                remark += f'; rule: {Median.of(_times(rule))} s, '
                remark += f'{Fraction.of(rule.values("arrived"))}'
            what = f'Sheep {plant}, dogs: {dogs}: time over 40 m'
            rows.append(Row(what, NOT_IN_PAPER, f'{Median.of(_times(ours))} s', remark))
    return rows


def _goals_of_fit(
    held: dict[str, _Prediction], final: dict[str, list[Any]], sizes: list[float] | None
) -> list[Goal]:
    goals = []
    if ALIGNED in held:
        for lead, bound, error in zip(LEADS, _BOUNDS, held[ALIGNED].rms, strict=True):
            what = f'held-out drives, {lead:g} s ahead: error of a sheep'
            goals.append(
                Goal(what, f'≤ {bound:g} m', f'{significant(error)} m', bool(error <= bound))
            )
    if sizes:
        ratio = sizes[1] / sizes[0]
        what = 'held-out drives, 10 s ahead: size of the flock over that recorded'
        goals.append(Goal(what, '0.9 to 1.1', ratio, 0.9 <= ratio <= 1.1))
    for form in _PRESETS:
        for fitted in final[form]:
            same = _is_preset(form, fitted)
            text = f'the crowd of this package that is {form} is what is fitted'
            goals.append(Goal(text, f'within {100.0 * _SAME:g} %', 'yes' if same else 'no', same))
    return goals


def _goals(runs: _Runs) -> list[Goal]:
    goals = []
    for plant, dogs in product(PLANTS, _DOGS):
        ours, rule = (runs[plant, who, dogs] for who in _POLICIES)
        if not len(ours):
            continue
        known = min(len(ours), len(rule)) >= 20
        arrived = Fraction.of(ours.values('arrived'))
        what = f'sheep {plant}, dogs: {dogs}'
        reached = arrived.value == 1.0 if known else None
        goals.append(Goal(f'{what}: arrivals', 'all', arrived, reached))
        time, bound = Median.of(_times(ours)), Median.of(_times(rule))
        reached = time.value <= bound.value if known else None
        goals.append(Goal(f'{what}: median time', f'≤ {bound} s', f'{time} s', reached))
    return goals


def _draw_errors(held: dict[str, _Prediction], figures: Path) -> None:
    figure, axes = new(2, 1, 4.2, 3.2)
    names = 'single sheep', 'centre of the flock'
    for place, name, part in zip(axes.flat, names, ('rms', 'rms_of_centre'), strict=True):
        for colour, (form, each) in zip(COLOURS, held.items(), strict=False):
            place.plot(LEADS, getattr(each, part), 'o-', color=colour, markersize=3, label=form)
        place.set(xlabel='time ahead [s]', ylabel='error, rms [m]', ylim=(0.0, None))
        place.set_title(name, fontsize=9)
    legend(axes[0, 0])
    save(figure, figures / 'real-errors.png')


def _draw_runs(runs: _Runs, figures: Path) -> None:
    figure, axes = new(2, 2, 4.0, 4.0)
    cases = product(_DOGS, _POLICIES)
    for place, (dogs, who) in zip(axes.flat, cases, strict=True):
        run = runs['as fitted', who, dogs].by_seed().get(0)
        if run is None:
            place.set_axis_off()
            continue
        paths = run['paths']
        draw_paths(place, np.array(paths['dogs']), np.array(paths['centre']))
        draw_herd(place, paths['first'], paths['dogs'][0], 0.3)
        draw_herd(place, paths['last'], paths['dogs'][-1])
        draw_goal(place, _GOAL)
        place.set_aspect('equal', 'datalim')
        end = '' if run['arrived'] else ', not there'
        place.set_title(f'{who}, dogs: {dogs}, {run["duration"]:.0f} s{end}', fontsize=9)
    save(figure, figures / 'real-runs.png')
