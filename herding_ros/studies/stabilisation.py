# SPDX-License-Identifier: Apache-2.0
"""Figure "simulation": the herd after the arrival."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from herding_ros.model.flock import Arrival
from herding_ros.model.scenario import GOAL
from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Fraction, Mean, Median
from herding_ros.report.style import BLUE, draw_goal, draw_herd, new, save
from matplotlib.patches import Circle
import numpy as np

from .runs import NAMES, run_task, SETTINGS
from .study import grid, Options, Results, Row, Section
from .task import Task

TITLE = 'Stabilisation (Figure "simulation")'
DESCRIPTION = 'Figure "simulation": 250 s with 5 dogs; do they circle, does the flock stay?'

_LENGTH = 250.0
_SNAPSHOTS = (10.0, 25.0, 50.0, 75.0, 125.0, 250.0)
_HELD_DISTANCE, _HELD_SPREAD = 0.1, 1.2


_SETTINGS = {
    name: {**settings, 'weights.control': 1e-3, 'mapping.max_iterations': 2}
    for name, settings in SETTINGS.items()
}
"""With gamma = 1e-3 and at most two corrections of a plan, as in the paper."""


def tasks(options: Options) -> list[Task]:
    """Return long runs under both settings."""
    length = 20.0 if options.quick else _LENGTH
    snapshots = [t for t in _SNAPSHOTS if t <= length]
    return [
        run_task(
            options,
            cost=0.3 if options.quick else 7.0,
            dogs=5,
            time_limit=length,
            stop=False,
            snapshots=snapshots,
            **case,
        )
        for case in grid(settings=list(_SETTINGS.values()), seed=options.seed_range(20))
    ]


def draw(results: Results, figures: Path) -> Section:
    """Make the tables, the snapshots and the courses."""
    runs = {
        name: results.of('herding', stop=False, settings=settings)
        for name, settings in _SETTINGS.items()
    }
    _draw_snapshots(runs['default'], figures)
    _draw_courses(runs, figures)
    there = {NAMES[name]: found for name, found in runs.items() if len(found)}
    values = {
        'seeds': results.seeds,
        'held': table({'': words, **_held(found)} for words, found in there.items()),
        'circling': table({'': words, **_circling(found)} for words, found in there.items()),
    }
    return Section(values, _rows(runs), _goals(runs['default']))


def _after(runs: Results) -> list[dict[str, Any]]:
    """Return what held after the arrival, of the runs that arrived before the end."""
    return [
        {**run['from_home'], 'initial_spread': run['initial_spread']}
        for run in runs
        if run['from_home']
    ]


def _distance_held(runs: Results) -> Fraction:
    return Fraction.of([each['max_distance'] <= _HELD_DISTANCE for each in _after(runs)])


def _spread_held(runs: Results) -> Fraction:
    return Fraction.of(
        [each['max_spread'] <= _HELD_SPREAD * each['initial_spread'] for each in _after(runs)]
    )


def _turning(runs: Results) -> list[float]:
    """Return the mean magnitude of the turning of a dog in each run [rad/s]."""
    return [float(np.abs(each['turning']).mean()) for each in _after(runs)]


def _held(runs: Results) -> dict[str, object]:
    after = _after(runs)
    farthest = [each['max_distance'] for each in after]
    widest = [each['max_spread'] / each['initial_spread'] for each in after]
    spreads = [each['mean_spread'] / each['initial_spread'] for each in after]
    return {
        'arrived': Fraction.of([run['arrived'] for run in runs]),
        'time [s]': Median.of([run['time'] if run['arrived'] else math.inf for run in runs]),
        'distance afterwards, mean [m]': Mean.of([each['mean_distance'] for each in after]),
        'its maximum, mean over seeds': Mean.of(farthest),
        'largest distance': f'{max(farthest, default=math.nan):.3f}',
        'distance held': _distance_held(runs),
        'spread afterwards / first, mean': Mean.of(spreads),
        'maximum of the spread, mean over seeds': Mean.of(widest),
        'largest spread': f'{max(widest, default=math.nan):.2f}',
        'spread held': _spread_held(runs),
    }


def _circling(runs: Results) -> dict[str, object]:
    after, turning = _after(runs), _turning(runs)
    together = [abs(float(np.mean(each['turning']))) for each in after]
    return {
        'dogs from the centre [m]': Mean.of([each['dog_distance'] for each in after]),
        'angular speed of a dog [rad/s]': Mean.of([each['turning_speed'] for each in after]),
        'mean turning of a dog, magnitude [rad/s]': Mean.of(turning),
        'of all dogs together, magnitude [rad/s]': Mean.of(together),
        'turns of a dog per 100 s': Mean.of([100.0 * rate / (2.0 * math.pi) for rate in turning]),
    }


def _draw_snapshots(runs: Results, figures: Path) -> None:
    figure, axes = new(3, 2, width=3.4, height=3.2)
    run = runs.by_seed().get(0)
    shots = run['snapshots'] if run else []
    for place in axes.flat[len(shots) :]:
        place.set_axis_off()
    for place, shot in zip(axes.flat, shots, strict=False):
        draw_herd(place, shot['x'], shot['d'])
        draw_goal(place, GOAL)
        middle = np.mean(shot['x'], axis=0)
        radius = float(np.linalg.norm(np.array(shot['d']) - middle, axis=1).mean())
        place.add_patch(Circle(tuple(middle), radius, fill=False, color='black', linewidth=0.8))
        place.set_title(f't = {shot["t"]:g} s', fontsize=9)
    save(figure, figures / 'stabilisation-snapshots.png')


def _draw_courses(runs: dict[str, Results], figures: Path) -> None:
    figure, axes = new(2, 2, width=4.5, height=2.4)
    style: dict[str, Any] = {'color': BLUE, 'linewidth': 0.6, 'alpha': 0.5}
    limits = (Arrival.radius, Arrival.spread)
    for row, found in zip(axes, runs.values(), strict=True):
        for run in found:
            t, distance, spread = (
                np.array(run['paths'][each]) for each in ('t', 'distance', 'spread')
            )
            row[0].plot(t, distance, **style)
            row[1].plot(t, spread / run['initial_spread'], **style)
        for place, label, limit in zip(
            row, ('distance [m]', 'spread / first'), limits, strict=True
        ):
            place.axhline(limit, color='black', linestyle='--', linewidth=0.8)
            place.set(ylabel=label, xlabel='time [s]', ylim=(0.0, None))
    save(figure, figures / 'stabilisation-courses.png')


def _rows(runs: dict[str, Results]) -> list[Row]:
    return [
        Row(
            f'Figure "simulation", {NAMES[name]}: largest distance after the arrival',
            'a picture',
            f'{Mean.of([each["max_distance"] for each in _after(found)])} m',
            f'mean turning of a dog {Mean.of(_turning(found))} rad/s; '
            f'spread held in {_spread_held(found)}',
        )
        for name, found in runs.items()
        if _after(found)
    ]


def _goals(runs: Results) -> list[Goal]:
    goals = []
    for what, bound, held in (
        ('distance', f'≤ {_HELD_DISTANCE} m at all times', _distance_held(runs)),
        ('spread', f'≤ {_HELD_SPREAD} times the first at all times', _spread_held(runs)),
    ):
        reached = held.successes == len(runs) if len(runs) >= 20 else None
        text = f'After the arrival until 250 s, γ = 1e-3: {what}'
        goals.append(Goal(text, bound, f'in {held}', reached))
    return goals
