"""The cost J of a plan and its partial derivatives (paper, cost functional)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from herding_ros.model import kernels
from herding_ros.model.state import Array, Trajectory


@dataclass(frozen=True)
class Objective:
    """Tracking cost of a trajectory x of N sheep under a control u.

    J = int a/2 |xc - Z|^2 + b/(2N) sum_i |x_i - xc|^2
            + gamma/2 |u - u_ref|^2 + c/2 sum_m |d_m - Z|^2 dt

    with xc the centre of mass, a = centre_weight, b = spread_weight, gamma = control_weight,
    c = dogs_weight, Z = reference (K+1, 2) [m] and u_ref = control_reference (intervals, M, 2)
    [m/s]. Since 1/N sum |x_i - Z|^2 = |xc - Z|^2 + 1/N sum |x_i - xc|^2, the paper's cost is
    a = b = 1, c = 0. Integrals are right-hand Riemann sums: the start cannot be changed and
    costs nothing.
    """

    centre_weight: float
    spread_weight: float
    control_weight: float
    reference: Array
    control_reference: Array
    dogs_weight: float = 0.0

    def value_and_derivatives(
        self, trajectory: Trajectory, u: Array, interval: float
    ) -> tuple[float, Array, Array]:
        """Return J and its derivatives at fixed controls and at fixed sheep.

        The first is the partial derivative with respect to x, shape of trajectory.xs; the
        second the gradient in L2(0, T) of the cost of controls and dogs, shape of u, since a
        dog is where its control has brought it. interval [s] is the time for which each u
        (intervals, M, 2) [m/s] is held.
        """
        source = np.empty_like(trajectory.xs)
        tracking = kernels.tracking_cost(
            trajectory.xs,
            self.reference,
            trajectory.n,
            self.centre_weight,
            self.spread_weight,
            trajectory.dt,
            source,
        )
        change = u - self.control_reference
        effort = 0.5 * interval * self.control_weight * float(np.square(change).sum())
        direct = self.control_weight * change
        value = tracking + effort
        if self.dogs_weight:
            away = trajectory.d[1:] - self.reference[1:, None]
            value += 0.5 * trajectory.dt * self.dogs_weight * float(np.square(away).sum())
            # Each control moves its dog at all later instants.
            later = trajectory.dt * self.dogs_weight * np.cumsum(away[::-1], axis=0)[::-1]
            direct += later.reshape(len(u), -1, *u.shape[1:]).mean(axis=1)
        return value, source, direct
