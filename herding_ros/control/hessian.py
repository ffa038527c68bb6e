# SPDX-License-Identifier: Apache-2.0
"""What an optimiser learns of the curvature of a function of a control."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import copy

from herding_ros.model.linear_algebra import advance, hessian_times, smoothed, times
from herding_ros.model.state import Array
import numpy as np

Projection = Callable[[Array], Array]

_MEMORY = 10
_DAMPING = 0.2
_ITERATIONS, _TOLERANCE = 100, 0.01


class Hessian:
    """A positive definite Hessian B from the last ten steps, as in L-BFGS.

    Begun, instead of from a multiple of the identity, from B_0 = theta (S + MU) of
    `herding_ros.model.linear_algebra`, with the theta that fits the last step. In the compact form
    of Byrd, Nocedal and Schnabel (1994), with the steps s_i and the changes y_i of the gradient,

        B = B_0 - W^T [G, L; L^T, -D]^-1 W,   W = [s_i B_0; y_i],

    where G_ij = s_i.B_0 s_j, and L and D are the parts of s_i.y_j below and on the diagonal.
    """

    def __init__(self) -> None:
        """Know nothing."""
        self._theta = 0.0
        self._shape: tuple[int, ...] = ()
        self._forget_steps()

    @property
    def known(self) -> bool:
        """Whether anything is known."""
        return self._theta > 0.0

    def continued(self, shape: tuple[int, ...]) -> Hessian:
        """Return one for controls of this shape that knows what this one knows of such controls.

        What it learns stays its own.
        """
        if self._shape != shape:
            return Hessian()
        other = copy.copy(self)
        other._steps, other._smoothed = self._steps.copy(), self._smoothed.copy()
        return other

    def _forget_steps(self) -> None:
        self._steps: deque[tuple[Array, Array]] = deque(maxlen=_MEMORY)
        self._smoothed: deque[Array] = deque(maxlen=_MEMORY)
        self._gram: Array = np.empty((0, 0))
        self._cross: Array = np.empty((0, 0))
        self._w: Array = np.empty((0, 0))
        self._q: Array = np.empty((0, 0))

    def update(self, step: Array, change: Array) -> None:
        """Learn from the change of the gradient along a step, both (intervals, ...).

        Curvature that is small or negative counts as a fifth of what was expected (damping of
        Powell 1978), so that B stays positive definite; as long as nothing is known, it teaches
        nothing.
        """
        self._shape = step.shape
        s: Array = step.reshape(len(step), -1)
        y: Array = change.reshape(len(step), -1)
        smooth = np.empty_like(s)
        smoothed(s, smooth)
        curvature = float((s * y).sum())
        if self.known:
            expected = self.times(s)
            wanted = float((s * expected).sum())
            if curvature < _DAMPING * wanted:
                share = (1.0 - _DAMPING) * wanted / (wanted - curvature)
                y = share * y + (1.0 - share) * expected
        if curvature > 0.0:
            self._theta = curvature / float((s * smooth).sum())
        if (s * y).sum() > 0.0:
            self._steps.append((s, y))
            self._smoothed.append(smooth)
            self._prepare()

    def _prepare(self) -> None:
        """Compute W and the matrix between W^T and W, after a step."""
        changes = (change for _, change in self._steps)
        self._w = np.array([each.ravel() for each in (*self._smoothed, *changes)])
        products = np.empty(len(self._w))
        times(self._w, self._steps[-1][0].ravel(), products)
        along_smoothed, along_changes = np.split(products, 2)
        self._gram = _with_row(self._gram, along_smoothed)
        self._cross = _with_row(self._cross, along_changes)
        n = len(self._gram)
        middle = np.zeros((2 * n, 2 * n))
        middle[:n, :n] = self._theta * (self._gram + np.tril(self._gram, -1).T)
        middle[:n, n:] = np.tril(self._cross, -1)
        middle[n:, :n] = middle[:n, n:].T
        middle[n:, n:] = -np.diag(self._cross.diagonal())
        units = np.repeat([self._theta, 1.0], n)
        try:
            self._q = -units[:, None] * np.linalg.inv(middle) * units
        except np.linalg.LinAlgError:  # steps that are parallel but for rounding
            self._forget_steps()

    def times(self, h: Array) -> Array:
        """Return B h for h (intervals, components)."""
        out = np.empty_like(h)
        hessian_times(h, self._theta, self._w, self._q, out)
        return out

    def model_minimum(self, project: Projection, u: Array, gradient: Array) -> Array:
        """Return about where g.(w - u) + (w - u).B (w - u) / 2 is least over the set.

        By projected gradients with the exact line search of a quadratic function, until a step is
        a hundredth of the first one: to a thirtieth, an optimiser takes almost twice as long from
        a start at rest. Short and long spectral steps in turn take half as many as long ones.
        """
        rows = len(u)
        x, slope = u.reshape(rows, -1).copy(), gradient.reshape(rows, -1).copy()
        length = float((slope * slope).sum() / (slope * self.times(slope)).sum())
        first = None
        trial = x - length * slope
        for iteration in range(_ITERATIONS):
            short = iteration % 2 == 0
            trial = project(trial.reshape(u.shape)).reshape(rows, -1)
            squared, curvature = advance(trial, x, slope, self._theta, self._w, self._q, short)
            if first is None:
                first = squared
            if squared <= _TOLERANCE**2 * first:
                break
            if curvature <= 0.0:
                self._forget_steps()
                return self.model_minimum(project, u, gradient)
        return x.reshape(u.shape)


def _with_row(matrix: Array, row: Array) -> Array:
    """Return a lower triangular matrix with another row and column, without the oldest if full."""
    out = np.zeros((len(row), len(row)))
    out[:-1, :-1] = matrix[len(matrix) + 1 - len(row) :, len(matrix) + 1 - len(row) :]
    out[-1] = row
    return out
