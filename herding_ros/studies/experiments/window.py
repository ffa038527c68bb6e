"""The controller's space mapping on one window, as in Table 1 of the paper."""

from __future__ import annotations

import math
from typing import Any

from herding_ros.control.parameters import Control

from .case import Case
from .settings import changed
from .variant import extraction


def run(
    sheep: int,
    dogs: int,
    sigma: float,
    seed: int,
    judge_paths: int,
    trace: bool,
    control: dict[str, Any],
) -> dict[str, Any]:
    """Plan the first window. Errors are |X - x_c| in L2(0, T) [m s^0.5].

    before, after: on the noise that the mapping has seen; judged: on other noise. residual:
    |T(u_f) - u_c| / |u_c| of the chosen control, by the paper's parameter extraction. calls:
    Monte Carlo evaluations (each of all paths), rollouts in extraction, and value and gradient
    in the coarse solve. With trace, also the centres, for a picture.
    """
    case = Case(sheep, dogs, sigma, seed, changed(Control(), control))
    u_coarse = case.deterministic.plan.u
    found = case.plan(case.control)
    report = found.report
    before, _ = case.judge(u_coarse, judge_paths)
    after, uncertainty = case.judge(found.plan.u, judge_paths)
    extracted = extraction(case, 'spg', 'centre')(found.centre, u_coarse)
    inner, change = case.coarse.inner, extracted.u - u_coarse
    result: dict[str, Any] = {
        'iterations': report.mapping_iterations,
        'status': report.mapping_status.value,
        'residual': math.sqrt(inner(change, change) / inner(u_coarse, u_coarse)),
        'residuals': list(report.mapping_residuals),
        'before': report.mapping_error_before,
        'after': report.mapping_error_after,
        'judged_before': case.error(before),
        'judged_after': case.error(after),
        'uncertainty': uncertainty,
        'calls': {
            'fine': report.fine_calls,
            'extraction': report.extraction_calls,
            'coarse': report.optimiser_calls,
        },
    }
    if trace:
        result['trace'] = {
            'wanted': case.trace(case.deterministic.centre),
            'before': case.trace(before),
            'after': case.trace(after),
        }
    return result
