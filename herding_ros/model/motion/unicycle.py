# SPDX-License-Identifier: Apache-2.0
"""Dogs on wheels: they run ahead or back, and have to turn to go elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.parameters import quantity, TINY
from herding_ros.model.state import Array
import numpy as np

from .holonomic import Holonomic
from .motion_model import MotionModel


@dataclass(frozen=True)
class Unicycle(Holonomic):
    """A robot at d with the heading e = (cos th, sin th), steered by a point ahead: S = 3.

        d' = v e,   th' = w,   v = u.e,   w = u.n / l,   n = (-sin th, cos th)

    The command u is the velocity of the point d + l e, at which the robot is as free as a
    holonomic one (d'Andrea-Novel, Bastin and Campion 1992). Over a control period the robot keeps
    v and w, which are what its wheels are told. With |u| <= l turn_rate it never has to turn
    faster than it can. The state is (d, th); sheep and other dogs see d, the middle of the robot.
    """

    turn_rate: float = quantity(0.5, 'a dog turns no faster than this', 'rad/s', low=TINY)
    ahead: float = quantity(
        0.1,
        'distance of the steered point from the middle of the dog; less than max_speed / '
        'turn_rate slows the dog down',
        'm',
        low=TINY,
    )

    def project(self, u: Array, max_speed: float) -> Array:
        """Shorten commands u (..., 2) for which a dog would run or turn too fast."""
        return super().project(u, min(max_speed, self.ahead * self.turn_rate))

    def rollout(self, d: Array, u: Array, dt: float, substeps: int) -> Array:
        """Return the states (K+1, 3, M) under u (intervals, M, 2), by the midpoint rule."""
        from .unicycle_kernels import rollout

        ds = np.empty((len(u) * substeps + 1, 3, len(d)))
        ds[0] = d.T
        rollout(ds, u, dt, substeps, self.ahead)
        return ds

    def transpose(self, ds: Array, u: Array, source: Array, dt: float, substeps: int) -> Array:
        """Return derivatives with respect to u; see `MotionModel`."""
        from .unicycle_kernels import transpose

        intervals, dogs, _ = u.shape
        several = np.ascontiguousarray(source).reshape(len(source), 3, dogs, -1)
        out = np.zeros((intervals, dogs, 2, several.shape[3]))
        transpose(several, ds, u, dt, substeps, self.ahead, out)
        return out.reshape(*u.shape, *source.shape[3:])

    def state(self, position: Array, heading: Array, velocity: Array) -> Array:
        """Return position and heading."""
        return np.column_stack([position, heading])

    def odometry(self, d: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return position, heading, and the velocity of the middle."""
        return d[:, :2], d[:, 2], (self.directions(d) @ u[..., None])[..., 0]

    def directions(self, d: Array) -> Array:
        """Return e e^T: a dog moves with the part of its command that is along its heading."""
        e = np.stack([np.cos(d[:, 2]), np.sin(d[:, 2])], axis=1)
        return e[:, :, None] * e[:, None]

    def bend(self, max_speed: float, seconds: float, distance: float) -> float:
        """Return twice how far an arc is off its tangent: v w t^2 / 2, and v w <= |u|^2 / 2l."""
        return (max_speed * seconds) ** 2 / (2.0 * self.ahead)


def steered_ahead(motion: MotionModel) -> float | None:
    """Return how far ahead of its middle a dog's command holds [m]; None if it need not turn."""
    return motion.ahead if isinstance(motion, Unicycle) else None
