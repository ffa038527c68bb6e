# SPDX-License-Identifier: Apache-2.0
"""The live line of `herd`, on terminals of any width."""

from __future__ import annotations

import io
import time
from types import SimpleNamespace

from herding_ros.nodes.progress import ProgressLine
import pytest
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
