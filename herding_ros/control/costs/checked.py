# SPDX-License-Identifier: Apache-2.0
"""A cost that the user has handed in, with its answers checked."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array, finite, Trajectory
import numpy as np

from .cost import Cost, Derivatives


@dataclass(frozen=True)
class Checked:
    """The same cost, but NaN and wrong shapes are refused: broadcast, they would be another cost.

    Numbers are in double precision, whatever the cost computes in: so is their sum.
    """

    cost: Cost

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return what the cost does; ValueError if that is not what `Cost` asks for."""
        value, by = self.cost.value_and_derivatives(trajectory, u)
        if not np.isfinite(trajectory.xs[-1]).all():  # no cost is finite, and no plan taken
            return value, by
        name = type(self.cost).__name__
        parts = (('x', by.x, trajectory.xs), ('d', by.d, trajectory.ds), ('u', by.u, u))
        return float(finite(f'the value of {name}', value, ())), Derivatives(
            *(
                None if part is None
                else finite(f'the derivative of {name} by {of}', part, like.shape)
                for of, part, like in parts
            )
        )  # fmt: skip
