"""The controller's space mapping on one window, when sheep have part of their noise in common."""

from __future__ import annotations

from typing import Any

import numpy as np

from herding_ros.control.parameters import Control
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import centre
from herding_ros.model.state import Array

from .case import Case
from .settings import changed

_SINGLE = 100
"""Paths that are looked at one by one."""
_DRAWN = 20


def run(
    sheep: int,
    dogs: int,
    sigma: float,
    common_noise: float,
    seed: int,
    judge_paths: int,
    trace: bool,
    control: dict[str, Any],
) -> dict[str, Any]:
    """Plan the first window. Errors are |X - x_c| in L2(0, T) [m s^0.5].

    before, after: on the noise that the mapping has seen; judged: on other noise, each path of
    which is taken with both signs. wander: how far the centre of a single path is from the mean
    over paths, root mean square in the same norm. With trace, also some of these centres, for a
    picture.
    """
    case = Case(sheep, dogs, sigma, seed, changed(Control(), control), common_noise)
    found = case.plan(case.control)
    before, _ = case.judge(case.deterministic.plan.u, judge_paths, mirrored=True)
    after, uncertainty = case.judge(found.plan.u, judge_paths, mirrored=True)
    singles = _single_centres(case, found.plan.u)
    deviation = singles - singles.mean(axis=0)
    variance = np.square(deviation).sum(axis=0) / (_SINGLE - 1)
    result: dict[str, Any] = {
        'iterations': found.report.mapping_iterations,
        'before': found.report.mapping_error_before,
        'after': found.report.mapping_error_after,
        'judged_before': case.error(before),
        'judged_after': case.error(after),
        'uncertainty': uncertainty,
        'wander': float(np.sqrt(case.coarse.dt * variance.sum())),
    }
    if trace:
        result['trace'] = {
            'wanted': case.trace(case.deterministic.centre),
            'singles': [case.trace(each) for each in singles[:_DRAWN]],
        }
    return result


def _single_centres(case: Case, u: Array) -> Array:
    """Return the centres (paths, K+1, 2) [m] of single paths under u."""
    noise = case.draw(np.random.default_rng([case.seed, 30_000]), _SINGLE)
    model = case.coarse
    return np.stack(
        [
            centre(rollout(case.crowd, case.state, u, model.dt, model.substeps, noise.path(i)).x)
            for i in range(_SINGLE)
        ]
    )
