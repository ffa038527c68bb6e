"""The programs of doc/extending.md run and do what the page says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import runpy
from typing import Any

import numpy as np
import pytest

from herding_ros.control.costs.check import taylor_orders
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.scenario import initial_herd

PAGE = Path(__file__).resolve().parents[1] / 'doc' / 'extending.md'
Run = Callable[[str], tuple[dict[str, Any], list[str]]]
POTENTIAL, COST = re.findall(r'```python\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.S)


@pytest.fixture
def run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Return a function that runs a program: the names it leaves, and the lines it prints."""

    def run(program: str) -> tuple[dict[str, Any], list[str]]:
        path = tmp_path / 'program.py'
        path.write_text(program, encoding='utf-8')
        names = runpy.run_path(str(path))
        return names, capsys.readouterr().out.splitlines()

    return run


@pytest.mark.parametrize('program', [POTENTIAL, COST])
def test_a_program_can_be_taken_in_at_a_glance(program: str) -> None:
    assert len(program.splitlines()) <= 40


def test_the_potential(run: Run) -> None:
    names, (line,) = run(POTENTIAL)
    arrived, time = line.split()
    assert arrived == 'True'
    assert 10.0 < float(time) < 60.0
    bark, r, h = names['Gaussian'](0.01, 0.5), np.linspace(0.05, 2.0, 50), 1e-5
    slope = (bark.value(r + h) - bark.value(r - h)) / (2.0 * h)
    curvature = (bark.derivative(r + h) - bark.derivative(r - h)) / (2.0 * h)
    np.testing.assert_allclose(bark.derivative(r), slope, rtol=0, atol=1e-9)
    np.testing.assert_allclose(bark.second_derivative(r), curvature, rtol=0, atol=1e-8)


def test_the_cost(run: Run) -> None:
    _, lines = run(COST)
    without, fenced = (line.split() for line in lines)
    assert without[0] == fenced[0] == 'True'
    assert float(without[1]) < float(fenced[1])  # the price
    beyond = [float(each[2]) - 0.35 for each in (without, fenced)]
    assert beyond[0] > 0.1
    assert beyond[1] < 0.02


def test_the_derivatives_of_the_cost(run: Run) -> None:
    source = COST.partition('\n\nfor ')[0]
    fence = run(source)[0]['Fence'](1000.0, 0.1)
    herd = initial_herd(20, 2, np.ones(2), np.random.default_rng(0))
    trajectory = rollout(Crowd(), herd, np.zeros((20, 2, 2)), 0.1)
    u = np.zeros((20, 2, 2))
    value, by = fence.value_and_derivatives(trajectory, u)
    assert value > 0.0
    assert not by.x[0].any()
    assert min(taylor_orders(fence, trajectory, u, np.random.default_rng(1))) > 1.9
