# SPDX-License-Identifier: Apache-2.0
"""Who waits for a compiler is told so."""

from __future__ import annotations

from pathlib import Path
import runpy

from herding_ros.model import compile_notice
from numba.core import event
import pytest

PROGRAM = """
from herding_ros.model.jit import kernel

@kernel
def twice(x):
    return 2.0 * x

assert twice(1.0) == 2.0
"""


def test_compiling_is_announced_and_loading_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compile_notice, '_WORTH_A_LINE', 0.0)
    path = tmp_path / 'mine.py'
    path.write_text(PROGRAM, encoding='utf-8')
    said = []
    for _ in range(2):
        with event.install_listener('numba:compile', compile_notice._Notice()):
            runpy.run_path(str(path))
        said.append(capsys.readouterr().err.splitlines())
    first, last = said[0][0], said[0][-1]
    assert first.startswith('herding_ros: compiling kernels for this processor, once')
    assert last == 'herding_ros: compiled twice in 0 s'
    assert said[1] == []


def test_every_process_but_a_worker_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    registered: list[str] = []
    monkeypatch.setattr(event, 'register', lambda kind, _: registered.append(kind))
    compile_notice.announce_compiling()
    assert registered == ['numba:compile']
    monkeypatch.setattr(compile_notice.multiprocessing, 'parent_process', lambda: 'a process')
    compile_notice.announce_compiling()
    assert registered == ['numba:compile']
