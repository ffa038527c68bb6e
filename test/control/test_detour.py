# SPDX-License-Identifier: Apache-2.0
import math

from herding_ros.control.detour import detour
from herding_ros.model.state import Array
import numpy as np
import pytest


def shortest(start: Array, end: Array, radius: float) -> float:
    """Length of the shortest way in a fine ring of points around the disc, by brute force."""
    radius = min(radius, *(float(np.linalg.norm(p)) for p in (start, end)))
    angles = np.linspace(0.0, 2.0 * np.pi, 20001)
    ring = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def sees(p: Array) -> Array:  # the tangent plane separates it from the disc
        return (ring @ p) / radius >= radius - 1e-9

    straight = end - start
    t = np.clip(-(start @ straight) / (straight @ straight), 0.0, 1.0)
    if np.linalg.norm(start + t * straight) >= radius:
        return float(np.linalg.norm(straight))
    # Leave and land where the ring is seen; go along it between, either way.
    best = math.inf
    first, last = np.flatnonzero(sees(start))[::40], np.flatnonzero(sees(end))[::40]
    out, home = (np.linalg.norm(ring - p, axis=1) for p in (start, end))
    for i in first:
        arcs = np.abs(angles[last] - angles[i])
        arcs = radius * np.minimum(arcs, 2.0 * np.pi - arcs)
        best = min(best, float((out[i] + arcs + home[last]).min()))
    return best


@pytest.mark.parametrize('seed', range(12))
def test_way_is_the_shortest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, end = rng.normal(0.0, 1.5, (2, 2))
    radius = rng.uniform(0.1, 1.5)
    found = float(detour(start, end, radius)[0])
    assert found == pytest.approx(shortest(start, end, radius), rel=2e-3)
    assert found == pytest.approx(float(detour(end, start, radius)[0]), rel=1e-12)


def test_gradients_are_those_of_the_length() -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(0.0, 1.0, (300, 2, 2))
    h = 1e-6
    for radius in (0.0, 0.4, 1.0):
        _, by_start, by_end = detour(points[:, 0], points[:, 1], radius)
        for which, gradient in enumerate((by_start, by_end)):
            for axis in range(2):
                moved = [points.copy() for _ in range(2)]
                for sign, each in zip((1.0, -1.0), moved, strict=True):
                    each[:, which, axis] += sign * h
                ahead, behind = (detour(each[:, 0], each[:, 1], radius)[0] for each in moved)
                slope = (ahead - behind) / (2.0 * h)
                # Where the disc is just touched, or on either side as near, there is a kink.
                smooth = np.abs(slope - gradient[:, axis]) < 1e-5
                assert smooth.mean() > 0.98
