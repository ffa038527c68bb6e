# SPDX-License-Identifier: Apache-2.0
"""A policy of one's own against the optimal control, in noise that is twice as strong in a patch.

The policy sends each dog behind the flock, seen from the goal, and then pushes.
"""

from herding_ros import closed_loop, Control, Crowd, NoiseField, play, Simulation, World
import numpy as np

GOAL, SPEED = np.array([0.5, 0.5]), 0.05
crowd = Crowd(noise_field=NoiseField(patch=1.0, patch_centre=(0.2, 0.2), patch_radius=0.2))
world = World(sheep=20, dogs=5, seed=3)


def push(observed, t):
    """Return the velocities (M, 2) of the dogs."""
    centre = observed.x.mean(axis=0)
    away = (centre - GOAL) / np.linalg.norm(centre - GOAL)
    across = np.array([-away[1], away[0]])
    reach = np.linalg.norm(observed.x - centre, axis=1).max() + 0.2
    places = np.linspace(-0.5, 0.5, len(observed.d))[:, None] * across
    wanted = centre + reach * away + places - observed.d[:, :2]
    return SPEED * wanted / np.maximum(np.linalg.norm(wanted, axis=1, keepdims=True), 0.05)


own = play(Simulation(crowd, world, GOAL), push, time_limit=100.0)
best = closed_loop(crowd, world, Control(), GOAL, time_limit=100.0)
for name, run in (('policy', own), ('optimal control', best)):
    effort = (run.u**2).sum() * world.control_period
    print(f'{name}: {run.arrived} {run.t[-1]:.1f} s, energy {effort:.3f} m^2/s')
