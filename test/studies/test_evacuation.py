# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from herding_ros.studies import evacuation
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.study import Options, Results
from herding_ros.studies.task import Task
from matplotlib.figure import Figure
import pytest


def result_of(task: Task) -> dict[str, Any] | None:
    """Return a made-up result: dogs take 60 s per dog, guides 30 s."""
    given = task.parameters
    lead = given['policy'] == 'planner'
    base = 60.0 if given.get('crowd') == 'cohesive' else 30.0
    time = base / given['dogs'] + given['seed'] if lead else None
    return {
        'arrived': lead, 'time': time, 'duration': time or 400.0, 'max_spread': 0.3,
        'closest': 0.04 if lead else 0.6, 'final_distance': 0.04, 'dogs_run': 2.0, 'energy': 0.1,
        'paths': {
            'centre': [[0, 0], [0.5, 0.5]], 'dogs': [[[0, 0]] * given['dogs']] * 2,
            'first': [[0, 0]], 'last': [[0.5, 0.5]],
        },
    }  # fmt: skip


def test_page_distinguishes_guides_dogs_and_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Figure, 'savefig', lambda *_, **__: None)
    tasks = evacuation.tasks(Options(seeds=3))
    found = [(task, json.loads(json.dumps(result_of(task)))) for task in tasks]
    section = evacuation.draw(Results(found), tmp_path)
    medians = {
        tuple(cells[:2]): cells[3].split()[0]
        for line in section.values['table'].splitlines()[2:]
        for cells in [[cell.strip() for cell in line.strip('|').split('|')]]
    }
    assert medians['2', 'dogs'] == '31.0'
    assert medians['2', 'guides'] == '16.0'
    assert medians['0', 'nobody'] == 'never'
    assert len(medians) == 2 * 5 + 1
    assert [row.ours.split()[0] for row in section.rows] == [
        '31.0',
        '16.0',
        '11.0',
        '8.50',
        '7.00',
    ]
    assert section.values['failures'] == ''


def test_all_herd_the_same_crowds() -> None:
    tasks = evacuation.tasks(Options(seeds=4))
    seeds: dict[str, list[int]] = {}
    for task in tasks:
        rest = {key: value for key, value in task.parameters.items() if key != 'seed'}
        seeds.setdefault(json.dumps(rest), []).append(task.parameters['seed'])
    assert all(each == [0, 1, 2, 3] for each in seeds.values())
    assert len(seeds) == 2 * 5 + 1


def test_guides_start_ahead_and_are_followed() -> None:
    """The same flock in the same noise: one guide leads where one dog has only begun."""
    given: dict[str, Any] = {
        'sheep': 9, 'dogs': 1, 'sigma': 0.01, 'goal': [0.5, 0.5], 'seed': 1, 'time_limit': 40.0,
        'stop': True, 'every': 10.0, 'settings': {},
    }  # fmt: skip
    guide, dog = (
        EXPERIMENTS['herding']('planner', crowd=crowd, **given) for crowd in ('guided', 'cohesive')
    )
    assert guide['paths']['first'] == dog['paths']['first']
    (ahead,), (behind,) = (each['paths']['dogs'][0] for each in (guide, dog))
    assert sum(ahead) > 1.0 > -1.0 > sum(behind)
    start = guide['paths']['distance'][0]
    assert guide['closest'] < 0.5 * start < dog['closest']
    assert guide['max_spread'] <= 1.1 * guide['initial_spread']
