# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from typing import Any

from herding_ros.studies import strangers
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.study import Options, Results, Section
from herding_ros.studies.task import Task
from matplotlib.figure import Figure
import numpy as np
import pytest


def result_of(task: Task) -> dict[str, Any]:
    """Return a made-up result: the rule takes 50 s, ours 40 s, both with seed; others never.

    With a loss ours fails for half of the seeds, in a gust the rule does; with 28 targets
    nobody succeeds.
    """
    given, seed = task.parameters, task.parameters['seed']
    settings = given['settings']
    time = None if settings else seed + (50.0 if given['policy'] == 'rule' else 40.0)
    failing = {'rule': 'gust', 'planner': 'loss'}[given['policy']]
    if (failing in given['given'] and seed % 2) or given['given'].get('targets') == 28:
        time = None
    return {
        'arrived': time is not None, 'time': time, 'duration': time or 100.0, 'max_spread': 0.3,
        'dogs_run': 6.0, 'dogs': 3, 'energy': 0.1, 't': [0.0, 50.0], 'chi': [0.0, 0.5],
        'final_chi': 1.0,
    }  # fmt: skip


Drawn = tuple[Section, list[Figure]]


@pytest.fixture(scope='module')
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    """Return the section of made-up results, and its figures."""
    figures: list[Figure] = []
    tasks = strangers.tasks(Options())
    found = [(task, json.loads(json.dumps(result_of(task)))) for task in tasks]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, 'savefig', lambda figure, *_, **__: figures.append(figure))
        return strangers.draw(Results(found), tmp_path_factory.mktemp('figures')), figures


def cells(table: str) -> dict[tuple[str, ...], list[str]]:
    rows = [
        [cell.strip() for cell in line.strip('|').split(' | ')] for line in table.splitlines()[2:]
    ]
    return {tuple(row[:2]): row[2:] for row in rows}


def test_tables_tell_plants_and_controllers_apart(drawn: Drawn) -> None:
    section, _ = drawn
    herds = cells(section.values['herds'])
    assert len(herds) == 3 * 3
    arrivals, median, mean, *_ = herds['1 dog, 25 sheep', 'own rule']
    assert arrivals.startswith('20 of 20')
    assert median.startswith('59.5 ')
    assert mean.startswith('59.5 ')
    assert herds['1 dog, 25 sheep', "ours in the paper's setting"][1].startswith('never')
    truths = cells(section.values['truths'])
    assert len(truths) == 17 * 3
    assert truths['30 % of the commands lost', 'ours'][0].startswith('10 of 20')


def test_goals_are_those_of_the_rule_on_the_same_seeds(drawn: Drawn) -> None:
    goals = {goal.text: goal for goal in drawn[0].goals}
    assert goals['2 herders, 7 targets: arrivals'].reached
    assert goals['2 herders, 7 targets: mean time'].reached
    assert goals['3 dogs, as told'].bound == '≥ 100 %'
    assert not goals['30 % of the commands lost'].reached
    assert goals['a gust of 0.3 m after 20 s'].bound == '≥ 85 %'
    assert goals['a gust of 0.3 m after 20 s'].reached
    assert '5 dogs, as told' not in goals


def test_herdability_is_mapped_over_herders_and_targets(drawn: Drawn) -> None:
    axes = [axes for figure in drawn[1] for axes in figure.axes]
    maps = [each.images[0].get_array() for each in axes if each.images]
    assert len(maps) == 2
    for success in maps:
        np.testing.assert_array_equal(success, np.tile([1.0, 1.0, 1.0, 0.0], (4, 1)))


def test_all_controllers_meet_the_same_herds() -> None:
    seeds: dict[str, list[int]] = {}
    for task in strangers.tasks(Options(seeds=3)):
        given = task.parameters
        what = json.dumps([given['plant'], given['given'], given['policy'], given['settings']])
        seeds.setdefault(what, []).append(given['seed'])
    assert all(each == [0, 1, 2] for each in seeds.values())


@pytest.mark.parametrize(
    ('plant', 'given', 'limit'),
    [
        ('targets', strangers._on_map(1, 2), 1.0),
        ('flock', {}, 4.0),
        ('truth', strangers._world(2, {'delay': 0.5, 'diversity': 0.5}), 1.0),
    ],
)
def test_a_run_in_numbers(plant: str, given: dict[str, Any], limit: float) -> None:
    runs = [
        EXPERIMENTS['strangers'](plant, given, policy, {}, seed=1, time_limit=limit, paths=8)
        for policy in ('rule', 'planner')
    ]
    for run in runs:
        assert run['duration'] == pytest.approx(limit)
        assert len(run['t']) == len(run['chi'])
        assert 0.0 < run['dogs_run'] < np.inf
        assert run['chi'][-1] == pytest.approx(run['final_chi'])
    assert runs[0]['chi'][0] == runs[1]['chi'][0]
    assert runs[0]['initial_spread'] == runs[1]['initial_spread']


def test_an_unknown_policy_is_refused() -> None:
    with pytest.raises(ValueError, match="policy must be 'rule' or 'planner', got 'wolf'"):
        EXPERIMENTS['strangers']('flock', {}, 'wolf', {}, seed=0, time_limit=1.0)
