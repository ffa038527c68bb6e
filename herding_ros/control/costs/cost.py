"""What a term of the cost has to offer."""

from __future__ import annotations

from typing import Protocol

from herding_ros.model.state import Array, Trajectory


class Cost(Protocol):
    """A function C of where the sheep are along a trajectory.

    A running cost is an integral over time, as right-hand Riemann sum over the steps: the start
    cannot be changed and costs nothing. Derivatives are laid out as trajectory.xs, (K+1, 2,
    lanes), and are zero in the unused lanes.
    """

    def value_and_derivative(self, trajectory: Trajectory) -> tuple[float, Array]:
        """Return C and its derivative with respect to xs, in an array of its own."""

    def second_derivative(self, trajectory: Trajectory, dx: Array) -> Array:
        """Return the Hessian of C times dx: the change of the derivative under a change of xs."""
