# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
import json
import math
from pathlib import Path
from typing import Any

from herding_ros.control.closed_loop import closed_loop
from herding_ros.control.parameters import Control, Horizon, Mapping, PAPER
from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import World
from herding_ros.studies import common_noise
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.experiments.case import Case
from herding_ros.studies.runs import PLAIN, settings_of
from herding_ros.studies.study import Options, Results
import numpy as np
import pytest

SHORT = Horizon(length=8.0, accepted=4.0)
CONTROL = replace(PAPER, horizon=SHORT, mapping=Mapping(paths=20, max_iterations=2, tolerance=0.0))
HERD = {'sheep': 9, 'dogs': 2, 'sigma': 0.03, 'seed': 1}


def run(share: float, **changes: Any) -> dict[str, Any]:
    given = {**HERD, 'common_noise': share, 'judge_paths': 200, 'trace': False} | changes
    return EXPERIMENTS['common_noise'](**given, control=settings_of(CONTROL))


def test_individual_noise_is_that_of_the_other_studies() -> None:
    window = EXPERIMENTS['window'](
        **HERD, judge_paths=200, trace=False, control=settings_of(CONTROL)
    )
    found = run(0.0)
    for key in ('before', 'after', 'iterations'):
        assert found[key] == window[key]
    assert found['uncertainty'] < 0.5 * window['uncertainty']  # since the paths are mirrored


def test_the_case_has_the_share_asked_for() -> None:
    assert Case(9, 2, 0.03, 1, CONTROL, 0.25).crowd == Crowd(noise=0.03, common_noise=0.25)


def test_a_single_path_wanders_as_a_free_flock_does_nearly() -> None:
    """Its centre has the variance (c + (1 - c) / N) of that of a sheep, and dogs to mind."""
    steps, dt, alpha = 160, 0.05, 0.5
    # Response of the position to an increment of the velocity after j more steps.
    response = dt * np.cumsum((1.0 - alpha * dt) ** np.arange(steps - 1))
    variances = 0.03**2 * dt * np.concatenate([[0.0, 0.0], np.cumsum(np.square(response))])
    free = math.sqrt(2.0 * dt * variances.sum())
    for share in (0.0, 0.5, 1.0):
        expected = math.sqrt(share + (1.0 - share) / 9.0) * free
        assert run(share)['wander'] == pytest.approx(expected, rel=0.3)


def test_mirrored_judges_agree_with_plain_ones() -> None:
    each = Case(9, 2, 0.03, 1, CONTROL, 1.0)
    u = each.deterministic.plan.u
    (plain, rough), (mirrored, fine) = (each.judge(u, 2000, flag) for flag in (False, True))
    assert fine < 0.4 * rough
    difference = math.sqrt(each.coarse.dt * np.square(plain - mirrored).sum())
    assert difference < 3.0 * rough


def test_traces_start_where_the_flock_does_and_part() -> None:
    trace = run(1.0, trace=True)['trace']
    singles = np.array(trace['singles'])
    assert singles.shape == (20, 17, 2)
    np.testing.assert_allclose(singles[:, 0], np.tile(trace['target'][0], (20, 1)), atol=1e-5)
    assert np.std(singles[:, -1], axis=0).min() > 0.02


def made_up() -> Results:
    entries = []
    for task in common_noise.tasks(Options(seeds=3)):
        given = task.parameters
        share, seed = given['common_noise'], given['seed']
        if task.kind == 'herding':
            time = (
                None if share and given['settings'] == PLAIN and seed == 0 else 40.0 + seed + share
            )
            run = {'arrived': time is not None, 'time': time, 'max_spread': 0.5 - 0.25 * share}
            entries.append((task, run))
            continue
        result: dict[str, Any] = {
            'iterations': 4, 'before': 0.125, 'after': 0.01, 'judged_before': 0.08,
            'judged_after': 0.008 * (1.0 + share) + 0.001 * (seed - 1), 'uncertainty': 0.001,
            'wander': 0.2 + 0.8 * share + 0.02 * (seed - 1),
        }  # fmt: skip
        if given['control'] == common_noise._CONTROLS['multilevel']:
            result['judged_after'] = 0.004
        if given['trace']:
            result['trace'] = {'target': [[0, 0], [1, 1]], 'singles': [[[0, 0], [1, share]]] * 2}
        entries.append((task, json.loads(json.dumps(result))))
    return Results(entries)


def test_page_shows_the_results(tmp_path: Path) -> None:
    section = common_noise.draw(made_up(), tmp_path)
    lines = section.values['table'].splitlines()
    assert len(lines) == 2 + 4 * len(common_noise.SHARES)
    (other,) = [each for each in lines if each.startswith('| 1,000 multilevel | 0.25 |')]
    assert '| 4.00e-3 |' in other
    (line,) = [each for each in lines if each.startswith('| 100 plain | 1 |')]
    assert '| 0.01600 ± 0.00058 | 0.2000 ± 0.0072 | 0.1000 ± 0.0012 | 1.000 ± 0.012 |' in line
    assert (tmp_path / 'common_noise.png').stat().st_size > 10_000
    assert len(section.rows) == 16
    assert section.values['seeds'] == '3'
    *_, multilevel, plain, without = section.values['runs'].splitlines()
    assert multilevel.startswith('| 0.02 | 1 | mapped, multilevel | 3 of 3 ')
    assert plain.startswith('| 0.02 | 1 | mapped, plain paths | 2 of 3 ')
    assert without.startswith('| 0.02 | 1 | not mapped | 3 of 3 ')
    assert without.endswith('| 42.0 (less to more) | 0.250 |')


def test_the_same_flocks_under_every_share() -> None:
    tasks, seeds = common_noise.tasks(Options(seeds=2)), dict[str, list[int]]()
    for task in tasks:
        rest = {k: v for k, v in task.parameters.items() if k not in ('seed', 'trace')}
        seeds.setdefault(json.dumps([task.kind, rest]), []).append(task.parameters['seed'])
    assert all(each == [0, 1] for each in seeds.values())
    assert len(seeds) == 2 * 2 * len(common_noise.SHARES) + 3 * 2 * 2
    assert sum(task.parameters.get('trace', False) for task in tasks) == 2


def test_a_run_under_common_noise_is_that_of_the_closed_loop() -> None:
    (task,) = [
        each
        for each in common_noise.tasks(Options(quick=True))
        if each.kind == 'herding'
        and each.parameters['common_noise'] == 1.0
        and each.parameters['settings'].get('mapping.max_iterations') == 0
    ]
    found = EXPERIMENTS['herding'](**task.parameters)
    crowd, control = Crowd(common_noise=1.0), Control(mapping=Mapping(paths=8, max_iterations=0))
    track = closed_loop(crowd, World(sheep=6, dogs=5), control, np.array([0.5, 0.5]), 10.0)
    np.testing.assert_allclose(found['paths']['last'], track.x[-1], atol=5e-5)
