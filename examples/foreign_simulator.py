# SPDX-License-Identifier: Apache-2.0
"""The controller herds in a simulator of somebody else: here, sheep on a meadow that slopes.

Told how dogs are felt, 0.02 exp(-2 r), it believes in flat ground and sheep that go alone.
"""

from herding_ros import Control, Crowd, HerdState, Mapping, Observation, RecedingHorizon, steer
from herding_ros.model.potentials import Morse
import numpy as np

GOAL, SLIDE = np.array([0.4, 0.4]), np.array([0.002, 0.0])  # [m], [m/s]
CROWD = Crowd(Morse(0.0, 1.0, 0.0, 1.0), Morse(0.01, 0.5, 0.0, 1.0), friction=0.5, order=1)


class Meadow:
    """A plant for `steer`: ten sheep that flee three dogs, stay together, and slide right."""

    control_period = 0.1  # [s]

    def __init__(self, seed):
        """Start from the seed."""
        x = 0.2 * np.random.default_rng(seed).standard_normal((10, 2))
        d = np.array([[-0.9, -0.3], [-0.6, -0.6], [-0.3, -0.9]])
        self.state, self.dog_velocities = HerdState(x, np.zeros_like(x), d), np.zeros_like(d)

    @property
    def arrived(self):
        """Whether the flock's centre is at the goal."""
        return np.linalg.norm(self.state.x.mean(axis=0) - GOAL) < 0.1

    def observe(self):
        """Return what the sensors see: here, everything."""
        return Observation(self.state, self.dog_velocities)

    def advance(self, u):
        """Move on by one control period under the dogs' velocities u (M, 2) [m/s]."""
        x, d = self.state.x, self.state.d
        r = np.linalg.norm(apart := x[:, None] - d, axis=2, keepdims=True)
        v = (0.04 * np.exp(-2.0 * r) * apart / r).sum(axis=1) + SLIDE + 0.05 * (x.mean(axis=0) - x)
        self.state, self.dog_velocities = HerdState(x + 0.1 * v, v, d + 0.1 * u), u


planner = RecedingHorizon(CROWD, Control(mapping=Mapping(max_iterations=0)), GOAL)
run = steer(Meadow(seed=1), planner, time_limit=150.0)
print(f'arrived: {run.arrived}, after {run.t[-1]:.1f} s in {len(run.reports)} plans')
