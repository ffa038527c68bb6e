# SPDX-License-Identifier: Apache-2.0
"""A cost of one's own: two dogs closer than 0.3 m to each other are penalised."""

from dataclasses import dataclass

from herding_ros import closed_loop, Control, Crowd, Derivatives, World
import numpy as np


@dataclass(frozen=True)
class Spacing:
    """The integral over time of w/2 sum max(r - |d_a - d_b|, 0)^2 over all pairs of dogs."""

    weight: float  # w
    distance: float  # r [m]

    def value_and_derivatives(self, trajectory, u):
        """Return the cost and its derivative with respect to the dogs."""
        d = trajectory.ds[1:, :2]  # (K, 2, M); the start costs nothing
        between = d[:, :, :, None] - d[:, :, None, :]
        length = np.linalg.norm(between, axis=1) + 1e-12
        missing = np.triu(np.maximum(self.distance - length, 0.0), k=1)
        by_d = np.zeros_like(trajectory.ds)
        force = self.weight * (missing / length)[:, None] * between
        by_d[1:, :2] = force.sum(axis=2) - force.sum(axis=3)
        value = 0.5 * self.weight * trajectory.dt * (missing**2).sum()
        return value, Derivatives(d=by_d)


for weight in (0.0, 1.0):
    costs = [Spacing(weight, distance=0.3)]
    run = closed_loop(Crowd(), World(sheep=10), Control(), [0.3, 0.3], 100.0, costs)
    one, other = np.triu_indices(5, k=1)
    closest = np.linalg.norm(run.d[:, one] - run.d[:, other], axis=-1).min()
    print(f'weight {weight:g}: {run.arrived} {run.t[-1]:.1f} s, closest {closest:.3f} m')
