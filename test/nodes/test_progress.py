# SPDX-License-Identifier: Apache-2.0
"""The live line of `herd`, on terminals of any width."""

from __future__ import annotations

from collections.abc import Iterator
import io
import time
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from herding_ros.nodes.middleware import start_ros
from herding_ros.nodes.progress import ProgressLine, Watcher
import pytest
import rclpy
from rich.console import Console

SIM = {'distance_m': '1234.567', 'spread_m': '0.231'}
WATCHER = SimpleNamespace(sim=SIM, plan={'solve_ms': '1234.5'}, time=399.9)


@pytest.mark.parametrize(('width', 'has_all'), [(40, False), (80, True)])
def test_it_fits(width: int, has_all: bool) -> None:
    """In one line, whose numbers are whole; a narrow terminal has fewer of them."""
    out = io.StringIO()
    console = Console(file=out, width=width, height=24, force_terminal=True)
    line = ProgressLine(WATCHER, console)
    with line.shown():
        line.update(time.monotonic() + 100.0, at_once=True)
    shown = out.getvalue()
    assert '399.9 s' in shown
    assert '1234.567 m' in shown
    assert ' - x' in shown  # the end of the line
    assert ('spread 0.231 m' in shown) == has_all


def test_in_a_file_it_has_all(capsys: pytest.CaptureFixture[str]) -> None:
    out = io.StringIO()
    line = ProgressLine(WATCHER, Console(file=out, width=40))
    with line.shown():
        line.update(time.monotonic() + 100.0, at_once=True)
    assert out.getvalue().count('\n') == 1
    assert 'solve 1234 ms' in out.getvalue()


def test_in_a_file_it_begins_as_soon_as_there_is_something_to_show() -> None:
    out = io.StringIO()
    watcher = SimpleNamespace(sim={}, plan={}, time=0.1)
    line = ProgressLine(watcher, Console(file=out))
    with line.shown():
        line.update(time.monotonic())
        assert out.getvalue() == ''
        watcher.sim = SIM
        for _ in range(2):
            line.update(time.monotonic())
    assert out.getvalue().count('to go 1234.567 m') == 1


def status(name: str, **values: str) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(name=name, values=pairs)


@pytest.fixture
def watcher(domain: int) -> Iterator[Watcher]:
    start_ros(domain_id=domain)
    one = Watcher()
    yield one
    one.destroy_node()
    rclpy.shutdown()


def test_statuses_of_other_programs_are_not_shown(watcher: Watcher) -> None:
    out = io.StringIO()
    line = ProgressLine(watcher, Console(file=out))
    ours = {'time_s': '0.5', 'distance_m': '1.0', 'spread_m': '0.2'}
    for statuses in (
        [status('sim: herd'), status('controller: plan')],
        [status('sim: herd', **{**ours, 'time_s': 'soon'})],
        [status('sim: herd', **ours), status('controller: plan', solve_ms='long')],
        [status('sim: herd')],
    ):
        watcher._on_diagnostics(DiagnosticArray(status=statuses))
        line.update(time.monotonic(), at_once=True)
    assert out.getvalue().count('starting the nodes') == 2
    assert out.getvalue().count('to go 1.000 m') == 2
