# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from herding_ros.control.parameters import Control
from herding_ros.model.crowd import Crowd
from herding_ros.model.flock import centre
from herding_ros.model.noise import noise_paths
from herding_ros.model.scenario import GOAL, initial_herd
from herding_ros.studies import mean_field as study
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.experiments.window import mirrored as mirrored_paths
from herding_ros.studies.study import Options, Results
from herding_ros.studies.task import Task
import numpy as np
import pytest

HERD = {'dogs': 5, 'seed': 3}
SMALL = {
    'horizon.length': 10.0,
    'horizon.accepted': 5.0,
    'mapping.paths': 96,
    'mapping.max_iterations': 2,
    'mapping.tolerance': 1e-5,
    'coarse.markers': 32,
}


def test_error_from_the_density_begins_with_that_of_the_drawn_flock() -> None:
    found = EXPERIMENTS['mean_field_convergence'](
        sheep=70, duration=0.1, dt=0.05, markers=[16, 64], density_markers=64, **HERD
    )
    drawn = centre(initial_herd(70, 5, np.array(GOAL), np.random.default_rng(3)).x)
    assert found['density']['centre'] == pytest.approx(np.linalg.norm(drawn), rel=1e-3)
    for errors in found['flock'].values():
        assert errors['centre'] < 1e-6  # it starts from the flock's own centre
        assert errors['spread'] < 1e-4


def test_mapping_lowers_the_error_on_paths_that_it_has_not_seen() -> None:
    found = EXPERIMENTS['mean_field_mapping'](
        sheep=80, sigma=0.05, judge_paths=64, control=SMALL, **HERD
    )
    assert 0 < found['iterations'] <= 2
    assert found['after'] < 0.5 * found['before']
    assert found['judged_after'] < found['judged_before']
    assert set(found['seconds']) == {'coarse', 'fine', 'extraction', 'total'}


def test_mirrored_paths_cancel_and_keep_their_variance() -> None:
    sheep, sigma, dt = 5, 0.3, 0.04
    noise = noise_paths(np.random.default_rng(0), Crowd(noise=sigma), sheep, dt, 50, 30)
    mirrored = mirrored_paths(noise)
    paths = np.array([mirrored.path(i) for i in range(mirrored.paths)])
    assert len(paths) == 32
    assert abs(paths.sum(axis=0)).max() < 1e-15
    assert abs(paths[:8].sum(axis=0)).max() > 0.1
    assert np.std(paths[..., :sheep]) == pytest.approx(sigma * np.sqrt(dt), rel=0.03)


def test_replan_times_every_flock() -> None:
    found = EXPERIMENTS['mean_field_replan'](flocks=[5, 300], dogs=2, seed=0, iterations=1)
    assert set(found) == {'5', '300'}
    assert all(seconds > 0.0 for each in found.values() for seconds in each.values())


def test_rate_is_the_slope_of_the_errors() -> None:
    """Of errors that fall like 1 / N, and like their square."""
    tasks = [
        task for task in study.tasks(Options(seeds=2)) if task.kind == 'mean_field_convergence'
    ]

    def result(task: Task) -> dict[str, object]:
        error = 3.0 / task.parameters['sheep']
        return {'flock': {'512': {'centre': error, 'spread': error**2}}}

    results = Results([(task, result(task)) for task in tasks])
    assert study._rate(results, 'flock', '512', 'centre') == pytest.approx(-1.0, rel=1e-9)
    assert study._rate(results, 'flock', '512', 'spread') == pytest.approx(-2.0, rel=1e-9)


def test_windows_are_planned_for_in_both_ways() -> None:
    for task in study.tasks(Options()):
        if task.kind == 'mean_field_mapping':
            markers = task.parameters['control']['coarse.markers']
            way = 'all sheep' if 2 * markers >= task.parameters['sheep'] else 'mean-field limit'
            assert markers == study._COARSE[way]
    assert study._COARSE['mean-field limit'] == Control().coarse.markers
