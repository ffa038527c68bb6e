# SPDX-License-Identifier: Apache-2.0
"""Where the flock is at the end of the window counts more."""

from __future__ import annotations

from dataclasses import dataclass, replace

from herding_ros.model.state import Array, Trajectory
import numpy as np

from .cost import Derivatives
from .tracking import Tracking


@dataclass(frozen=True)
class Terminal:
    """The integrand of `tracking` at the last instant T, times weight [s].

    C = w (a/2 |xc(T) - Z(T)|^2 + b/(2N) sum_i |x_i(T) - xc(T)|^2)

    It is what tracking costs over a last step of length w.
    """

    weight: float
    tracking: Tracking

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return C and its derivative by the positions of the sheep."""
        xs, vs, ds = trajectory.xs[-2:], trajectory.vs[-2:], trajectory.ds[-2:]
        last_step = Trajectory(self.weight, trajectory.n, xs, vs, ds)
        last = replace(self.tracking, reference=self.tracking.reference[-2:])
        derivative = np.zeros_like(trajectory.xs)
        value, derivative[-2:] = last.value_and_derivative(last_step)
        return value, Derivatives(x=derivative)
