# SPDX-License-Identifier: Apache-2.0
"""What an optimiser is given and what it returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
import math

from herding_ros.model.state import Array

from .hessian import Hessian

ValueAndGradient = Callable[[Array], tuple[float, Array]]
Projection = Callable[[Array], Array]
InnerProduct = Callable[[Array, Array], float]
OutOfTime = Callable[[], bool]
"""Called between evaluations; once it returns True, the best point so far is returned."""
NoTimeFor = Callable[[str], bool]
"""The same, called with the kind of the next step: steps of one kind take about as long."""


def never(step: str = '') -> bool:
    """Return False: time without end."""
    return False


@dataclass(frozen=True)
class Problem:
    """A smooth function to be minimised over a convex set.

    value_and_gradient: the function and its gradient, which refers to the inner product `inner`;
    project: from a point to the nearest of the set; scale: a typical component of u, such as the
    speed limit, for the length of a first step; step: a factor that makes a short step of minus
    the gradient, since both may have different units; hessian: what is known from a similar
    problem, to which an optimiser may add (None: nothing).
    """

    value_and_gradient: ValueAndGradient
    project: Projection
    inner: InnerProduct
    scale: float = 1.0
    step: float = 1.0
    hessian: Hessian | None = None


@dataclass(frozen=True)
class Budget:
    """When to stop; what `tolerance` measures is the method's to say."""

    max_iterations: int
    tolerance: float = 0.0
    out_of_time: OutOfTime = never


class Status(Enum):
    """Why an iteration ended; the value is what a person reads."""

    CONVERGED = 'converged'
    ITERATION_LIMIT = 'iteration limit'
    NO_DESCENT = 'no descent'
    STAGNATED = 'stagnated'
    OUT_OF_TIME = 'out of time'
    NO_INFLUENCE = 'no influence'


@dataclass(frozen=True)
class Solution:
    """The best point an optimiser found: a status is not an error, the caller judges."""

    u: Array
    value: float
    gradient_norm: float
    """Its `criticality`."""
    status: Status
    iterations: int
    calls: int
    """Evaluations of value and gradient."""


def criticality(problem: Problem, u: Array, gradient: Array) -> float:
    """Return the norm of the projected gradient P(u - s g) - u, with s = `Problem.step`.

    It is zero at a stationary point.
    """
    step = problem.project(u - problem.step * gradient) - u
    return math.sqrt(problem.inner(step, step))
