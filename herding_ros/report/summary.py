# SPDX-License-Identifier: Apache-2.0
"""A run in a few numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from herding_ros.bag.recorded_run import RecordedRun
from herding_ros.model.flock import arrived, distance, spread


def summarise(run: RecordedRun) -> dict[str, Any]:
    """Return the run's result as plain values for JSON; unknown values are None.

    time_s is when the flock arrived, at the goal and together, else the length of the run.
    """
    spreads = spread(run.x)
    home = [k for k, x in enumerate(run.x) if arrived(x, run.goal, float(spreads[0]))]
    solve_ms = [replan.solve_ms for replan in run.replans if np.isfinite(replan.solve_ms)]
    return {
        'arrived': bool(home),
        'time_s': round(float(run.times[home[0] if home else -1]), 9),
        'final_distance_m': float(distance(run.x[-1], run.goal)),
        'max_spread_m': float(spreads.max()),
        'initial_spread_m': float(spreads[0]),
        'replans': len(run.replans),
        'solve_ms_median': float(np.median(solve_ms)) if solve_ms else None,
        'solve_ms_max': max(solve_ms, default=None),
        'messages_recorded': sum(topic.count for topic in run.topics),
        'messages_lost': run.messages_lost,
        'wall_s': run.wall_s,
        'real_time_factor': float(run.times[-1]) / run.wall_s if run.wall_s > 0.0 else None,
        'seed': run.parameters.get('/sim', {}).get('seed'),
        'sheep': run.x.shape[1],
        'dogs': run.d.shape[1],
        'goal': run.goal.tolist(),
        'version': run.version,
    }
