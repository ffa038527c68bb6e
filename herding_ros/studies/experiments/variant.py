# SPDX-License-Identifier: Apache-2.0
"""The paper's Algorithm 1 with some of its parts exchanged, to measure what each contributes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math
from typing import Any

from herding_ros.control.costs.control_effort import ControlEffort
from herding_ros.control.costs.tracking import Tracking
from herding_ros.control.objective import Objective
from herding_ros.control.receding_horizon import OPTIMISERS
from herding_ros.control.solution import Budget, Problem, Solution
from herding_ros.control.space_mapping import aggressive_mapping, MappingProblem
from herding_ros.model.state import Array
import numpy as np

from .case import Case

_TOLERANCE = 1e-5
_MAX_ITERATIONS = 200
"""Extraction is solved well, so that a variant is not judged by half-done solves.

The tolerance is the length of a step for NCG, of the projected gradient for SPG.
"""


def extraction(case: Case, optimiser: str, observable: str) -> Callable[[Array, Array], Solution]:
    """Return parameter extraction T as the paper has it: (centres, start) -> coarse control.

    Minimises the cost with the fine model's centres (K+1, 2) [m] as reference and u_c as
    reference control, over centres ('centre') or, as printed, over all individuals.
    """
    weights = {'centre': (1.0, 0.0), 'individuals': (1.0, 1.0)}[observable]

    def extract(target: Array, start: Array) -> Solution:
        anchor = case.deterministic.plan.u
        gamma = case.control.weights.control
        objective = Objective([Tracking(*weights, target), ControlEffort(gamma, anchor)])
        problem = Problem(
            partial(case.coarse.value_and_gradient, objective), case.admissible, case.coarse.inner
        )
        return OPTIMISERS[optimiser](problem, start, Budget(_MAX_ITERATIONS, _TOLERANCE))

    return extract


def run(
    case: Case,
    judge_paths: int,
    iterations: int,
    optimiser: str,
    observable: str,
    common_numbers: bool,
    broyden: bool,
) -> dict[str, Any]:
    """Map one window by Algorithm 1 with some of its parts exchanged.

    optimiser: 'spg' or 'ncg', for parameter extraction; observable: 'centre' or 'individuals';
    common_numbers: the same paths in each evaluation of the fine model, or new ones; broyden: the
    quasi-Newton update, or B = I throughout. before, after: errors on the noise that the method
    has seen; judged: of the control that it chose, on other noise.
    """
    model, u_coarse = case.coarse, case.deterministic.plan.u
    rng, paths = np.random.default_rng(case.seen), case.control.mapping.paths
    common = case.draw(rng, paths) if common_numbers else None
    calls = 0

    def fine(u: Array) -> Array:
        return case.expected_centre(u, case.draw(rng, paths) if common is None else common)

    solve = extraction(case, optimiser, observable)

    def extract(target: Array, start: Array) -> Array:
        nonlocal calls
        found = solve(target, start)
        calls += found.calls
        return found.u

    mapped = aggressive_mapping(
        MappingProblem(fine, case.error, u_coarse),
        extract,
        case.admissible,
        model.inner,
        Budget(iterations),
        min_decrease=-math.inf,
        quasi_newton=broyden,
    )
    return {
        'before': mapped.misfits[0],
        'after': min(mapped.misfits),
        'misfits': list(mapped.misfits),
        'first_residual': mapped.residuals[0],
        'calls': {'fine': len(mapped.misfits), 'extraction': calls},
        'judged': case.judged(mapped.u, judge_paths),
    }
