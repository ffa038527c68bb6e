# SPDX-License-Identifier: Apache-2.0
"""A run for tests of what is made of one."""

from __future__ import annotations

from herding_ros.bag.recorded_run import RecordedRun, Route
import numpy as np


def a_run(states: int = 101, sheep: int = 12, dogs: int = 2, plans: int = 9) -> RecordedRun:
    """Sheep that move to the right, dogs behind them, and a plan every second."""
    rng = np.random.default_rng(0)
    times = np.linspace(0.0, 10.0, states)
    way = np.stack([0.1 * times, 0.0 * times], axis=1)[:, None]
    x = rng.normal(0.0, 0.2, (sheep, 2)) + way
    d = np.array([[-1.0, 0.5 * m] for m in range(dogs)]) + way
    horizon = np.linspace(0.0, 4.0, 41)

    def route(k: int, count: int) -> Route:
        points = np.stack([0.1 * (k + horizon), np.full(41, float(k))], axis=1)
        return Route(k + horizon, np.repeat(points[:, None], count, axis=1))

    def first(k: int) -> Route:
        return route(k, 1)

    return RecordedRun(
        times=times, x=x, v=np.zeros_like(x), d=d, dogs=tuple(range(1, dogs + 1)),
        command_times=times, commands=np.zeros_like(d), goal=np.array([1.0, 1.0]), replans=(),
        replans_made=0, namespace='', parameters={}, version='', wall_s=1.0, topics=(), notes=(),
        plans=tuple(route(k, dogs) for k in range(plans)),
        expected=tuple(Route(each.times, each.points[:, 0]) for each in map(first, range(plans))),
        goals=((0.0, np.array([2.0, 0.0])), (5.0, np.array([1.0, 1.0]))),
    )  # fmt: skip
