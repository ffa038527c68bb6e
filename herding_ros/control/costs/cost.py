# SPDX-License-Identifier: Apache-2.0
"""What a term of the cost provides: its value and its partial derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from herding_ros.model.state import Array, Trajectory


@dataclass(frozen=True)
class Derivatives:
    """Partial derivatives of a cost C(x, d, u); None where C does not depend on the argument.

    x: by the positions of the sheep, laid out as trajectory.xs (K+1, 2, lanes), zero in the
    unused lanes; d: by the states of the dogs, laid out as trajectory.ds (K+1, S, M);
    u: by the control, as gradient in L2(0, T), (intervals, M, 2).
    """

    x: Array | None = None
    d: Array | None = None
    u: Array | None = None

    def __add__(self, other: Derivatives) -> Derivatives:
        """Return the derivatives of the sum of two costs."""
        return Derivatives(_sum(self.x, other.x), _sum(self.d, other.d), _sum(self.u, other.u))


def _sum(a: Array | None, b: Array | None) -> Array | None:
    if a is None or b is None:
        return b if a is None else a
    return a + b


class Cost(Protocol):
    """A function C of where the sheep and the dogs are along a trajectory, and of the control.

    A running cost is an integral over time, as right-hand Riemann sum over the steps: the start
    cannot be changed and costs nothing.
    """

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return C and its partial derivatives at a trajectory of K steps.

        Sheep, dogs and the control u (intervals, M, 2) [m/s] are independent of each other here:
        that dogs move with u, and sheep with the dogs, is the caller's business. u is held for
        K / intervals steps.
        """
