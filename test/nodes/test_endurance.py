# SPDX-License-Identifier: Apache-2.0
"""Five simulated minutes of a large flock: nothing is lost and nothing grows."""

from __future__ import annotations

from pathlib import Path

from benchmark.endurance import endure
import pytest
from rich.console import Console

PERIODS = 3000


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_five_minutes(tmp_path: Path) -> None:
    endured = endure(tmp_path, 0.1 * PERIODS, 100, 6, None, Console(quiet=True))
    assert endured.simulated[-1] > 0.09 * PERIODS
    assert endured.lost == {}
    # sheep, clock, and odometry and commands of six dogs, observed and true
    assert endured.messages > PERIODS * (2 + 1 + 6 * 3)
    assert len(endured.margins) == 31
    for node in endured.memory:
        growth, _ = endured.growth(node)
        # Were each message of the sheep kept, 2.8 kB, two thirds of it would be 5.6 MB. The index
        # of the file that is open is 2.5 kB for 64 KiB of bag, some 2 MB.
        assert growth < 3.0, endured.memory[node]
