"""The whole system: three processes in lockstep, as `scripts/herd` starts them."""

from __future__ import annotations

from collections.abc import Callable
import json
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

RUNS = 3


def test_herd(benchmark: Any, record: Callable[..., None], tmp_path: Path, quick: bool) -> None:
    """Read from its summary how fast a run was, without the start of the nodes."""
    if quick:
        pytest.skip('--quick')
    pytest.importorskip('rclpy')
    summaries: list[dict[str, Any]] = []

    def herd() -> None:
        out = tmp_path / str(len(summaries))
        command = [sys.executable, '-m', 'herding_ros.nodes.herd', '--out', str(out)]
        subprocess.run(command, check=True, capture_output=True, env=os.environ)
        summaries.append(json.loads((out / 'summary.json').read_text(encoding='utf-8')))

    benchmark.pedantic(herd, rounds=RUNS)
    factors = [summary['real_time_factor'] for summary in summaries]
    record(
        'herd',
        f'{np.median(factors):.1f} simulated seconds a second',
        factors=factors,
        simulated=[summary['time_s'] for summary in summaries],
        wall=[summary['wall_s'] for summary in summaries],
        seconds=list(benchmark.stats.stats.data),
    )
