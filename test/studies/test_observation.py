# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
import json
import math
from pathlib import Path
from typing import Any

from herding_ros.control.closed_loop import as_policy, closed_loop
from herding_ros.control.lockstep_pilot import LockstepPilot
from herding_ros.control.parameters import Control, Horizon, Mapping, Sensor
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import Simulation, World
from herding_ros.studies import observation
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.experiments.herding import Watched
from herding_ros.studies.runs import settings_of
from herding_ros.studies.study import Options, Results
import numpy as np
import pytest

GOAL = np.array([0.5, 0.5])
SMALL = Control(horizon=Horizon(length=8.0, accepted=4.0), mapping=Mapping(paths=20))


def run(noise: float, control: Control = SMALL, **changes: Any) -> dict[str, Any]:
    given: dict[str, Any] = {
        'policy': 'planner',
        'sheep': 9,
        'dogs': 3,
        'sigma': 0.01,
        'goal': [0.5, 0.5],
        'noise': noise,
        'seed': 1,
        'time_limit': 8.0,
        'settings': settings_of(control),
    }
    return EXPERIMENTS['herding'](**(given | changes))


def filtered(noise: float) -> Control:
    return Control(horizon=SMALL.horizon, mapping=SMALL.mapping, sensor=Sensor(noise, noise))


def test_a_run_is_that_of_the_closed_loop() -> None:
    found = run(0.05, filtered(0.05), time_limit=20.0)
    world = World(sheep=9, dogs=3, seed=1, position_noise=0.05, velocity_noise=0.05)
    track = closed_loop(Crowd(), world, filtered(0.05), GOAL, 20.0)
    assert found['arrived'] == track.arrived
    assert found['duration'] == pytest.approx(track.t[-1])
    np.testing.assert_allclose(found['paths']['last'], track.x[-1], atol=5e-5)
    offset = track.x[-1] - track.x[-1].mean(axis=0)
    assert found['final_spread'] == pytest.approx(math.sqrt(np.square(offset).sum() / 9))


def test_errors_are_those_of_observations_and_of_estimates() -> None:
    exact, raw, better = (
        run(0.0)['errors'],
        run(0.05)['errors'],
        run(0.05, filtered(0.05))['errors'],
    )
    for quantity in ('position', 'velocity', 'dog'):
        # Sheep are observed in single precision.
        assert exact['observed'][quantity] == exact['estimated'][quantity] < 1e-7
        assert raw['observed'][quantity] == raw['estimated'][quantity]
        assert raw['observed'][quantity] == pytest.approx(0.05, rel=0.1)
        assert better['observed'][quantity] == pytest.approx(0.05, rel=0.1)
        assert better['estimated'][quantity] < 0.6 * better['observed'][quantity]


def test_errors_are_measured_against_the_state_at_that_instant() -> None:
    simulation = Simulation(Crowd(), World(sheep=4, dogs=2, seed=3), GOAL)
    pilot = LockstepPilot(RecedingHorizon(Crowd(), SMALL, GOAL), 2)
    watched = Watched(as_policy(pilot, []), simulation, pilot)
    assert set(watched.errors()['observed'].values()) == {0.0}
    squares = []
    for k in range(3):
        observed = simulation.observe().state
        squares.append(np.square(observed.x - simulation.state.x).mean())
        simulation.advance(watched(observed, 0.1 * k))
    assert watched.errors()['observed']['position'] == pytest.approx(math.sqrt(np.mean(squares)))


def test_without_velocities_none_is_used() -> None:
    """Velocities are estimated, far better than two noisy positions tell them."""
    sensor = replace(SMALL, sensor=Sensor(position_noise=0.05))
    found = run(0.05, sensor, time_limit=10.0, velocities=False)
    assert found['errors']['estimated']['velocity'] < 0.1 * math.sqrt(2.0) * 0.05 / 0.1
    whole = run(0.05, filtered(0.05), time_limit=10.0)
    assert found['errors']['estimated']['velocity'] > whole['errors']['estimated']['velocity']
    with pytest.raises(ValueError, match=r'position_noise must be above 0 where sheep have no'):
        run(0.05, velocities=False)


def results_of(
    tmp_path: Path,
    times: dict[tuple[int, float, float], list[float | None]],
    alone: list[float | None] | None = None,
) -> Results:
    """Return made-up results of the study by dogs, noise and expected noise; None: no arrival.

    alone: times where velocities are not seen.
    """
    entries = []
    for task in observation.tasks(Options()):
        given = task.parameters
        expected = given['settings'].get('sensor.position_noise', 0.0)
        given_times = times.get((given['dogs'], given['noise'], expected))
        if not given.get('velocities', True):
            given_times = alone
        if given_times is None or given['seed'] >= len(given_times):
            continue
        time = given_times[given['seed']]
        errors = {'position': 0.3 * expected, 'velocity': 0.2 * expected, 'dog': 0.25 * expected}
        observed = dict.fromkeys(errors, given['noise'])
        result = {
            'arrived': time is not None, 'time': time, 'duration': time or 400.0,
            'max_spread': 0.3, 'closest': 0.04, 'final_distance': 0.04, 'final_spread': 0.25,
            'dogs_run': 2.0, 'energy': 0.1, 'errors': {'observed': observed, 'estimated': errors},
            'paths': {'dogs': [[[0, 0]] * given['dogs']]},
        }  # fmt: skip
        entries.append((task, json.loads(json.dumps(result))))
    return Results(entries)


def test_page_shows_the_results(tmp_path: Path) -> None:
    exact = [50.0 + k for k in range(20)]
    found = results_of(
        tmp_path,
        {
            (2, 0.0, 0.0): list(exact),
            (2, 0.05, 0.0): [None, None, *(2.0 * time for time in exact[2:])],
            (2, 0.05, 0.05): [1.05 * time for time in exact],
            (2, 0.05, 0.1): [1.2 * time for time in exact],
        },
    )
    section = observation.draw(found, tmp_path)
    paired = section.values['paired'].splitlines()[-1]
    assert paired == '| 2 | 0.05 | +100 ± 0 (18) | +5 ± 0 (20) |'
    assert '| 2 | 0.05 | 0.0500 | 0.0150 | 0.0500 | 0.0100 |' in section.values['errors']
    assert '| 2 | 0.1 | 20 of 20' in section.values['misjudged']
    assert section.values['failures'].count('| 0.05 | 0 | 2 |') == 2
    reached = [goal.reached for goal in section.goals]
    # Nothing is known of five dogs, and of positions alone.
    assert reached == [True, True, None, None, None, None]
    (row,) = [row for row in section.rows if row.ours.startswith('62')]
    assert '18 of 20' in row.remark


def test_goals_can_be_missed(tmp_path: Path) -> None:
    exact = [50.0 + k for k in range(20)]
    slow: list[float | None] = [None, *(1.2 * time for time in exact[1:])]
    found = results_of(tmp_path, {(5, 0.0, 0.0): list(exact), (5, 0.05, 0.05): slow})
    goals = observation.draw(found, tmp_path).goals
    assert [goal.reached for goal in goals] == [None, None, False, False, None, None]


@pytest.mark.parametrize(
    ('late', 'lost', 'reached'),
    [(1.1, 1, [True, True]), (1.2, 2, [False, False]), (1.2, 0, [True, False])],
)
def test_positions_alone_are_compared_with_whole_states(
    tmp_path: Path, late: float, lost: int, reached: list[bool]
) -> None:
    times = [50.0 + k for k in range(20)]
    alone: list[float | None] = [None] * lost + [late * time for time in times[lost:]]
    found = results_of(tmp_path, {(3, 0.05, 0.05): list(times)}, alone)
    section = observation.draw(found, tmp_path)
    assert [goal.reached for goal in section.goals][-2:] == reached
    change = f'| +{round(100.0 * (late - 1.0))} ± 0 ({20 - lost}) |'
    assert change in section.values['alone'].splitlines()[-1]
    assert section.values['alone_failures'].count('| positions |') == lost
    (row,) = section.rows
    assert row.what.startswith('Positions alone')
    assert 'velocities too: 59.5 (' in row.remark


def test_the_same_flocks_with_and_without_filter() -> None:
    seeds: dict[str, list[int]] = {}
    for task in observation.tasks(Options(seeds=3)):
        rest = {key: value for key, value in task.parameters.items() if key != 'seed'}
        seeds.setdefault(json.dumps(rest), []).append(task.parameters['seed'])
    assert all(each == [0, 1, 2] for each in seeds.values())
    assert len(seeds) == 2 * (1 + 2 * 3 + 2) + 2  # and two ways to see with three dogs
