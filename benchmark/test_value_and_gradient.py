# SPDX-License-Identifier: Apache-2.0
"""Value and gradient of the reduced cost: ours, JAX and CasADi."""

from __future__ import annotations

from collections.abc import Callable
import shutil
from typing import Any

from benchmark.problem import DOGS, Problem, SHEEP, STEPS
import numpy as np
import pytest

AGREEMENT = 1e-8
PEERS = {'JAX': 'benchmark.peers.jax_adjoint', 'CasADi': 'benchmark.peers.casadi_adjoint'}


def difference(peer: Callable[[], Any], problem: Problem) -> float:
    """Relative difference of value or gradient, whichever is larger."""
    value, gradient = problem.value_and_gradient()
    peer_value, peer_gradient = peer()
    of_gradient = np.abs(peer_gradient - gradient).max() / np.abs(gradient).max()
    return max(abs(peer_value / value - 1.0), of_gradient)


def measure(
    compare: Callable[..., None], name: str, peer: Callable[[], Any], problem: Problem
) -> None:
    """Assert that both agree, and compare their times."""
    apart = difference(peer, problem)
    assert apart <= AGREEMENT
    compare(
        'value and gradient',
        problem.value_and_gradient,
        peer,
        peer=name,
        sheep=problem.sheep,
        dogs=problem.dogs,
        steps=problem.steps,
        difference=apart,
    )


@pytest.mark.parametrize('sheep', SHEEP, ids='N{}'.format)
@pytest.mark.parametrize('dogs', DOGS, ids='M{}'.format)
@pytest.mark.parametrize('name', PEERS)
def test_peer(compare: Callable[..., None], quick: bool, name: str, sheep: int, dogs: int) -> None:
    """Time a peer against ours."""
    module = pytest.importorskip(PEERS[name])
    problem = Problem(sheep, dogs, 20 if quick else STEPS[sheep])
    measure(compare, name, module.value_and_gradient(problem), problem)


@pytest.mark.parametrize(
    ('name', 'label', 'options'),
    [
        ('JAX', 'JAX, straightforward', {'tuned': False}),
        ('CasADi', 'CasADi, scalars (SX)', {'scalars': True}),
    ],
)
def test_peer_as_written_at_first(
    compare: Callable[..., None], quick: bool, name: str, label: str, options: dict[str, bool]
) -> None:
    """Time a straightforward version of a peer."""
    module = pytest.importorskip(PEERS[name])
    problem = Problem(10 if quick else 30, 5, 20 if quick else STEPS[30])
    measure(compare, label, module.value_and_gradient(problem, **options), problem)


@pytest.mark.skipif(not shutil.which('gcc'), reason='there is no gcc')
def test_casadi_compiled(compare: Callable[..., None], quick: bool) -> None:
    """Time CasADi once more, with the C that it writes compiled."""
    module = pytest.importorskip(PEERS['CasADi'])
    problem = Problem(10 if quick else 30, 5, 20 if quick else STEPS[30])
    peer = module.value_and_gradient(problem, module.COMPILER_FLAGS)
    measure(compare, 'CasADi, C compiled by gcc', peer, problem)


def test_growth(compare: Callable[..., None], quick: bool) -> None:
    """Time ten times as many sheep against N = 100, with the same number of steps."""
    few, many = (10, 100) if quick else (100, 1000)
    steps = 10 if quick else 50
    small, large = Problem(few, 5, steps), Problem(many, 5, steps)
    compare('growth', small.value_and_gradient, large.value_and_gradient, sheep=few, steps=steps)
