# SPDX-License-Identifier: Apache-2.0
"""What a solve returns: a plan, what it is expected to do, and how it was found."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array
import numpy as np
from numpy.typing import NDArray

from .plan import Plan
from .solve_report import SolveReport


@dataclass(frozen=True)
class Window:
    """A plan with its prediction.

    centre: (K+1, 2) expected centre of the sheep [m], spread: (K+1,) without noise [m],
    dogs: (K+1, M, 2) [m], on the time grid of the prediction, dt [s]; sheep: (N,) which of them
    these are about, the others being left behind; None: all.
    """

    plan: Plan
    report: SolveReport
    dt: float
    centre: Array
    spread: Array
    dogs: Array
    sheep: NDArray[np.bool_] | None = None

    def index(self, t: float) -> int:
        """Return the number of the instant of the prediction that is nearest to t [s]."""
        return min(max(round((t - self.plan.t0) / self.dt), 0), len(self.centre) - 1)
