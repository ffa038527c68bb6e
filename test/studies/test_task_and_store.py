# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import logging
import math
import os
from pathlib import Path

from herding_ros import __version__
from herding_ros.studies import task as task_module
from herding_ros.studies.store import Store
from herding_ros.studies.task import bare, code, Task
import pytest

TASK = Task('symmetry', {'seed': 3, 'goal': (0.5, 1.0)}, cost=7.0)
RESULT = {'drift': 0.1 + 0.2, 'path': [1.0, 2.5e-17]}


def test_a_result_comes_back_as_it_was(tmp_path: Path) -> None:
    store = Store(tmp_path / 'results')
    assert store.load(TASK) is None
    store.keep(TASK, RESULT, 1.5)
    again = Task('symmetry', {'goal': [0.5, 1.0], 'seed': 3})
    assert store.load(again) == RESULT
    entry = json.loads(store.path(TASK).read_text(encoding='utf-8'))
    assert entry['parameters'] == {'seed': 3, 'goal': [0.5, 1.0]}
    assert entry['version'] == __version__
    assert [path.suffix for path in store.path(TASK).parent.iterdir()] == ['.json']


def test_key_distinguishes_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    same = Task('symmetry', {'goal': [0.5, 1.0], 'seed': 3}, cost=1.0)
    assert same.key == TASK.key
    assert Task('symmetry', {'goal': [0.5, 1.0], 'seed': 4}).key != TASK.key
    assert Task('window', {'goal': [0.5, 1.0], 'seed': 3}).key != TASK.key
    monkeypatch.setattr(task_module, '__version__', '9.9.9')
    assert Task('symmetry', {'goal': [0.5, 1.0], 'seed': 3}).key != TASK.key


@pytest.mark.parametrize(
    'damage',
    [
        lambda text: '',
        lambda text: text[: len(text) // 2],
        lambda text: '[]',
        lambda text: text.replace('"seed":3', '"seed":4'),
        lambda text: text.replace('"result":{', '"outcome":{'),
    ],
    ids=['empty', 'cut off', 'no dict', 'of another task', 'without result'],
)
def test_a_damaged_result_is_none_and_says_so(
    damage: object, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = Store(tmp_path)
    store.keep(TASK, RESULT, 1.5)
    path = store.path(TASK)
    assert callable(damage)
    path.write_text(damage(path.read_text(encoding='utf-8')), encoding='utf-8')
    with caplog.at_level(logging.WARNING):
        assert store.load(TASK) is None
    assert str(path) in caplog.text
    store.keep(TASK, RESULT, 1.5)
    assert store.load(TASK) == RESULT


def test_what_json_cannot_hold_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with pytest.raises(ValueError, match='not JSON compliant'):
        store.keep(TASK, {'drift': math.nan}, 1.5)
    assert [path for path in tmp_path.rglob('*') if path.is_file()] == []


def test_a_signal_at_the_last_moment_stays_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace = os.replace

    def replace_and_be_interrupted(old: str, new: Path) -> None:
        replace(old, new)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, 'replace', replace_and_be_interrupted)
    store = Store(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        store.keep(TASK, RESULT, 1.5)
    assert store.load(TASK) == RESULT


def test_only_what_computes_counts_as_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def code_with(**files: str) -> str:
        for name, text in files.items():
            path = tmp_path / name.replace('__', '/')
            path.parent.mkdir(parents=True, exist_ok=True)
            path.with_suffix('.py').write_text(text, encoding='utf-8')
        code.cache_clear()
        return code()

    monkeypatch.setattr(task_module, '_PACKAGE', tmp_path)
    first = code_with(model__a='x = 1\n', studies__experiments__b='y = 2\n')
    assert code_with(model__a='"""Text."""\n\nx = 1  # one\n') == first
    assert code_with(studies__draw='z = 3\n') == first
    assert code_with(studies__experiments__b='y = 3\n') != first
    code.cache_clear()


def test_bare_keeps_strings_that_are_used() -> None:
    source = 'def f():\n    """Text."""\n    return "text"  # why\n'
    assert bare(source) == "def f():\n    return 'text'"
    assert bare('class A:\n    """Text."""\n') == 'class A:\n    pass'
