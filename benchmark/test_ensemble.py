# SPDX-License-Identifier: Apache-2.0
"""The mean of an ensemble: ours and plain NumPy."""

from __future__ import annotations

from collections.abc import Callable

from benchmark.peers import numpy_ensemble
from benchmark.problem import DOGS, ENSEMBLE_STEPS, PATHS, Problem, SHEEP
import numpy as np
import pytest

CASES = [*((n, 5) for n in SHEEP), *((30, m) for m in DOGS if m != 5)]


@pytest.mark.parametrize(('sheep', 'dogs'), CASES, ids=[f'N{n}-M{m}' for n, m in CASES])
def test_numpy(compare: Callable[..., None], quick: bool, sheep: int, dogs: int) -> None:
    """Time NumPy against ours, with the same noise."""
    problem = Problem(sheep, dogs, 20 if quick else ENSEMBLE_STEPS[sheep])
    paths = 10 if quick else PATHS
    noise = problem.noise(paths)
    plain = problem.noise_array(noise)
    apart = np.abs(problem.mean_centre(noise) - numpy_ensemble.mean_centre(problem, plain)).max()
    assert apart <= 1e-10
    compare(
        'ensemble',
        lambda: problem.mean_centre(noise),
        lambda: numpy_ensemble.mean_centre(problem, plain),
        peer='NumPy',
        sheep=sheep,
        dogs=dogs,
        steps=problem.steps,
        paths=paths,
        difference=apart,
    )
