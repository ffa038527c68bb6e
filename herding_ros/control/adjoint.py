"""The deterministic optimal control problem: value and gradient of its reduced cost."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import os

import numpy as np
from numpy.typing import NDArray

from herding_ros.model import kernels
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import physics, reverse_sweep, rollout
from herding_ros.model.state import Array, HerdState, Trajectory

from .costs.cost import Cost, Derivatives


@dataclass(frozen=True)
class CoarseModel:
    """The crowd without noise over one window, from a given state.

    dt [s] is the time step; a control is constant on intervals of `substeps` steps.
    """

    crowd: Crowd
    state: HerdState
    dt: float
    substeps: int = 1

    @property
    def interval(self) -> float:
        """Time for which a control is held [s]."""
        return self.dt * self.substeps

    def rollout(self, u: Array) -> Trajectory:
        """Return the trajectory under the control u (intervals, M, 2) [m/s]."""
        return rollout(self.crowd, self.state, u, self.dt, self.substeps)

    def inner(self, a: Array, b: Array) -> float:
        """L2(0, T) inner product of two controls."""
        return self.interval * float((a * b).sum())

    def dogs(self, u: Array) -> Array:
        """Return the states of the dogs under u, laid out as Trajectory.ds."""
        moves = self.dt * np.repeat(u, self.substeps, axis=0).transpose(0, 2, 1)
        return np.add.accumulate(np.concatenate((self.state.d.T[None], moves)))

    def value_and_gradient(self, cost: Cost, u: Array) -> tuple[float, Array]:
        """Return the reduced cost at u and its gradient in L2(0, T), same shape as u.

        The gradient is exact for the discrete problem: the derivative by the dogs' states, to
        which the reverse sweep through the Euler scheme brings that by the sheep, goes through
        the transpose of the dogs' motion (-xi_3 of the paper), and the derivative by u adds.
        """
        trajectory = self.rollout(u)
        value, by = cost.value_and_derivatives(trajectory, u)
        gradient = np.zeros_like(u)
        if by.x is not None:
            gradient = reverse_sweep(self.crowd, trajectory, by.x, self.substeps) / self.interval
        return value, gradient + self.dogs_gradient(trajectory.ds, u, by)

    def dogs_gradient(self, ds: Array, u: Array, by: Derivatives) -> Array:
        """Return the gradient in L2(0, T) of a cost of dogs and controls."""
        gradient = np.zeros_like(u)
        if by.d is not None:
            later = np.cumsum(by.d[:0:-1], axis=0)[::-1].transpose(0, 2, 1)
            gradient += later.reshape(len(u), -1, *later.shape[1:]).mean(axis=1)
        if by.u is not None:
            gradient += by.u
        return gradient

    def centre_sensitivity(self, u: Array, every: int) -> CentreSensitivity:
        """Return the derivative of the sheep's centre at u, at every so many-th step.

        One reverse sweep for each of those steps and coordinates, many at once, on all cores.
        """
        trajectory = self.rollout(u)
        nodes = np.arange(every, len(trajectory.xs), every)
        at_once = kernels.PATHS // 2
        blocks = np.zeros((-(-len(nodes) // at_once), at_once), dtype=np.int_)
        blocks.flat[: len(nodes)] = nodes
        constants = physics(self.crowd, trajectory.n, self.dt)
        intervals, dogs, _ = u.shape

        def sweep(block: NDArray[np.int_]) -> Array:
            rows = np.zeros((intervals, 2, dogs * kernels.PATHS))
            kernels.centre_adjoints(
                trajectory.xs, trajectory.ds, block, self.substeps, constants, rows
            )
            return rows.reshape(intervals, 2, dogs, kernels.PATHS).transpose(3, 0, 2, 1)

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            rows = np.concatenate(list(pool.map(sweep, blocks)))[: 2 * len(nodes)]
        weight = np.sqrt(every * self.dt)
        matrix = weight * rows.reshape(2 * len(nodes), -1)
        return CentreSensitivity(matrix, nodes, weight, u.shape, self.interval)


@dataclass(frozen=True)
class CentreSensitivity:
    """Derivative of the centre at some steps (`nodes`) of a window with respect to u.

    Residuals are weighted so that their sum of squares is an L2(0, T) norm squared.
    """

    matrix: Array
    nodes: NDArray[np.int_]
    weight: float
    shape: tuple[int, ...]
    interval: float

    def residual(self, difference: Array) -> Array:
        """Return a difference of centres (K+1, 2) [m] as residuals (2 nodes,)."""
        return self.weight * difference[self.nodes].ravel()

    def times(self, du: Array) -> Array:
        """Return the change of the residuals under a change du of the control."""
        out = np.empty(len(self.matrix))
        kernels.times(self.matrix, np.ascontiguousarray(du).ravel(), out)
        return out

    def transposed(self, e: Array) -> Array:
        """Return the adjoint of `times` in L2(0, T)."""
        out = np.empty(self.matrix.shape[1])
        kernels.transposed_times(self.matrix, e, out)
        return out.reshape(self.shape) / self.interval
