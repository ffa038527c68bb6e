# SPDX-License-Identifier: Apache-2.0
"""What a motion model of the dogs provides."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from herding_ros.model.state import Array
import numpy as np


@runtime_checkable
class MotionModel(Protocol):
    """How M dogs move under their commands u; sheep do not affect them.

    A dog's state has S >= 2 components, its position (x, y) [m] first. A command has two, by
    default the dog's velocity [m/s]. Along a rollout of K = intervals * substeps steps of dt [s],
    the command u[k // substeps] holds during step k.
    """

    def project(self, u: Array, max_speed: float) -> Array:
        """Return the admissible command nearest to each of u (..., 2); max_speed in m/s."""

    def rollout(self, d: Array, u: Array, dt: float, substeps: int) -> Array:
        """Return the states (K+1, S, M) that follow from d (M, S) under u (intervals, M, 2)."""

    def transpose(self, ds: Array, u: Array, source: Array, dt: float, substeps: int) -> Array:
        """Apply the transpose of the derivative of `rollout` with respect to u, at ds and u.

        source (K+1, S, M, ...) is the derivative of a function with respect to the states, per
        unit of time: under a change w of the states the function changes by the sum over all
        steps of dt source w. Returns its derivative with respect to u, (intervals, M, 2, ...).
        Axes after the third are for several functions at once.
        """

    def state(self, position: Array, heading: Array, velocity: Array) -> Array:
        """Return the states (M, S) from odometry.

        position (M, 2) [m], heading (M,) [rad], velocity (M, 2) [m/s], in the map.
        """

    def odometry(self, d: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return position, heading and velocity as `state` takes them, from states d (M, S).

        u (M, 2) are the commands that have led there.
        """


@runtime_checkable
class Obedient(MotionModel, Protocol):
    """A motion of which is known how fast a dog does what a command asks for.

    The filter between plan and dogs needs that to keep them apart, see `control/separation.py`.
    The command is a velocity, at best that of the dog.
    """

    def largest_change(self, seconds: float) -> float:
        """Return by how much a command may change in a time [s] so that a dog follows [m/s]."""

    def directions(self, d: Array) -> Array | None:
        """Return matrices (M, 2, 2) that make velocities of commands, for dogs in states d (M, S).

        None: commands are the velocities.
        """

    def bend(self, max_speed: float, seconds: float, distance: float) -> float:
        """Return how far two dogs may get off straight ways while a command holds [m].

        They are so far apart [m] or farther; a command of at most max_speed [m/s] holds for
        `seconds`. Of what both get nearer to each other by that it is a bound.
        """


def check_states(motion: MotionModel, d: Array) -> None:
    """Raise ValueError unless d (M, ...) has the shape (M, S) of dogs that move like this."""
    still = np.zeros((len(d), 2))
    shape = motion.state(still, still[:, 0], still).shape
    if d.shape != shape:
        raise ValueError(
            f'dogs d must be states of {type(motion).__name__}, shape {shape}, got {d.shape}: '
            'world and controller must have motions of the same states'
        )


def returned(motion: MotionModel, method: str, out: Array, shape: tuple[int, ...]) -> Array:
    """Return what a method of a motion has returned; ValueError for another shape than this."""
    if out.shape != shape:
        raise ValueError(
            f'{type(motion).__name__}.{method} must return shape {shape}, got {out.shape}'
        )
    return out
