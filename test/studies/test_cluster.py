# SPDX-License-Identifier: Apache-2.0
"""The same tasks on a Dask cluster of two worker processes."""

from __future__ import annotations

from collections.abc import Iterator
import importlib
from pathlib import Path
from typing import Any

from herding_ros.studies import cli
from herding_ros.studies.runner import compute, work
from herding_ros.studies.task import Task
import pytest


@pytest.fixture(scope='module')
def scheduler() -> Iterator[str]:
    distributed = pytest.importorskip('distributed')
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        yield cluster.scheduler_address


def symmetric(seed: int) -> Task:
    return Task(
        'symmetry',
        {'pairs': 3, 'dog_pairs': 1, 'motion': 'both', 'duration': 5.0, 'dt': 0.01, 'seed': seed},
    )


def run(seed: int) -> Task:
    parameters: dict[str, Any] = {
        'policy': 'planner',
        'settings': {'mapping.paths': 20},
        'sheep': 6,
        'dogs': 2,
        'sigma': 0.02,
        'goal': [0.5, 0.5],
        'seed': seed,
        'time_limit': 12.0,
        'stop': True,
        'every': 1.0,
    }
    return Task('herding', parameters)


def test_cluster_gives_the_same_results_and_reports_failures(scheduler: str) -> None:
    tasks = [*(symmetric(seed) for seed in range(4)), run(0), run(1), Task('herding', {'seed': 1})]
    found = {outcome.task.key: outcome for outcome in compute(tasks, 1, scheduler)}
    assert len(found) == len(tasks)
    for task in tasks[:4]:
        assert found[task.key].result == work(task, task.key).result
    for task in tasks[4:6]:
        here, there = work(task, task.key).result, found[task.key].result
        assert here is not None
        assert there is not None
        assert there['paths'] == here['paths']
        assert there['plans']['iterations'] == here['plans']['iterations']
    assert 'TypeError' in found[tasks[6].key].error


def test_study_on_a_cluster(scheduler: str, tmp_path: Path) -> None:
    out = ['--quick', '--out', str(tmp_path)]
    assert cli.main(['symmetry', *out, '--scheduler', scheduler]) == 0
    assert len(list((tmp_path / 'results').rglob('*.json'))) == 16


def test_a_worker_with_other_code_is_refused() -> None:
    outcome = work(symmetric(0), 'another key')
    assert outcome.result is None
    assert 'another version' in outcome.error


def test_without_dask_the_error_names_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(importlib, 'import_module', missing)
    out = ['--quick', '--out', str(tmp_path)]
    assert cli.main(['symmetry', *out, '--scheduler', 'tcp://127.0.0.1:1']) == 1
    assert 'requirements-cluster.txt' in capsys.readouterr().err
