# SPDX-License-Identifier: Apache-2.0
"""The controller's space mapping on one window: Table 1, common noise, large flocks.

All errors are |X - x_c| in L2(0, T) [m s^0.5]. before, after: on the noise paths of the mapping;
judged_before, judged_after: on other paths; uncertainty: of the latter.
"""

from __future__ import annotations

import math
from typing import Any

from herding_ros.control.solve_report import SolveReport
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import centre
from herding_ros.model.kernels import PATHS
from herding_ros.model.noise import NoisePaths
from herding_ros.model.state import Array
import numpy as np

from .case import Case
from .variant import extraction

_SINGLE = 100
"""Paths that are evaluated one by one."""
_DRAWN = 20


def table(case: Case, judge_paths: int, trace: bool) -> dict[str, Any]:
    """Plan the first window, as in Table 1 of the paper.

    residual: |T(u_f) - u_c| / |u_c| of the chosen control, by the paper's parameter extraction;
    calls: Monte Carlo evaluations (each of all paths), and rollouts in extraction. With trace,
    also the centres, for a figure.
    """
    u_coarse = case.deterministic.plan.u
    found = case.plan(case.control)
    report = found.report
    before, _ = case.judge(u_coarse, judge_paths)
    after, uncertainty = case.judge(found.plan.u, judge_paths)
    extracted = extraction(case, 'spg', 'centre')(found.centre, u_coarse)
    inner, change = case.coarse.inner, extracted.u - u_coarse
    result = {
        **_errors(report, case.error(before), case.error(after)),
        'residual': math.sqrt(inner(change, change) / inner(u_coarse, u_coarse)),
        'uncertainty': uncertainty,
        'calls': {'fine': report.fine_calls, 'extraction': report.extraction_calls},
    }
    if trace:
        centres = {'target': case.deterministic.centre, 'before': before, 'after': after}
        result['trace'] = {name: case.trace(each) for name, each in centres.items()}
    return result


def common_noise(case: Case, judge_paths: int, trace: bool) -> dict[str, Any]:
    """Plan the first window when sheep have part of their noise in common.

    Each path of the judge is taken with both signs. wander: how far the centre of a single path
    is from the mean over paths, root mean square in the same norm. With trace, also some of these
    centres, for a figure.
    """
    found = case.plan(case.control)
    before, _ = case.judge(case.deterministic.plan.u, judge_paths, mirrored=True)
    after, uncertainty = case.judge(found.plan.u, judge_paths, mirrored=True)
    singles = _single_centres(case, found.plan.u)
    deviation = singles - singles.mean(axis=0)
    variance = np.square(deviation).sum(axis=0) / (_SINGLE - 1)
    result = {
        **_errors(found.report, case.error(before), case.error(after)),
        'uncertainty': uncertainty,
        'wander': float(np.sqrt(case.coarse.dt * variance.sum())),
    }
    if trace:
        result['trace'] = {
            'target': case.trace(case.deterministic.centre),
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


def large_flock(case: Case, judge_paths: int) -> dict[str, Any]:
    """Plan the first window of a large flock.

    Judged on antithetic paths, in whole blocks. seconds: of the phases of the solve.
    """
    found = case.plan(case.control)
    noise = mirrored(case.draw(np.random.default_rng([case.seed, 20_000]), judge_paths))
    before, after = (
        case.error(case.expected_centre(u, noise))
        for u in (case.deterministic.plan.u, found.plan.u)
    )
    return {**_errors(found.report, before, after), 'seconds': found.report.seconds}


def mirrored(noise: NoisePaths) -> NoisePaths:
    """Return antithetic paths: the second half of each block mirrors the first."""
    blocks = noise.blocks.reshape(*noise.blocks.shape[:3], -1, PATHS).copy()
    blocks[..., PATHS // 2 :] = -blocks[..., : PATHS // 2]
    return NoisePaths(len(blocks) * PATHS, blocks.reshape(noise.blocks.shape))


def _errors(report: SolveReport, judged_before: float, judged_after: float) -> dict[str, Any]:
    return {
        'iterations': report.mapping_iterations,
        'before': report.mapping_error_before,
        'after': report.mapping_error_after,
        'judged_before': judged_before,
        'judged_after': judged_after,
    }
