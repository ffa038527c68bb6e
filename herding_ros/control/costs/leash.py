"""Dogs shall not run off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from herding_ros.model.state import Array, Trajectory


@dataclass(frozen=True)
class Leash:
    """Distance of the dogs from the reference.

    C = int c/2 sum_m |d_m - Z|^2 dt with c = weight and Z = reference (K+1, 2) [m]. A dog is
    where its control has brought it, so this is a function of the control, whatever sheep do.
    """

    weight: float
    reference: Array

    def value_and_gradient(self, trajectory: Trajectory, intervals: int) -> tuple[float, Array]:
        """Return C and its gradient in L2(0, T) by a control of so many intervals."""
        away = trajectory.d[1:] - self.reference[1:, None]
        value = 0.5 * trajectory.dt * self.weight * float(np.square(away).sum())
        # Each control moves its dog at all later instants.
        later = trajectory.dt * self.weight * np.cumsum(away[::-1], axis=0)[::-1]
        return value, later.reshape(intervals, -1, *away.shape[1:]).mean(axis=1)
