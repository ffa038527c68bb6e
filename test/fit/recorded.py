# SPDX-License-Identifier: Apache-2.0
"""Recordings of our sim, without ROS."""

from __future__ import annotations

from collections.abc import Callable

from herding_ros.fit.recording import Recording
from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
import numpy as np

GOAL = np.array([0.5, 0.5])


def to_and_fro(state: HerdState, t: float) -> Array:
    """Each dog runs to and fro on its own diameter of a circle around the flock."""
    place = 2.0 * np.pi * np.arange(len(state.d)) / len(state.d)
    way = 0.9 * np.cos(0.055 * t + place)
    post = state.x.mean(axis=0) + way[:, None] * np.stack([np.cos(place), np.sin(place)], axis=1)
    return 2.0 * (post - state.dogs)


def record(
    crowd: Crowd,
    world: World,
    duration: float,
    policy: Callable[[HerdState, float], Array] = to_and_fro,
) -> Recording:
    """What the sim shows of a crowd."""
    simulation, seen = Simulation(crowd, world, GOAL), []
    times = world.control_period * np.arange(round(duration / world.control_period))
    for t in times:
        state = simulation.observe().state
        seen.append((state.x, state.v, state.dogs))
        simulation.advance(policy(state, float(t)))
    x, v, d = (np.array(part) for part in zip(*seen, strict=True))
    sensors = world.position_noise, world.velocity_noise
    return Recording(times, x, v, d, f'seed {world.seed}', *sensors)
