"""What an optimiser is given and what it returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
import math

from herding_ros.model.state import Array

ValueAndGradient = Callable[[Array], tuple[float, Array]]
Projection = Callable[[Array], Array]
InnerProduct = Callable[[Array, Array], float]
OutOfTime = Callable[[], bool]
"""Asked between evaluations; once it says True, the best so far is returned."""
NoTimeFor = Callable[[str], bool]
"""The same, asked with the kind of step that is next: steps of one kind take about as long."""


class Status(Enum):
    """Why an iteration ended; the value is what a person reads."""

    CONVERGED = 'converged'
    ITERATION_LIMIT = 'iteration limit'
    NO_DESCENT = 'no descent'
    STAGNATED = 'stagnated'
    OUT_OF_TIME = 'out of time'


@dataclass(frozen=True)
class Solution:
    """The best point an optimiser found: a status is no error, the caller judges."""

    u: Array
    value: float
    gradient_norm: float
    """Its `criticality`."""
    status: Status
    iterations: int
    calls: int
    """Evaluations of value and gradient."""


def never(step: str = '') -> bool:
    """Return False: time without end."""
    return False


def criticality(project: Projection, u: Array, gradient: Array, inner: InnerProduct) -> float:
    """Norm of the projected gradient P(u - g) - u: zero at a stationary point."""
    step = project(u - gradient) - u
    return math.sqrt(inner(step, step))
