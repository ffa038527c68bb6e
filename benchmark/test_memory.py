# SPDX-License-Identifier: Apache-2.0
"""Peak memory of each case, each in a process of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmark import memory
from benchmark.problem import DOGS, ENSEMBLE_STEPS, SHEEP, STEPS
import pytest

CASES = [
    (implementation, sheep, dogs)
    for implementation in memory.IMPLEMENTATIONS
    for sheep in SHEEP
    for dogs in DOGS
    if dogs == 5 or 'ensemble' not in implementation
]


@pytest.mark.parametrize(
    ('implementation', 'sheep', 'dogs'), CASES, ids=[f'{i}-N{n}-M{m}' for i, n, m in CASES]
)
def test_memory(
    benchmark: Any,
    record: Callable[..., None],
    quick: bool,
    implementation: str,
    sheep: int,
    dogs: int,
) -> None:
    """Take the peak of one evaluation, with everything that leads to it."""
    if implementation in ('JAX', 'CasADi'):
        pytest.importorskip(implementation.lower())
    usual = ENSEMBLE_STEPS if 'ensemble' in implementation else STEPS
    steps = 20 if quick else usual[sheep]
    found = benchmark.pedantic(
        lambda: memory.in_own_process(implementation, sheep, dogs, steps), rounds=1
    )
    record(
        'memory',
        f'{found["peak"]:.0f} MiB',
        implementation=implementation,
        sheep=sheep,
        dogs=dogs,
        steps=steps,
        **found,
    )
