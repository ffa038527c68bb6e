# SPDX-License-Identifier: Apache-2.0
"""Parameter extraction: the coarse control that moves the flock's centre to a target."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from herding_ros.model.flock import centre
from herding_ros.model.state import Array

from .added_cost import AddedCost
from .coarse_model import CentreSensitivity, CoarseModel
from .costs.control_effort import ControlEffort
from .costs.cost import Cost
from .gauss_newton import gauss_newton
from .solution import Budget, never, OutOfTime, Problem, Projection, ValueAndGradient

_T = TypeVar('_T')

_NODE_SPACING = 0.25
"""Time between the instants at which centres are compared, in units of 1 / friction.

Sheep respond within 1 / friction: a centre moves smoothly in between.
"""
_FEWEST_NODES = 40
_MAX_ITERATIONS, _TOLERANCE = 5, 1e-2
"""Of a search; see `gauss_newton`."""


class ParameterExtraction:
    """Admissible controls u under which the coarse centre c(u) is near a target (paper, T).

    Minimises |c(u) - target|^2 / 2 + damping / 2 |u - anchor|^2 + D(u) in L2(0, T), with D what
    u adds to the costs of dogs and controls of the coarse optimum u_c. So a correction pays for
    what it undoes, and u_c is the minimum where there is no defect.
    """

    def __init__(
        self,
        coarse: CoarseModel,
        project: Projection,
        max_speed: float,
        u_coarse: Array,
        gamma: float,
        costs: Sequence[Cost] = (),
        out_of_time: OutOfTime = never,
    ) -> None:
        """Prepare for the window of a coarse model with the optimum u_coarse.

        max_speed [m/s] is what `project` cuts at. gamma [s^2] is the weight of control effort,
        which is the damping of `extract` and not among `costs`.
        """
        self._coarse, self._project, self._max_speed = coarse, project, max_speed
        self._u_coarse, self._gamma = u_coarse, gamma
        self._budget = Budget(_MAX_ITERATIONS, _TOLERANCE, out_of_time)
        self._added = AddedCost.to_plan(coarse, costs, u_coarse)
        every = _node_spacing(coarse, len(u_coarse))
        self.centre = remembering(lambda u: centre(coarse.rollout(u).x))
        """The coarse centre under a control, (K+1, 2) [m]."""
        self._sensitivity = remembering(lambda u: coarse.centre_sensitivity(u, every))
        self.calls = 0
        """Rollouts of the coarse model so far."""

    def near(self, target: Array, u: Array, damping: float) -> Array:
        """Return the control near u under which the centre is at target (K+1, 2) [m].

        Uses one linearisation for all u, since what it misses is a defect like any other.
        """
        added = self._added
        return self._search(
            target, u, u, damping, added, lambda _: self._sensitivity(self._u_coarse)
        )

    def extract(self, target: Array, start: Array) -> Array:
        """Return the control near u_c under which the centre is at target, searched from start."""
        u_coarse, added = self._u_coarse, self._added

        def mirrored(u: Array) -> tuple[float, Array]:
            assert added is not None
            value, gradient = added(2.0 * u_coarse - u)
            return value, -gradient

        further = None if added is None else mirrored
        return self._search(target, start, u_coarse, self._gamma, further, self._sensitivity)

    def _search(
        self,
        target: Array,
        start: Array,
        anchor: Array,
        damping: float,
        further: ValueAndGradient | None,
        linearise: Callable[[Array], CentreSensitivity],
    ) -> Array:
        coarse = self._coarse
        nodes = linearise(start)

        def regulariser(u: Array) -> tuple[float, Array]:
            change = u - anchor
            value, gradient = 0.5 * damping * coarse.inner(change, change), damping * change
            if further is None:
                return value, gradient
            more, more_gradient = further(u)
            return value + more, gradient + more_gradient

        found = gauss_newton(
            lambda u: nodes.residual(self.centre(u) - target),
            linearise,
            Problem(
                regulariser,
                self._project,
                coarse.inner,
                self._max_speed,
                step=ControlEffort(self._gamma).step,
            ),
            start,
            self._budget,
        )
        self.calls += found.calls
        return found.u


def _node_spacing(coarse: CoarseModel, intervals: int) -> int:
    """Return the number of steps between two nodes."""
    friction, steps = coarse.crowd.friction, intervals * coarse.substeps
    if not friction:
        return max(steps // _FEWEST_NODES, 1)
    return max(round(_NODE_SPACING / friction / coarse.dt), 1)


def remembering(function: Callable[[Array], _T]) -> Callable[[Array], _T]:
    """Return the same function, which computes nothing twice."""
    seen: dict[bytes, _T] = {}

    def remembered(u: Array) -> _T:
        key = u.tobytes()
        if key not in seen:
            seen[key] = function(u)
        return seen[key]

    return remembered
