# SPDX-License-Identifier: Apache-2.0
"""The programs of doc/extending.md run and do what the page says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
import re
import runpy
from typing import Any

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.costs.check import taylor_orders
from herding_ros.control.costs.cost import Cost
from herding_ros.control.objective import Objective, weighted_costs
from herding_ros.control.parameters import Weights
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.scenario import initial_herd
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

PAGE = Path(__file__).resolve().parents[1] / 'doc' / 'extending.md'
Run = Callable[[str], tuple[dict[str, Any], list[list[str]]]]
PROGRAMS = re.findall(r'```python\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.S)
POTENTIAL, FENCE, ACCELERATING, SPACING, BORDER, POLICY = PROGRAMS


@pytest.fixture
def run(cache: pytest.Cache, capsys: pytest.CaptureFixture[str]) -> Run:
    """Return a function that runs a program: the names it leaves, and the lines it prints."""

    def run(program: str) -> tuple[dict[str, Any], list[list[str]]]:
        # Numba keeps what it compiles for a program as long as the file does not change.
        path = cache.mkdir('extending') / f'program_{PROGRAMS.index(program)}.py'
        if not path.exists() or path.read_text(encoding='utf-8') != program:
            path.write_text(program, encoding='utf-8')
        names = runpy.run_path(str(path))
        return names, [line.split() for line in capsys.readouterr().out.splitlines()]

    return run


def herd_and_control(dogs: int = 3, intervals: int = 40) -> tuple[HerdState, Array]:
    """A flock with a dog at its edge, and commands that bring the dogs into it."""
    herd = initial_herd(20, dogs, np.ones(2), np.random.default_rng(0))
    u = -0.2 * herd.d + np.random.default_rng(1).normal(0.0, 0.05, (intervals, dogs, 2))
    return replace(herd, d=0.5 * herd.d), u


def gradient_order(coarse: CoarseModel, u: Array, largest: float) -> float:
    """Return the order with which the remainder of the reduced cost's expansion vanishes.

    The steps are at most `largest` [m/s]: small against what forces and dogs are sensitive to,
    and large against round-off.
    """
    steps = largest * 2.0 ** -np.arange(4.0)
    costs = weighted_costs(Weights(), np.ones((len(u) * coarse.substeps + 1, 2)), 0.05)
    objective, w = Objective(costs), np.random.default_rng(2).normal(size=u.shape)
    value, gradient = coarse.value_and_gradient(objective, u)
    there = [coarse.value_and_gradient(objective, u + h * w)[0] for h in steps]
    remainders = np.abs(np.array(there) - value - steps * coarse.inner(gradient, w))
    return float(np.log2(remainders[:-1] / remainders[1:]).min())


def orders(cost: Cost) -> dict[str, float]:
    """Return the orders of a cost's expansion where dogs and sheep are close together."""
    herd, u = herd_and_control()
    trajectory = rollout(Crowd(), replace(herd, d=0.05 * herd.d), u, 0.1)
    assert cost.value_and_derivatives(trajectory, u)[0] > 0.0
    found = taylor_orders(cost, trajectory, u, np.random.default_rng(3))
    return dict(zip('xdu', found, strict=True))


@pytest.mark.parametrize('program', PROGRAMS, ids=range(len(PROGRAMS)))
def test_a_program_can_be_taken_in_at_a_glance(program: str) -> None:
    assert len(program.splitlines()) <= (70 if program == ACCELERATING else 40)


def test_a_potential(run: Run) -> None:
    names, ((arrived, time),) = run(POTENTIAL)
    assert arrived == 'True'
    assert 10.0 < float(time) < 60.0
    bark, r, h = names['Gaussian'](0.01, 0.5), np.linspace(0.05, 2.0, 50), 1e-5
    slope = (bark.value(r + h) - bark.value(r - h)) / (2.0 * h)
    curvature = (bark.derivative(r + h) - bark.derivative(r - h)) / (2.0 * h)
    np.testing.assert_allclose(bark.derivative(r), slope, rtol=0, atol=1e-9)
    np.testing.assert_allclose(bark.second_derivative(r), curvature, rtol=0, atol=1e-8)
    herd, u = herd_and_control()
    crowd = Crowd(dog=names['Gaussian'](0.01, 0.5))  # kernels know it by a table
    assert gradient_order(CoarseModel(crowd, herd, 0.05), u, 5e-4) > 1.9


def test_a_fence(run: Run) -> None:
    names, (without, fenced) = run(FENCE)
    assert without[0] == fenced[0] == 'True'
    assert float(without[2]) > 0.42 + 0.09
    assert float(fenced[2]) < 0.42 + 0.03
    herd, u = herd_and_control()
    crowd = Crowd(external=names['Fence'](300.0, 0.2))  # through the flock
    assert gradient_order(CoarseModel(crowd, herd, 0.05), u, 5e-4) > 1.9


def test_a_dog_that_accelerates(run: Run) -> None:
    names, ((arrived, time, most),) = run(ACCELERATING)
    assert arrived == 'True'
    assert float(time) < 30.0
    assert 0.015 < float(most) <= 0.02
    dog = names['Accelerating'](limit=0.05)
    herd, u = herd_and_control()
    d = dog.state(herd.d, np.zeros(3), u[0])
    coarse = CoarseModel(Crowd(), replace(herd, d=d), 0.05, motion=dog)
    assert gradient_order(coarse, u, 5e-3) > 1.9


def test_dogs_that_keep_apart(run: Run) -> None:
    names, (without, apart) = run(SPACING)
    assert without[0] == apart[0] == 'True'
    assert abs(float(apart[1]) - float(without[1])) < 3.0
    assert 0.1 < float(without[2]) < 0.2
    assert float(apart[2]) > 0.23
    found = orders(names['Spacing'](100.0, 0.5))
    assert 1.9 < found['d'] < np.inf


def test_a_border(run: Run) -> None:
    names, (without, bordered) = run(BORDER)
    assert without[0] == bordered[0] == 'True'
    assert float(without[1]) < float(bordered[1])  # the price
    assert float(without[2]) > 0.35 + 0.1
    assert float(bordered[2]) < 0.35 + 0.02
    found = orders(names['Border'](1000.0, 0.1))
    assert 1.9 < found['x'] < np.inf


def test_another_controller(run: Run) -> None:
    _, ((arrived, time),) = run(POLICY)
    assert arrived == 'True'
    assert float(time) < 25.0


def test_a_foreign_simulator(capsys: pytest.CaptureFixture[str]) -> None:
    program = PAGE.parents[1] / 'examples' / 'foreign_simulator.py'
    assert len(program.read_text(encoding='utf-8').splitlines()) <= 45
    run = runpy.run_path(str(program))['run']
    assert 'arrived: True' in capsys.readouterr().out
    assert 10.0 < run.t[-1] < 40.0
    assert len(run.reports) < 1.5 * run.t[-1]  # as its model is wrong, but never by so much
