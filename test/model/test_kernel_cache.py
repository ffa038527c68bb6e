# SPDX-License-Identifier: Apache-2.0
"""Kernels of an installation that its user may not write."""

from __future__ import annotations

import os
from pathlib import Path
import stat
import subprocess
import sys

from herding_ros.model import kernel_cache
import pytest

PACKAGE = Path(kernel_cache.__file__).parents[1]


@pytest.fixture
def read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package with a compiled kernel; nobody may write into it. Root can everywhere else."""
    package = tmp_path / 'package'
    cache = package / 'model' / '__pycache__'
    cache.mkdir(parents=True)
    (cache / 'kernels.step-1.py311.nbi').write_bytes(b'index')
    (cache / 'kernels.step-1.py311.1.nbc').write_bytes(b'code')
    before = kernel_cache.is_writable
    monkeypatch.setattr(kernel_cache, '_PACKAGE', package)
    monkeypatch.setattr(
        kernel_cache,
        'is_writable',
        lambda folder: package not in folder.parents and before(folder),
    )
    monkeypatch.setattr(kernel_cache.tempfile, 'tempdir', str(tmp_path))
    monkeypatch.delenv('NUMBA_CACHE_DIR', raising=False)
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    return package


def found() -> Path:
    os.environ.pop('NUMBA_CACHE_DIR', None)
    kernel_cache.find_cache()
    return Path(os.environ['NUMBA_CACHE_DIR'])


def test_whoever_may_not_write_gets_a_copy_once(read_only: Path, tmp_path: Path) -> None:
    folder = found()
    assert folder.parent == tmp_path / 'cache' / 'herding_ros'
    assert stat.S_IMODE(folder.parent.stat().st_mode) == 0o700
    (copy,) = folder.iterdir()
    assert {path.name: path.read_bytes() for path in copy.iterdir()} == {
        path.name: path.read_bytes() for path in (read_only / 'model' / '__pycache__').iterdir()
    }
    (copy / 'new.nbi').touch()
    assert found() == folder
    assert (copy / 'new.nbi').exists()
    (read_only / 'model' / '__pycache__' / 'kernels.step-1.py311.1.nbc').write_bytes(b'newer code')
    assert found() not in (folder, tmp_path)


@pytest.mark.parametrize('home', ['/proc/nowhere', 'relative'])
def test_without_a_home_it_is_in_a_temporary_folder(
    read_only: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home: str
) -> None:
    monkeypatch.setenv('XDG_CACHE_HOME', home)
    assert found().parent == tmp_path / f'herding_ros-{os.getuid()}'


def test_a_folder_that_others_may_write_is_not_trusted(
    read_only: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setenv('XDG_CACHE_HOME', '/proc/nowhere')
    theirs = tmp_path / f'herding_ros-{os.getuid()}'
    theirs.mkdir()
    theirs.chmod(0o777)
    assert theirs not in found().parents
    assert 'set NUMBA_CACHE_DIR' in capsys.readouterr().err
    assert list(theirs.iterdir()) == []


def test_numba_takes_its_copies_by_the_names_they_have(tmp_path: Path) -> None:
    """The name of a folder is Numba's: a kernel compiled once is found, not compiled again."""
    program = (
        'import numpy as np; '
        'from herding_ros.model.linear_algebra import transposed_times as kernel; '
        'kernel(np.zeros((2, 8)), np.zeros(2), np.zeros(8)); '
        'print(sum(kernel.stats.cache_hits.values()))'
    )
    subprocess.run([sys.executable, '-c', program], check=True)
    copied = subprocess.run(
        [sys.executable, '-c', program],
        env={**os.environ, 'NUMBA_CACHE_DIR': str(kernel_cache._copy_into(tmp_path / 'base'))},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert copied.stdout.split() == ['1']
