"""Where the flock is at the end of the window counts more."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from herding_ros.model.state import Array, Trajectory

from .tracking import Tracking


@dataclass(frozen=True)
class Terminal:
    """The integrand of `tracking` at the last instant T, times weight [s].

    C = w (a/2 |xc(T) - Z(T)|^2 + b/(2N) sum_i |x_i(T) - xc(T)|^2)

    It is what tracking costs over a last step of length w.
    """

    weight: float
    tracking: Tracking

    def value_and_derivative(self, trajectory: Trajectory) -> tuple[float, Array]:
        """Return C and its derivative by xs."""
        derivative = np.zeros_like(trajectory.xs)
        value, derivative[-2:] = self._last.value_and_derivative(self._last_step(trajectory))
        return value, derivative

    def second_derivative(self, trajectory: Trajectory, dx: Array) -> Array:
        """Return the Hessian times dx."""
        out = np.zeros_like(dx)
        out[-2:] = self._last.second_derivative(self._last_step(trajectory), dx[-2:])
        return out

    @property
    def _last(self) -> Tracking:
        return replace(self.tracking, reference=self.tracking.reference[-2:])

    def _last_step(self, trajectory: Trajectory) -> Trajectory:
        xs, vs, ds = trajectory.xs[-2:], trajectory.vs[-2:], trajectory.ds[-2:]
        return Trajectory(self.weight, trajectory.n, xs, vs, ds)
