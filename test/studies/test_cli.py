# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time
from typing import Any

from herding_ros.studies import cli
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.reproduction import FURTHER, STUDIES
from herding_ros.studies.runner import work
from herding_ros.studies.study import Options, Results
from herding_ros.studies.task import Task
from matplotlib.figure import Figure
import psutil
import pytest

TASKS = 16
"""Number of tasks of `study symmetry --quick`."""

Experiment = Callable[..., dict[str, Any]]


class Counting:
    """Stands for an experiment, counts its calls, and acts differently at some of them."""

    def __init__(self, then: Callable[[int], dict[str, Any] | None] = lambda call: None) -> None:
        self.calls = 0
        self.then = then

    def __call__(self, **parameters: Any) -> dict[str, Any]:
        self.calls += 1
        return self.then(self.calls) or {'drift': 1e-15, 'moved': 0.5}


@pytest.fixture
def experiment(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Counting]:
    def put(*then: Callable[[int], dict[str, Any] | None]) -> Counting:
        counting = Counting(*then)
        monkeypatch.setitem(EXPERIMENTS, 'symmetry', counting)
        return counting

    return put


def study(out: Path, *arguments: str) -> int:
    return cli.main(['symmetry', '--quick', '--jobs', '1', '--out', str(out), *arguments])


def results(out: Path) -> list[Path]:
    return sorted((out / 'results').rglob('*.json'))


def test_nothing_is_computed_twice(tmp_path: Path, experiment: Callable[..., Counting]) -> None:
    counting = experiment()
    assert study(tmp_path) == 0
    assert counting.calls == TASKS == len(results(tmp_path))
    page = (tmp_path / 'symmetry.md').read_text(encoding='utf-8')
    assert '1.0e-15 m' in page
    assert study(tmp_path) == 0
    assert counting.calls == TASKS
    assert study(tmp_path, '--seeds', '2') == 0  # one seed more
    assert counting.calls == 2 * TASKS


def test_drawing_computes_nothing(tmp_path: Path, experiment: Callable[..., Counting]) -> None:
    counting = experiment()
    assert study(tmp_path, '--draw') == 0
    assert counting.calls == 0
    assert results(tmp_path) == []
    assert 'no results' in (tmp_path / 'symmetry.md').read_text(encoding='utf-8')


def test_interrupted_study_goes_on_where_it_was(
    tmp_path: Path, experiment: Callable[..., Counting], capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(call: int) -> None:
        if call == 6:
            raise KeyboardInterrupt

    experiment(interrupt)
    assert study(tmp_path) == 130
    assert 'all results so far are stored' in capsys.readouterr().out
    assert len(results(tmp_path)) == 5
    counting = experiment()
    assert study(tmp_path) == 0
    assert counting.calls == TASKS - 5


def test_half_written_result_is_computed_again(
    tmp_path: Path, experiment: Callable[..., Counting]
) -> None:
    experiment()
    assert study(tmp_path) == 0
    broken = results(tmp_path)[3]
    broken.write_text(broken.read_text(encoding='utf-8')[:40], encoding='utf-8')
    counting = experiment()
    assert study(tmp_path) == 0
    assert counting.calls == 1


@pytest.mark.parametrize('value', ['raises', 'NaN'])
def test_a_task_that_fails_does_not_stop_the_others(
    value: str,
    tmp_path: Path,
    experiment: Callable[..., Counting],
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(call: int) -> dict[str, Any] | None:
        if call != 4:
            return None
        if value == 'NaN':
            return {'drift': float('nan'), 'moved': 0.0}
        raise ZeroDivisionError('sheep over the fence')

    experiment(fail)
    assert study(tmp_path) == 1
    said = capsys.readouterr().out
    assert len(results(tmp_path)) == TASKS - 1
    assert 'failed: symmetry {' in said
    assert "'dog_pairs'" in said
    assert ('sheep over the fence' if value == 'raises' else 'not JSON compliant') in said
    assert '1 results are missing' in said
    counting = experiment()
    assert study(tmp_path) == 0
    assert counting.calls == 1


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['wolves'], ['stochasticity', 'dogs', 'stabilisation', 'baselines', 'all']),
        ([], ['NAME must be one of', 'symmetry']),
        (['dogs', '--jobs', '0'], ['--jobs', 'integer of at least 1']),
        (['dogs', '--jobs', 'many'], ['--jobs', 'integer of at least 1']),
        (['dogs', '--seeds', '-1'], ['--seeds', 'integer of at least 1']),
        (['dogs', '--paths', '1.5'], ['--paths', 'integer of at least 1']),
        (['stochasticity', '--sigma', '0.01', '0'], ['--sigma', 'a number above 0', 'got 0']),
        (['symmetry', '--sigma', '0.01'], ['--sigma must not be given: symmetry has none']),
        (['symmetry', '--paths', '7'], ['--paths must not be given: symmetry has none']),
    ],
)
def test_bad_arguments_are_refused_with_what_they_must_be(
    arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as refusal:
        cli.main(arguments)
    assert refusal.value.code == 2
    said = capsys.readouterr().err
    assert [word for word in words if word not in said] == []


def test_an_out_that_cannot_be_written_is_a_bad_argument(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'file').touch()
    assert study(tmp_path / 'file' / 'out') == 2
    assert 'file' in capsys.readouterr().err


def test_list_names_all_studies_with_their_sizes(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(['--list']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(STUDIES)
    assert all(re.search(r'\d+ tasks, .* of one core', line) for line in lines)


class Shared:
    """An experiment that computes each kind of task once, whatever its seed and settings are."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.results: dict[str, dict[str, Any]] = {}

    def __call__(self, **parameters: Any) -> dict[str, Any]:
        kept = ('policy', 'trace', 'snapshots', 'flocks', 'plant')
        kind = str((sorted(parameters), [parameters.get(name) for name in kept]))
        if kind not in self.results:
            self.results[kind] = self.experiment(**parameters)
        return self.results[kind]


def test_all_studies_at_smoke_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Rendering takes longer than all the rest, and is seen in the tests of single studies.
    monkeypatch.setattr(Figure, 'savefig', lambda _, path, **__: path.write_bytes(bytes(2000)))
    for name, experiment in EXPERIMENTS.items():
        monkeypatch.setitem(EXPERIMENTS, name, Shared(experiment))
    assert cli.main(['all', '--quick', '--jobs', '1', '--out', str(tmp_path)]) == 0
    pages = {path.stem: path.read_text(encoding='utf-8') for path in tmp_path.glob('*.md')}
    assert set(pages) == {'reproduction', *FURTHER}
    # What was aimed at, further studies, and again.
    assert pages['reproduction'].count('\n## ') == len(STUDIES) - len(FURTHER) + 3
    for page in pages.values():
        assert '$' not in page
        links = re.findall(r'\]\((figures/[^)]*|[a-z_]*\.md)\)', page)
        assert any(link.startswith('figures/') for link in links)
        for link in links:
            assert (tmp_path / link).stat().st_size > 1000
    for path in results(tmp_path):
        entry = json.loads(path.read_text(encoding='utf-8'))
        assert 'seed' in entry['parameters']


@pytest.mark.parametrize('name', STUDIES)
def test_studies_draw_whatever_is_there(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Figure, 'savefig', lambda *_, **__: None)
    section = STUDIES[name].draw(Results([]), tmp_path)
    assert all(goal.reached is None for goal in section.goals)


@pytest.mark.parametrize('name', ['stochasticity', 'baselines', 'sampling'])
def test_noise_is_chosen_on_the_command_line(name: str) -> None:
    """Besides what is shown for one noise alone."""

    def sigmas(options: Options) -> set[float | None]:
        return {task.parameters.get('sigma') for task in STUDIES[name].tasks(options)}

    assert {0.01, 0.02, 0.03, 0.04} <= sigmas(Options())
    assert sigmas(Options(sigma=(0.05, 0.07))) - {0.01, 0.03, None} == {0.05, 0.07}


@pytest.mark.parametrize('name', STUDIES)
def test_tasks_are_distinct_and_repeat(name: str) -> None:
    tasks = STUDIES[name].tasks(Options())
    again = STUDIES[name].tasks(Options())
    assert len({task.key for task in tasks}) == len(tasks)
    assert [task.key for task in again] == [task.key for task in tasks]
    assert all(task.kind in EXPERIMENTS for task in tasks)
    # What is made of a user's data alone draws nothing.
    assert all('seed' in task.parameters or task.inputs for task in tasks)


def test_a_signal_ends_all_processes_and_keeps_what_is_done(tmp_path: Path) -> None:
    """SIGINT ends it in the same way, see above. And two processes compute what one does."""
    command = [sys.executable, '-m', 'herding_ros.studies.cli', 'symmetry', '--quick']
    command += ['--seeds', '200', '--jobs', '2', '--out', str(tmp_path)]
    process = subprocess.Popen(command, env=os.environ, stdout=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 150.0
        while len(results(tmp_path)) < 3 and time.monotonic() < deadline:
            time.sleep(0.05)
        children = psutil.Process(process.pid).children(recursive=True)
        assert len(children) >= 2
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=20.0)
    finally:
        process.kill()
    assert process.returncode == 130
    assert 'all results so far are stored' in said
    _, alive = psutil.wait_procs(children, timeout=10.0)
    assert alive == []
    kept = results(tmp_path)
    assert len(kept) >= 3
    for path in kept[:3]:
        entry = json.loads(path.read_text(encoding='utf-8'))
        task = Task(entry['kind'], entry['parameters'])
        assert entry['result'] == work(task, task.key).result
