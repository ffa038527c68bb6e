"""Figure "simulation": what happens after the arrival."""

from __future__ import annotations

from itertools import product
import math
from pathlib import Path
from typing import Any

from matplotlib.patches import Circle
import numpy as np

from herding_ros.model.flock import ARRIVAL_DISTANCE, TOGETHER

from .markdown import table
from .pictures import BLUE, draw_herd, new, save
from .runs import paths_of, run_task, SETTINGS, under, with_mapping
from .statistics import Fraction, Mean, Median
from .study import Goal, Options, Results, Row, Section
from .task import Task

DESCRIPTION = 'Figure "simulation": 250 s with 5 dogs; do they circle, does the flock stay?'

_GOAL = [0.5, 0.5]
_LENGTH = 250.0
_SNAPSHOTS = (10.0, 25.0, 50.0, 75.0, 125.0, 250.0)
_DOGS = 5
_HELD_DISTANCE, _HELD_SPREAD = 0.1, 1.2


def _settings(name: str) -> dict[str, Any]:
    """Return gamma = 1e-3 and at most two corrections of a plan, as in the paper."""
    settings = SETTINGS[name]
    weights = {**settings.get('weights', {}), 'control': 1e-3}
    return with_mapping({**settings, 'weights': weights}, max_iterations=2)


_WORDS = {'default': 'our default', 'paper': "the paper's setting"}


def tasks(options: Options) -> list[Task]:
    """Return long runs under both settings."""
    length = 20.0 if options.quick else _LENGTH
    return [
        run_task(
            'planner',
            paths_of(_settings(name), options.path_number(100)),
            _DOGS,
            0.01,
            _GOAL,
            seed,
            length,
            cost=0.3 if options.quick else 7.0,
            sheep=6 if options.quick else 20,
            stop=False,
            snapshots=[t for t in _SNAPSHOTS if t <= length],
        )
        for name, seed in product(_WORDS, options.seed_range(20))
    ]


def draw(results: Results, figures: Path) -> Section:
    """Make the table, the snapshots and the courses."""
    long = results.of('herding', stop=False)
    runs = {name: under(_settings(name), long) for name in _WORDS}
    there = {words: runs[name] for name, words in _WORDS.items() if len(runs[name])}
    head = (
        '', 'arrived', 'time [s]', 'distance afterwards, mean [m]', 'its maximum, mean over seeds',
        'largest', 'held', 'spread afterwards / first, mean', 'its maximum, mean over seeds',
        'largest', 'held',
    )  # fmt: skip
    circling = (
        '', 'dogs from the centre [m]', 'angular speed of a dog [rad/s]',
        'mean turning of a dog, magnitude [rad/s]', 'of all dogs together, magnitude [rad/s]',
        'turns of a dog per 100 s',
    )  # fmt: skip
    values = {
        'seeds': str(len(results.parameter('seed'))),
        'held': table(head, [(words, *_row(found)) for words, found in there.items()]),
        'snapshots': _snapshots(runs['default'], figures),
        'courses': _courses(runs, figures),
        'circling': table(
            circling, [(words, *_circling(found)) for words, found in there.items()]
        ),
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


def _row(runs: Results) -> list[str]:
    after = _after(runs)
    farthest = [each['max_distance'] for each in after]
    widest = [each['max_spread'] / each['initial_spread'] for each in after]
    return [
        str(Fraction.of([run['arrived'] for run in runs])),
        str(Median.of([run['time'] if run['arrived'] else math.inf for run in runs])),
        str(Mean.of([each['mean_distance'] for each in after])),
        str(Mean.of(farthest)),
        f'{max(farthest, default=math.nan):.3f}',
        str(_distance_held(runs)),
        str(Mean.of([each['mean_spread'] / each['initial_spread'] for each in after])),
        str(Mean.of(widest)),
        f'{max(widest, default=math.nan):.2f}',
        str(_spread_held(runs)),
    ]


def _circling(runs: Results) -> list[str]:
    after = _after(runs)
    of_a_dog = [float(np.abs(each['turning']).mean()) for each in after]
    return [
        str(Mean.of([each['dog_distance'] for each in after])),
        str(Mean.of([each['turning_speed'] for each in after])),
        str(Mean.of(of_a_dog)),
        str(Mean.of([abs(float(np.mean(each['turning']))) for each in after])),
        str(Mean.of([100.0 * rate / (2.0 * math.pi) for rate in of_a_dog])),
    ]


def _snapshots(runs: Results, figures: Path) -> str:
    figure, axes = new(3, 2, width=3.4, height=3.2)
    run = runs.by_seed().get(0)
    shots = run['snapshots'] if run else []
    for place in axes.flat[len(shots) :]:
        place.set_axis_off()
    for place, shot in zip(axes.flat, shots, strict=False):
        draw_herd(place, shot['x'], shot['d'], _GOAL)
        middle = np.mean(shot['x'], axis=0)
        radius = float(np.linalg.norm(np.array(shot['d']) - middle, axis=1).mean())
        place.add_patch(Circle(tuple(middle), radius, fill=False, color='black', linewidth=0.8))
        place.set_title(f't = {shot["t"]:g} s', fontsize=9)
    return save(figure, figures / 'stabilisation-snapshots.png')


def _courses(runs: dict[str, Results], figures: Path) -> str:
    figure, axes = new(2, 2, width=4.5, height=2.4)
    for row, name in enumerate(_WORDS):
        for run in runs[name]:
            paths = run['paths']
            axes[row, 0].plot(paths['t'], paths['distance'], color=BLUE, linewidth=0.6, alpha=0.5)
            relative = np.array(paths['spread']) / run['initial_spread']
            axes[row, 1].plot(paths['t'], relative, color=BLUE, linewidth=0.6, alpha=0.5)
        axes[row, 0].axhline(ARRIVAL_DISTANCE, color='black', linestyle='--', linewidth=0.8)
        axes[row, 1].axhline(TOGETHER, color='black', linestyle='--', linewidth=0.8)
        axes[row, 0].set(ylabel='distance [m]', xlabel='time [s]', ylim=(0.0, None))
        axes[row, 1].set(ylabel='spread / first', xlabel='time [s]', ylim=(0.0, None))
    return save(figure, figures / 'stabilisation-courses.png')


def _rows(runs: dict[str, Results]) -> list[Row]:
    rows = []
    for name, words in _WORDS.items():
        after = _after(runs[name])
        if after:
            turning = Mean.of([float(np.abs(each['turning']).mean()) for each in after])
            rows.append(
                Row(
                    f'Figure "simulation", {words}: largest distance after the arrival',
                    'a picture',
                    f'{Mean.of([each["max_distance"] for each in after])} m',
                    f'mean turning of a dog {turning} rad/s; '
                    f'spread held in {_spread_held(runs[name])}',
                )
            )
    return rows


def _goals(runs: Results) -> list[Goal]:
    count = len(runs)
    goals = []
    for text, bound, held in (
        ('distance', f'≤ {_HELD_DISTANCE} m at all times', _distance_held(runs)),
        ('spread', f'≤ {_HELD_SPREAD} times the first at all times', _spread_held(runs)),
    ):
        reached = held.successes == count if count >= 20 else None
        goals.append(
            Goal(f'After the arrival until 250 s, γ = 1e-3: {text}', bound, f'in {held}', reached)
        )
    return goals
