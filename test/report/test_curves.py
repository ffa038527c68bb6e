# SPDX-License-Identifier: Apache-2.0
"""What is told of a run over time, against what follows from where its sheep are."""

from __future__ import annotations

from dataclasses import replace

from herding_ros.bag.recorded_run import RecordedRun, Replan
from herding_ros.report.curves import curves, RunCurve
from moving_flock import a_run
import numpy as np
import pytest


def by_label(run: RecordedRun) -> dict[str, RunCurve]:
    return {each.label: each for each in curves(run)}


def replan(time: float, solve_ms: float, margin: float) -> Replan:
    nan = np.nan
    return Replan(time, 0, '', solve_ms, nan, nan, nan, nan, nan, nan, nan, margin)


def test_distance_and_share_are_of_the_destination_that_is_in_force() -> None:
    near, far = np.array([0.4, 0.0]), np.array([1.0, 1.0])
    run = replace(a_run(), goals=((0.0, near), (5.0, far)))
    at = [near if t < 5.0 else far for t in run.times]
    found = by_label(run)
    distance = [np.linalg.norm(x.mean(axis=0) - goal) for x, goal in zip(run.x, at, strict=True)]
    assert np.allclose(found['distance [m]'].values, distance)
    start = run.x[0] - run.x[0].mean(axis=0)
    radius = 0.05 + 1.5 * np.sqrt(np.sum(start**2) / len(start))
    share = [
        np.mean([np.hypot(*(one - goal)) <= radius for one in x])
        for x, goal in zip(run.x, at, strict=True)
    ]
    assert np.allclose(found['share of sheep at the destination'].values, share)
    assert len(set(share)) > 3


def test_sheep_that_are_not_seen_do_not_count() -> None:
    run = a_run()
    run.x[50:, 3:] = np.nan
    few = by_label(replace(run, x=run.x[:, :3]))['distance [m]'].values
    assert np.allclose(by_label(run)['distance [m]'].values[50:], few[50:])


def test_what_is_not_known_is_left_out() -> None:
    run = replace(a_run(), goal=None, goals=(), replans=(replan(1.0, 200.0, 0.0),))
    assert list(by_label(run)) == ['spread [m]', 'solve time [ms]']
    timed = by_label(replace(run, replans=(replan(1.0, 200.0, 0.7), replan(3.0, np.nan, -0.1))))
    assert timed['deadline margin [s]'].values == pytest.approx([0.7, -0.1])
    assert timed['deadline margin [s]'].times == pytest.approx([1.0, 3.0])


def test_dogs_look_where_they_last_went() -> None:
    run = a_run(states=6, dogs=2)
    run.d[:, 0] = [(0, 0), (0, 0), (0, 1), (0, 1), (-1, 1), (-1, 1)]
    run.d[:, 1] = [(0, 0), (1, 1), (np.nan, np.nan), (np.nan, np.nan), (3, 3), (3, 2)]
    turn = np.pi / 4
    assert np.allclose(run.headings[:, 0], [0, 0, 2 * turn, 2 * turn, 4 * turn, 4 * turn])
    assert np.allclose(run.headings[:, 1], [0, turn, turn, turn, turn, -2 * turn])
