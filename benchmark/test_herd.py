# SPDX-License-Identifier: Apache-2.0
"""The whole system: three processes in lockstep, as `scripts/herd` starts them."""

from __future__ import annotations

from collections.abc import Callable
import json
import os
from pathlib import Path
import resource
import subprocess
import sys
from typing import Any

from herding_ros.bag.reader import read_run
import numpy as np
import pytest

CASES = {(30, 5): 3, (10_000, 6): 1}
"""Number of runs by sheep and dogs; the memory of the largest is seen last."""


@pytest.mark.parametrize(('herded', 'dogs'), CASES, ids=[f'N{n}-M{m}' for n, m in CASES])
def test_herd(
    benchmark: Any,
    record: Callable[..., None],
    tmp_path: Path,
    quick: bool,
    herded: int,
    dogs: int,
) -> None:
    """Read from its summary how fast a run was, without the start of the nodes."""
    if quick:
        pytest.skip('--quick')
    pytest.importorskip('rclpy')
    summaries: list[dict[str, Any]] = []
    solving: list[float] = []

    def herd() -> None:
        out = tmp_path / str(len(summaries))
        command = [sys.executable, '-m', 'herding_ros.nodes.herd', '--out', str(out)]
        command += ['--sheep', str(herded), '--dogs', str(dogs)]
        subprocess.run(command, check=True, capture_output=True, env=os.environ)
        summaries.append(json.loads((out / 'summary.json').read_text(encoding='utf-8')))
        solving.append(1e-3 * sum(each.solve_ms for each in read_run(out / 'bag').replans))

    benchmark.pedantic(herd, rounds=CASES[herded, dogs])
    factors = [summary['real_time_factor'] for summary in summaries]
    simulated = [summary['time_s'] for summary in summaries]
    wall = [summary['wall_s'] for summary in summaries]
    record(
        'herd',
        f'{np.median(factors):.1f} simulated seconds a second',
        herded=herded,
        dogs=dogs,
        factors=factors,
        simulated=simulated,
        wall=wall,
        solving=solving,
        without_solving=[s / (w - t) for s, w, t in zip(simulated, wall, solving, strict=True)],
        seconds=list(benchmark.stats.stats.data),
        peak=resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0,
    )
