# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import Any

from herding_ros.control.closed_loop import ClosedLoopRun
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.experiments.measures import course, measures
import numpy as np
import pytest

GOAL = np.array([0.5, 0.5])
SMALL: dict[str, Any] = {'horizon.length': 8.0, 'horizon.accepted': 4.0, 'mapping.paths': 20}


def run(policy: str, **changes: Any) -> dict[str, Any]:
    given = {
        'sheep': 9,
        'dogs': 2,
        'sigma': 0.02,
        'goal': [0.5, 0.5],
        'seed': 1,
        'time_limit': 6.0,
        'stop': True,
        'every': 1.0,
        'settings': {},
    } | changes
    return EXPERIMENTS['herding'](policy, **given)


def test_a_run_can_go_on_after_the_arrival() -> None:
    given = {'dogs': 3, 'sigma': 0.01, 'settings': SMALL, 'goal': [0.2, 0.2], 'seed': 2}
    short, long = (run('planner', time_limit=20.0, stop=stop, **given) for stop in (True, False))
    assert short['arrived']
    assert short['time'] == long['time'] == short['duration']
    assert long['duration'] == 20.0
    assert short['from_home'] is None
    assert long['from_home']['max_distance'] >= long['from_home']['mean_distance'] > 0.0


def test_sheep_may_be_left_behind() -> None:
    usual, left = (run('none', time_limit=0.1, strays=strays) for strays in (0, 2))
    assert left['initial_spread'] < usual['initial_spread']
    assert left['paths']['spread'][0] == pytest.approx(left['initial_spread'], abs=1e-4)
    assert left['paths']['last'] == usual['paths']['last']


def test_measures_of_a_run_that_is_known() -> None:
    """Two dogs circle a ring of sheep, one each way, while the ring moves to the goal."""
    period, speed, steps = 0.1, 0.04, 100
    t = period * np.arange(steps + 1)
    middle = np.stack([1.0 - 0.01 * t, 0.0 * t], axis=1)
    angle = 2.0 * np.pi * np.arange(6) / 6
    ring = 0.3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x = middle[:, None] + ring
    turn = np.stack([0.2 * t, -0.1 * t], axis=1)
    d = middle[:, None] + np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    u = np.full((steps, 2, 2), [speed, 0.0])
    track = ClosedLoopRun(t, x, d, u, 50)
    found = measures(track, np.array([0.0, 0.0]), period)
    assert found['arrived']
    assert found['time'] == 5.0
    assert found['initial_spread'] == pytest.approx(0.3)
    assert found['max_spread'] == pytest.approx(0.3)
    assert found['final_distance'] == pytest.approx(0.9)
    assert found['dogs_run'] == pytest.approx(2 * speed * 10.0)
    assert found['energy'] == pytest.approx(2 * speed**2 * 10.0)
    left = np.concatenate([x, np.full((steps + 1, 1, 2), 9.0)], axis=1)
    whole = ClosedLoopRun(t, left, d, u, 50)
    assert measures(whole, np.array([0.0, 0.0]), period)['max_spread'] > 3.0
    assert measures(whole, np.array([0.0, 0.0]), period, strays=1) == found
    paths = course(whole, np.array([0.0, 0.0]), 10, strays=1)
    assert paths['last'][-1] == [9.0, 9.0]
    del paths['first'], paths['last']
    assert paths.items() <= course(track, np.array([0.0, 0.0]), 10).items()
    assert found['from_home']['turning'] == pytest.approx([0.2, -0.1])
    assert found['from_home']['turning_speed'] == pytest.approx(0.15)
    assert found['from_home']['max_distance'] == pytest.approx(0.95)
    assert found['from_home']['dog_distance'] == pytest.approx(1.0)
    stored = course(ClosedLoopRun(t, x, d, u, 50), np.array([0.0, 0.0]), 30)
    assert stored['t'] == [0.0, 3.0, 6.0, 9.0, 10.0]
    np.testing.assert_allclose(stored['centre'], middle[[0, 30, 60, 90, 100]], atol=5e-5)


def test_all_policies_herd_the_same_flock_under_the_same_noise() -> None:
    """Dogs that nobody notices change nothing, so all that differs is what dogs do."""
    first = [run(policy)['paths']['first'] for policy in ('planner', 'strombom', 'none')]
    assert first[0] == first[1] == first[2]
    alone = run('none', dogs=1)['paths']['last']
    assert run('none', dogs=4)['paths']['last'] == alone
    assert run('strombom')['paths']['last'] != alone


def test_snapshots_are_those_of_their_instants() -> None:
    found = run('none', snapshots=[0.0, 3.0, 50.0])
    assert [shot['t'] for shot in found['snapshots']] == [0.0, 3.0]
    assert found['snapshots'][0]['x'] == found['paths']['first']


def test_unknown_policy_is_refused() -> None:
    with pytest.raises(ValueError, match="must be 'planner', 'strombom' or 'none', got 'wolf'"):
        run('wolf')
