# SPDX-License-Identifier: Apache-2.0
"""What all programs have in common: output that nobody reads, and signals while they load."""

from __future__ import annotations

from importlib import import_module
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
from types import SimpleNamespace
from unittest.mock import Mock

from herding_ros import programs
import pytest

ROOT = Path(__file__).resolve().parents[1]
NAMES = re.findall(r"'(\w+) = herding_ros\.programs:\1'", (ROOT / 'setup.py').read_text())
GUARDED = 'from herding_ros.programs import guard_output; guard_output(); '


def python(program: str, stdout: int = subprocess.PIPE, **env: str) -> tuple[int, str, str]:
    """Return exit code, output and errors of a program."""
    done = subprocess.run(
        [sys.executable, '-c', program], env={**os.environ, **env},
        stdout=stdout, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


def test_every_program_has_a_main() -> None:
    assert set(NAMES) == {
        'sim', 'controller', 'recorder', 'herd', 'recover', 'report', 'study', 'fit', 'view',
    }  # fmt: skip
    for name in NAMES:
        called, module = getattr(programs, name).args[:2]
        assert called == name
        assert callable(import_module(f'herding_ros.{module}').main)


def test_characters_that_a_terminal_does_not_have_are_escaped() -> None:
    ascii_only = {'PYTHONIOENCODING': 'ascii', 'LC_ALL': 'C'}
    assert python(f'{GUARDED}print("caf\\u00e9")', **ascii_only) == (0, 'caf\\xe9\n', '')


def test_output_that_nobody_reads_is_dropped() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    code = f'{GUARDED}import sys; print("x" * 100_000, flush=True); print("read", file=sys.stderr)'
    assert python(code, writing) == (0, None, 'read\n')
    os.close(writing)


def test_output_for_which_there_is_no_room_is_an_error() -> None:
    with Path('/dev/full').open('w') as full:
        code, _, errors = python(f'{GUARDED}print("x", flush=True)', full.fileno())
    assert code
    assert 'No space left on device' in errors


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(('name', 'code'), [('sim', 0), ('herd', 130), ('report', 130)])
def test_a_signal_while_loading_ends_a_program_in_a_line(
    number: signal.Signals, name: str, code: int
) -> None:
    program = (
        'import signal; from herding_ros import programs; '
        f'programs.import_module = lambda _: signal.raise_signal({int(number)}); '
        f'programs.{name}()'
    )
    assert python(program) == (code, '', f'{name}: interrupted while loading\n')


@pytest.mark.parametrize(
    ('name', 'needs_room'), [('sim', True), ('study', True), ('recover', False)]
)
def test_a_full_dev_shm_is_an_error_before_anything_is_loaded(
    name: str,
    needs_room: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Else LTTng, below rclpy, would end the process by SIGBUS."""
    full = SimpleNamespace(f_bavail=15, f_frsize=4096)
    monkeypatch.setattr(os, 'statvfs', lambda path: full if path == '/dev/shm' else None)
    monkeypatch.setattr(programs, 'guard_output', lambda: None)
    monkeypatch.setattr(programs, 'import_module', Mock(return_value=Mock(main=lambda: 0)))
    assert getattr(programs, name)() == (2 if needs_room else 0)
    errors = capsys.readouterr().err
    said = f'{name}: /dev/shm must have 65536 bytes free, got 61440: remove what fills it\n'
    assert errors == (said if needs_room else '')


def test_ctrl_c_at_work_is_a_line_too() -> None:
    program = (
        'import signal, sys; from types import SimpleNamespace; from herding_ros import programs; '
        'main = lambda: signal.raise_signal(signal.SIGINT); '
        'programs.import_module = lambda _: SimpleNamespace(main=main); '
        'sys.exit(programs.report())'
    )
    assert python(program) == (130, '', 'report: interrupted\n')
