# SPDX-License-Identifier: Apache-2.0
"""Direct optimisation of the fine model: the best that a mapping could reach, and its cost."""

from __future__ import annotations

import math
from typing import Any

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.solution import Budget, Problem
from herding_ros.control.spg import spg
from herding_ros.model.dynamics import reverse_sweep, rollout
from herding_ros.model.flock import centre
from herding_ros.model.noise import NoisePaths
from herding_ros.model.state import Array
import numpy as np

from .case import Case

_TOLERANCE = 1e-4


def pathwise_gradient(
    model: CoarseModel, noise: NoisePaths, target: Array, u: Array
) -> tuple[float, Array]:
    """Return |X(u) - reference|^2 / 2 in L2(0, T), X the mean centre over the paths; its gradient.

    The sample average is a deterministic function of u. Its derivative is the mean over the
    paths of the derivatives along each path, by the reverse sweep with that path's noise. As
    the source is known only when all paths are, all trajectories are kept. target: (K+1, 2) [m];
    the gradient is that in L2(0, T), in the shape of u (intervals, M, 2).
    """
    trajectories = [
        rollout(
            model.crowd,
            model.state,
            u,
            model.dt,
            model.substeps,
            noise.path(i),
            motion=model.motion,
        )
        for i in range(noise.paths)
    ]
    n = trajectories[0].n
    difference = np.mean([centre(each.x) for each in trajectories], axis=0) - target
    source = np.zeros_like(trajectories[0].xs)
    source[1:, :, :n] = model.dt / (n * noise.paths) * difference[1:, :, None]
    dogs = sum(reverse_sweep(model.crowd, each, source) for each in trajectories)
    gradient = model.transpose(trajectories[0], u, np.asarray(dogs))
    value = 0.5 * model.dt * float(np.square(difference[1:]).sum())
    return value, gradient / model.interval


def run(case: Case, iterations: int, judge_paths: int) -> dict[str, Any]:
    """Minimise the error of the expected centre itself, on the paths that a mapping sees.

    Starts from the deterministic plan, as a mapping does. errors: at each gradient; a gradient
    costs a rollout and a reverse sweep of every path.
    """
    u_coarse, target = case.deterministic.plan.u, case.deterministic.centre
    noise = case.draw(np.random.default_rng(case.seen), case.control.mapping.paths)
    errors: list[float] = []
    # Relative to the first value the projected gradient can be compared with a tolerance.
    model = case.coarse
    first = 0.5 * case.error(case.expected_centre(u_coarse, noise)) ** 2

    def value_and_gradient(u: Array) -> tuple[float, Array]:
        value, gradient = pathwise_gradient(model, noise, target, u)
        errors.append(math.sqrt(2.0 * value))
        return value / first, gradient / first

    problem = Problem(value_and_gradient, case.admissible, model.inner)
    found = spg(problem, u_coarse, Budget(iterations, _TOLERANCE))
    return {
        'status': found.status.value,
        'before': errors[0],
        'after': min(errors),
        'errors': errors,
        'judged': case.judged(found.u, judge_paths),
    }
