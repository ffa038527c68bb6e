# SPDX-License-Identifier: Apache-2.0
"""What the nodes reply on the command line before they start anything."""

from __future__ import annotations

from importlib import import_module
import subprocess
import sys

from herding_ros.nodes.command_line import _NODES
import pytest
import rclpy

EVERY_NODE = ('sim', 'controller', 'recorder')


@pytest.mark.parametrize('name', EVERY_NODE)
@pytest.mark.parametrize('flag', ['-h', '--help'])
def test_help_is_printed_and_nothing_is_started(
    capsys: pytest.CaptureFixture[str], name: str, flag: str
) -> None:
    with pytest.raises(SystemExit) as end:
        import_module(f'herding_ros.nodes.{name}').main([flag])
    assert end.value.code == 0
    text = capsys.readouterr().out
    for words in (f'usage: {name} ', '/diagnostics', 'subscribes to', f'{name} --ros-args -p'):
        assert words in text
    assert not rclpy.ok()


@pytest.mark.parametrize('name', EVERY_NODE)
@pytest.mark.parametrize('columns', [40, 80])
def test_help_fits_the_terminal_and_breaks_no_name(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, name: str, columns: int
) -> None:
    monkeypatch.setenv('COLUMNS', str(columns))
    with pytest.raises(SystemExit):
        import_module(f'herding_ros.nodes.{name}').main(['--help'])
    text = capsys.readouterr().out.partition('example:')[0].partition('options:')[2]
    assert max(map(len, text.splitlines())) <= columns
    said = _NODES[name]
    for word in (*said.topics.split(), *said.parameters):
        assert word in text.split()


@pytest.mark.parametrize('name', EVERY_NODE)
def test_help_loads_neither_ros_nor_compiled_code(name: str) -> None:
    asked = f"""import sys; from herding_ros import programs
try: programs.{name}()
finally: print(*sys.modules)"""
    done = subprocess.run(
        [sys.executable, '-c', asked, '--help'], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert {f'{name}', 'herding_ros.nodes.command_line'} <= loaded
    assert not {'rclpy', 'numba', 'scipy', 'matplotlib'} & loaded


@pytest.mark.parametrize('name', EVERY_NODE)
@pytest.mark.parametrize('arguments', [['--dogs', '3'], ['dogs:=3'], ['--ros-args', '--dogs']])
def test_other_arguments_are_refused_with_a_hint(
    capsys: pytest.CaptureFixture[str], name: str, arguments: list[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        import_module(f'herding_ros.nodes.{name}').main(arguments)
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert 'dogs' in error
    assert '--ros-args -p dogs:=3' in error
    assert not rclpy.ok()
