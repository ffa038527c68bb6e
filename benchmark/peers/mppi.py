# SPDX-License-Identifier: Apache-2.0
"""The coarse problem by sampling: model predictive path integral control (Williams et al. 2017).

Each round draws plans around the present one, with noise that is smooth over time, and takes their
mean with weights exp(-cost / temperature). The rollouts are our compiled ones, on all cores, with
one time step for each control, and without a derivative; they are all the time that it takes.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import os
import time

from benchmark.race import Race
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array
import numpy as np
from scipy.ndimage import gaussian_filter1d

_SAMPLES = 16
_SMOOTH = 3.0
"""Correlation time of the noise [s]."""
_DEVIATION = 0.3
"""Standard deviation of the noise, in units of the speed limit."""
_COLDER = 0.95
"""Factor of the noise from one round to the next."""


def solver(race: Race) -> Callable[[float], float]:
    """Return a function of so many seconds to the objective that it ends with, the target or not.

    The parameters are the best of those that were tried.
    """
    coarse, objective = race.on_control_grid()
    shape, smoothing = race.start.shape, _SMOOTH / coarse.interval

    def cost(u: Array) -> float:
        return objective.value_and_derivatives(coarse.rollout(u), u)[0]

    def solve(seconds: float) -> float:
        end = time.perf_counter() + seconds
        rng = np.random.default_rng(0)
        mean, least = race.start, np.inf
        deviation = _DEVIATION * race.control.max_speed
        found = race.value(mean)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            while time.perf_counter() < end and found > race.target:
                noise = rng.standard_normal((_SAMPLES, *shape))
                noise = gaussian_filter1d(noise, smoothing, axis=1)
                noise *= deviation / noise.std()
                plans = [race.project(mean + each) for each in noise] + [mean]
                costs = np.array(list(pool.map(cost, plans)))
                if costs.min() < least:
                    least = costs.min()
                    found = min(found, race.value(plans[int(costs.argmin())]))
                weights = np.exp((costs.min() - costs) / max(costs.std(), TINY))
                mean = np.tensordot(weights / weights.sum(), plans, axes=1)
                deviation *= _COLDER
        return found

    return solve
