"""The deterministic optimal control problem: value and gradient of its reduced cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from herding_ros.model import kernels
from herding_ros.model.dynamics import physics, rollout
from herding_ros.model.parameters import Crowd
from herding_ros.model.state import Array, HerdState, Trajectory

from .objective import Objective


@dataclass(frozen=True)
class CoarseModel:
    """The crowd without noise over one window, from a given state.

    dt [s] is the time step; a control is constant on intervals of `substeps` steps.
    """

    crowd: Crowd
    state: HerdState
    dt: float
    substeps: int = 1

    @property
    def interval(self) -> float:
        """Time for which a control is held [s]."""
        return self.dt * self.substeps

    def rollout(self, u: Array) -> Trajectory:
        """Return the trajectory under the control u (intervals, M, 2) [m/s]."""
        return rollout(self.crowd, self.state, u, self.dt, self.substeps)

    def inner(self, a: Array, b: Array) -> float:
        """L2(0, T) inner product of two controls."""
        return self.interval * float(np.vdot(a, b))

    def value_and_gradient(self, objective: Objective, u: Array) -> tuple[float, Array]:
        """Return the reduced cost at u and its gradient in L2(0, T), same shape as u.

        The gradient is exact for the discrete problem: gamma (u - u_ref) + nu, with nu from
        the reverse sweep through the Euler scheme (nu is -xi_3 of the paper).
        """
        trajectory = self.rollout(u)
        value, source = objective.value_and_source(trajectory, u, self.interval)
        gradient = np.zeros_like(u)
        constants = physics(self.crowd, trajectory.n, self.dt)
        kernels.adjoint(
            trajectory.xs, trajectory.ds, source, self.substeps, constants, gradient
        )
        gradient /= self.interval
        gradient += objective.control_weight * (u - objective.control_reference)
        return value, gradient
