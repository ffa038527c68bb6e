# SPDX-License-Identifier: Apache-2.0
"""The preset of real sheep against what else was published of them."""

from __future__ import annotations

from herding_ros.model.crowd import CROWDS
from herding_ros.model.dynamics import rollout
from herding_ros.model.noise import increments
from herding_ros.model.state import HerdState
import numpy as np
import pytest


def test_sheep_keep_together_and_run_side_by_side_as_real_ones() -> None:
    """The preset was fitted to recordings with a dog, whose means these are; here is none."""
    crowd, distances, polarisations = CROWDS['sheep'], [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        x = rng.normal(0.0, 1.0, (14, 2))
        start = HerdState(x, np.zeros_like(x), np.array([[1e4, 0.0]]))
        noise = increments(rng, crowd, 14, 0.05, 2400)
        run = rollout(crowd, start, np.zeros((2400, 1, 2)), 0.05, 1, noise)
        x, v = run.x[800:], run.v[800:]
        distances.append(np.linalg.norm(x - x.mean(axis=1, keepdims=True), axis=-1).mean())
        directions = v / np.linalg.norm(v, axis=-1, keepdims=True)
        polarisations.append(np.linalg.norm(directions.mean(axis=1), axis=-1).mean())
    assert np.mean(distances) == pytest.approx(1.21, rel=0.1)
    assert np.mean(polarisations) == pytest.approx(0.87, abs=0.1)
