# SPDX-License-Identifier: Apache-2.0
"""Cost of an expected centre by estimator."""

from __future__ import annotations

import time
from typing import Any

from herding_ros.control.parameters import PAPER
from herding_ros.model.expectation import ExpectedCentre, Noise
from herding_ros.model.sampling import (
    alone,
    ESTIMATORS,
    FineModel,
    free,
    MonteCarloEstimator,
    Resolution,
)
from herding_ros.model.warmup import warm_up, warm_up_others
import numpy as np

from .case import Case


def _with_halves(fine: FineModel) -> tuple[Resolution, ...]:
    return alone(fine), Resolution(-(-fine.sheep // 2)), Resolution()


COMPARED = {
    'plain': ESTIMATORS['plain'],
    'antithetic': MonteCarloEstimator(antithetic=True),
    'free': MonteCarloEstimator(variate=free),
    'two steps': MonteCarloEstimator(lambda _: (Resolution(longer=2), Resolution()), free),
    'three steps': MonteCarloEstimator(
        lambda _: (Resolution(longer=4), Resolution(longer=2), Resolution()), free
    ),
    'halves': MonteCarloEstimator(_with_halves, free),
    'single': MonteCarloEstimator(ESTIMATORS['multilevel'].chain, free),
    'multilevel': ESTIMATORS['multilevel'],
}
_UNLIMITED = 10**6


def run(sheep: int, dogs: int, sigma: float, seed: int, standard_error: float) -> dict[str, Any]:
    """Estimate the expected centre under the plan without noise, to a standard error [m].

    For each estimator: first and again, the CPU time [s] of the first evaluation, which draws
    the noise and determines the number of paths, and of the second; work in paths of the fine
    model; off: root mean square distance from the plain estimate, which has other noise, over the
    window [m].
    """
    warm_up()
    warm_up_others()
    case = Case(sheep, dogs, sigma, seed, PAPER)
    u = case.deterministic.plan.u
    horizon = case.control.horizon
    steps = horizon.intervals * horizon.substeps
    fine = FineModel(case.crowd, case.state, horizon.dt, steps, horizon.substeps)
    found: dict[str, Any] = {}
    plain = None
    for number, (name, estimator) in enumerate(COMPARED.items()):
        noise = Noise(fine, estimator, 1000 * (1 + case.seen) + number)
        # One thread: CPU time does not depend on how threads share a core.
        expected = ExpectedCentre(fine, estimator, noise, standard_error, _UNLIMITED, threads=1)
        started = time.process_time()
        each = expected(u)
        drawn = time.process_time()
        expected(u)
        ended = time.process_time()
        plain = each if plain is None else plain
        found[name] = {
            'standard_error': each.standard_error,
            'paths': list(each.paths),
            'work': each.work,
            'first': drawn - started,
            'again': ended - drawn,
            'off': float(np.sqrt(np.square(each.centre - plain.centre).sum() / steps)),
        }
    return found
