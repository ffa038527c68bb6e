# SPDX-License-Identifier: Apache-2.0
"""The kernels, one core, against a bare loop of the same exponentials and square roots."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmark import roofline
from benchmark.problem import ENSEMBLE_STEPS, Problem, SHEEP, STEPS
import pytest


def test_the_bare_loop_is_vectorised() -> None:
    """A roof of scalar operations would be too low."""
    assert roofline.is_vectorised(roofline.bare)


def kernel_and_counts(kernel: str, problem: Problem) -> tuple[Callable[[], Any], int]:
    """Return the kernel, and how many times it goes through all pairs in one call."""
    if kernel == 'ensemble':
        paths = 32
        noise = problem.noise(paths)
        run = lambda: problem.mean_centre(noise, threads=1)  # noqa: E731
        return run, paths * problem.steps
    if kernel == 'rollout':
        return lambda: problem.coarse.rollout(problem.u), problem.steps
    return problem.value_and_gradient, 2 * problem.steps


@pytest.mark.parametrize('sheep', SHEEP, ids='N{}'.format)
@pytest.mark.parametrize('kernel', ['rollout', 'value and gradient', 'ensemble'])
def test_kernel(compare: Callable[..., None], quick: bool, kernel: str, sheep: int) -> None:
    """Time the bare loop against a kernel: the ratio is the fraction of the roof."""
    steps = (ENSEMBLE_STEPS if kernel == 'ensemble' else STEPS)[sheep]
    problem = Problem(sheep, 5, 20 if quick else steps)
    run, times = kernel_and_counts(kernel, problem)
    interactions, evaluations = times * problem.interactions, times * problem.evaluations
    arguments = roofline.arguments(evaluations)
    compare(
        'roofline',
        run,
        lambda: roofline.bare(*arguments),
        unit='of the roof',
        kernel=kernel,
        sheep=sheep,
        steps=problem.steps,
        interactions=interactions,
        evaluations=evaluations,
    )


def test_division(compare: Callable[..., None]) -> None:
    """Time the bare loop against itself with the division by r."""
    arguments = roofline.arguments(2_000_000)
    compare(
        'roofline with division',
        lambda: roofline.bare(*arguments),
        lambda: roofline.bare_with_division(*arguments),
        evaluations=2_000_000,
    )
