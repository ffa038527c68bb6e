# SPDX-License-Identifier: Apache-2.0
"""Fences, gates and pens: whether flocks get there, and nobody runs into a wall."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from herding_ros.model.field import read_field
from herding_ros.report.markdown import Goal, table
from herding_ros.report.statistics import Fraction, Median
from herding_ros.report.style import draw_goal, draw_herd, draw_paths, draw_walls, new, save
import numpy as np

from .runs import of_twenty
from .study import grid, Options, Results, Section
from .task import Task

TITLE = 'Fences, gates and pens'
DESCRIPTION = 'fields with walls: a pen, a corner, an island, a paddock, a meadow of 60 m'

_FIELDS = {'pen': 300.0, 'corner': 300.0, 'island': 300.0, 'paddock': 300.0, 'meadow': 200.0}
"""Time limits [s]."""
_DOGS = (3, 4, 5)
_POLICIES = {'planner': 'ours', 'strombom': 'heuristic'}
_ENOUGH = 18
"""Of 20 runs so many have to arrive."""


def tasks(options: Options) -> list[Task]:
    """Return runs in each field with 3, 4 and 5 dogs, by the controller and the heuristic."""
    quick = options.quick
    found = []
    for case in grid(
        seed=options.seed_range(20), dogs=_DOGS[: 1 if quick else None], field=list(_FIELDS),
        policy=list(_POLICIES),
    ):  # fmt: skip
        parameters = {**case, 'time_limit': 2.0 if quick else _FIELDS[case['field']]}
        cost = 5.0
        if case['policy'] == 'planner':
            parameters['paths'] = options.path_number(100)
            cost = 60.0
        found.append(Task('fields', parameters, 0.02 * cost if quick else cost))
    return found


def draw(results: Results, figures: Path) -> Section:
    """Make the table and the pictures."""
    for name in _FIELDS:
        _draw_run(name, results.of('fields', field=name, policy='planner', dogs=3), figures)
    values = {'runs': _table(results), 'seeds': results.seeds}
    return Section(values, goals=_goals(results))


def _table(results: Results) -> str:
    return table(
        {
            'field': name,
            'dogs': dogs,
            'by': words,
            'arrivals': Fraction.of(found.values('arrived')),
            'median time [s]': Median.of(
                [run['time'] if run['arrived'] else math.inf for run in found]
            ),
            'sheep through a wall': sum(found.values('crossings')),
            'steps of dogs into one': sum(found.values('stops')),
            'dog–wall at least [m]': float(min(found.values('gap'))),
            'dog–dog at least [m]': float(min(found.values('closest_dogs'))),
        }
        for name in _FIELDS
        for dogs in _DOGS
        for policy, words in _POLICIES.items()
        if len(found := results.of('fields', field=name, dogs=dogs, policy=policy))
    )


def _goals(results: Results) -> list[Goal]:
    goals = []
    for name in _FIELDS:
        for dogs in _DOGS:
            ours = results.of('fields', field=name, dogs=dogs, policy='planner')
            arrivals = Fraction.of(ours.values('arrived'))
            goals += of_twenty(f'{name}, {dogs} dogs', arrivals, _ENOUGH)
    ours = results.of('fields', policy='planner')
    if len(ours):
        bumps = sum(ours.values('crossings')) + sum(ours.values('stops'))
        what = 'steps of sheep through a wall, or of dogs into one'
        goals.append(Goal(what, 'none', bumps, bumps == 0 if len(ours) >= 20 else None))
    return goals


def _draw_run(name: str, runs: Results, figures: Path) -> None:
    """Draw the run with seed 0 at some instants, with the paths since the picture before."""
    figure, axes = new(5, 1, width=2.9, height=2.4)
    run: dict[str, Any] = runs.by_seed().get(0) or {'snapshots': []}
    field, _ = read_field(name)
    before = -math.inf
    for place, shot in zip(axes.flat, run['snapshots'], strict=False):
        t = np.array(run['paths']['t'])
        since = (before <= t) & (t <= shot['t'])
        dogs, centre = (np.array(run['paths'][each])[since] for each in ('dogs', 'centre'))
        draw_walls(place, field)
        draw_paths(place, dogs, centre)
        draw_herd(place, shot['x'], shot['d'], size=2.0)
        draw_goal(place, field.place)
        place.set_title(f'{name}, t = {shot["t"]:.0f} s', fontsize=9)
        before = shot['t']
    save(figure, figures / f'fields-{name}.png')
