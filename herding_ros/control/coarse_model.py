# SPDX-License-Identifier: Apache-2.0
"""The deterministic optimal control problem: value and gradient of its reduced cost."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
import os

from herding_ros.model import kernels
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import physics, positions, reverse_sweep, rollout
from herding_ros.model.linear_algebra import times, transposed_times
from herding_ros.model.motion import Holonomic, MotionModel, returned
from herding_ros.model.state import Array, HerdState, Trajectory
import numpy as np
from numpy.typing import NDArray

from .costs.cost import Cost, Derivatives


@dataclass(frozen=True)
class CoarseModel:
    """The crowd without noise over one window, from a given state.

    dt [s] is the time step; a control is constant on intervals of `substeps` steps. motion says
    how the dogs move under it.
    """

    crowd: Crowd
    state: HerdState
    dt: float
    substeps: int = 1
    motion: MotionModel = Holonomic()

    @property
    def interval(self) -> float:
        """Time for which a control is held [s]."""
        return self.dt * self.substeps

    def on_grid(self, substeps: int) -> CoarseModel:
        """Return the same model with so many steps in an interval."""
        if substeps == self.substeps:
            return self
        return replace(self, dt=self.interval / substeps, substeps=substeps)

    def rollout(self, u: Array) -> Trajectory:
        """Return the trajectory under the control u (intervals, M, 2) [m/s]."""
        return rollout(self.crowd, self.state, u, self.dt, self.substeps, motion=self.motion)

    def transpose(self, trajectory: Trajectory, u: Array, source: Array) -> Array:
        """Return the derivative with respect to u of a function of the dogs' path.

        source (K+1, 2 or S, M, ...) is its derivative with respect to their positions or states,
        per unit of time; see `MotionModel.transpose`.
        """
        ds = trajectory.ds
        if source.shape[1] < ds.shape[1]:
            rest = (len(ds), ds.shape[1] - source.shape[1], *source.shape[2:])
            source = np.concatenate([source, np.zeros(rest)], axis=1)
        out = self.motion.transpose(ds, u, source, self.dt, self.substeps)
        return returned(self.motion, 'transpose', out, (*u.shape, *source.shape[3:]))

    def inner(self, a: Array, b: Array) -> float:
        """L2(0, T) inner product of two controls."""
        return self.interval * float((a * b).sum())

    def dogs(self, u: Array) -> Array:
        """Return the states of the dogs under u, (K+1, S, M); it takes no rollout of sheep."""
        return self.motion.rollout(self.state.d, u, self.dt, self.substeps)

    def value_and_gradient(self, cost: Cost, u: Array) -> tuple[float, Array]:
        """Return the reduced cost at u and its gradient in L2(0, T), same shape as u."""
        trajectory = self.rollout(u)
        value, by = cost.value_and_derivatives(trajectory, u)
        return value, self.gradient(trajectory, u, by)

    def gradient(self, trajectory: Trajectory, u: Array, by: Derivatives) -> Array:
        """Return the gradient in L2(0, T) of a cost with these partial derivatives.

        It is exact for the discrete problem. The reverse sweep of the sheep turns the derivative
        with respect to them into one with respect to the dogs, and the transpose of the dogs'
        motion turns that, and the cost's own, into one with respect to u (-xi_3 of the paper).
        """
        source = None if by.d is None else by.d / self.dt
        if by.x is not None:
            from_sheep = reverse_sweep(self.crowd, trajectory, by.x)
            if source is None:
                source = from_sheep
            else:
                source[:, :2] += from_sheep
        if source is None:
            return np.zeros_like(u) if by.u is None else by.u
        gradient = self.transpose(trajectory, u, source) / self.interval
        return gradient if by.u is None else gradient + by.u

    def centre_sensitivity(self, u: Array, every: int) -> CentreSensitivity:
        """Return the derivative of the sheep's centre at u, at every so many-th step.

        One reverse sweep for each of those steps and coordinates, many at once, on all cores.
        """
        trajectory = self.rollout(u)
        nodes = np.arange(every, len(trajectory.xs), every)
        at_once = kernels.PATHS // 2
        blocks = np.zeros((-(-len(nodes) // at_once), at_once), dtype=np.int_)
        blocks.flat[: len(nodes)] = nodes
        constants, d = physics(self.crowd, trajectory.n, self.dt), positions(trajectory.ds)
        shape = (*d.shape, kernels.PATHS)

        def sweep(block: NDArray[np.int_]) -> Array:
            dogs = np.empty(shape)
            kernels.centre_adjoints(
                trajectory.xs, trajectory.vs, d, block, constants, dogs.reshape(*shape[:2], -1)
            )
            rows = np.moveaxis(self.transpose(trajectory, u, dogs), -1, 0)
            return np.ascontiguousarray(rows)

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            rows = np.concatenate(list(pool.map(sweep, blocks)))[: 2 * len(nodes)]
        weight = np.sqrt(every * self.dt)
        matrix = weight * rows.reshape(2 * len(nodes), -1)
        return CentreSensitivity(matrix, nodes, weight, u.shape, self.interval)


_KEPT = 4
"""Rollouts that are kept: as many as there are plans to choose a start from."""


@dataclass(frozen=True)
class RememberingModel(CoarseModel):
    """A coarse model that keeps its last few rollouts.

    A solve starts from a plan whose cost is known, and what it ends with is looked at again.
    """

    _known: dict[bytes, Trajectory] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @classmethod
    def of(cls, model: CoarseModel) -> RememberingModel:
        """Return the same model, remembering."""
        return cls(*(getattr(model, each.name) for each in fields(model) if each.init))

    def rollout(self, u: Array) -> Trajectory:
        """See `CoarseModel`."""
        key, known = u.tobytes(), self._known
        if key not in known:
            found = super().rollout(u)
            while len(known) >= _KEPT:
                del known[next(iter(known))]
            known[key] = found
        return known[key]


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
        times(self.matrix, np.ascontiguousarray(du).ravel(), out)
        return out

    def transposed(self, e: Array) -> Array:
        """Return the adjoint of `times` in L2(0, T)."""
        out = np.empty(self.matrix.shape[1])
        transposed_times(self.matrix, e, out)
        return out.reshape(self.shape) / self.interval
