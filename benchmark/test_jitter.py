# SPDX-License-Identifier: Apache-2.0
"""Regularity of commands while the controller keeps its own time and plans in the background."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

WALL = 60.0
"""Length of a run in wall time [s]."""


@pytest.mark.parametrize('factor', [1, 10])
def test_jitter(
    benchmark: Any, record: Callable[..., None], tmp_path: Path, quick: bool, factor: int
) -> None:
    """Take it from the publish times in the bag of 30 sheep and 5 dogs."""
    if quick:
        pytest.skip('--quick')
    pytest.importorskip('rclpy')
    from benchmark.endurance import endure

    seconds = factor * WALL
    endured = benchmark.pedantic(
        lambda: endure(tmp_path, seconds, 30, 5, float(factor), Console(quiet=True)), rounds=1
    )
    missed = sum(margin < 0.0 for margin in endured.margins)
    record(
        'jitter',
        f'{endured.jitter["p99_ms"]:.1f} ms at the 99th percentile',
        factor=factor,
        simulated=seconds,
        plans=len(endured.margins),
        missed=missed,
        **endured.jitter,
    )
