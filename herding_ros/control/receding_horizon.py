"""One window of the receding horizon: from a measured state to a plan."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import numpy as np

from herding_ros.model.admissible import project
from herding_ros.model.dynamics import increments
from herding_ros.model.ensemble import expected_positions
from herding_ros.model.flock import centre
from herding_ros.model.parameters import Crowd
from herding_ros.model.state import Array, HerdState, finite

from .adjoint import CoarseModel
from .ncg import ncg
from .objective import Objective
from .parameters import Control, Reference
from .plan import Plan
from .solution import Solution, Status
from .space_mapping import MappingResult, space_mapping
from .spg import spg

_OPTIMISERS = {'spg': spg, 'ncg': ncg}
_T = TypeVar('_T')


@dataclass(frozen=True)
class SolveReport:
    """How a plan was found."""

    status: Status
    """Of the coarse solve; a solve that did not converge is a status, not an error."""
    objective: float
    gradient_norm: float
    optimiser_iterations: int
    optimiser_calls: int
    """Evaluations of value and gradient, those of parameter extraction included."""
    mapping_status: Status
    mapping_iterations: int
    mapping_residuals: tuple[float, ...]
    """|T(u_f) - u_c| / |u_c| of each iterate; empty without mapping."""
    mapping_error_before: float
    """|X - x_c| in L2(0, T) [m s^0.5] under the coarse plan; 0 without mapping."""
    mapping_error_after: float
    """The same under the plan that was chosen."""
    seconds: dict[str, float]
    """Time per phase: coarse (solve), fine (Monte Carlo), extraction; and in total."""


@dataclass(frozen=True)
class Window:
    """A plan with its prediction.

    centre: (K+1, 2) expected centre of the sheep [m], dogs: (K+1, M, 2) [m], on the time
    grid of the prediction, dt [s].
    """

    plan: Plan
    report: SolveReport
    dt: float
    centre: Array
    dogs: Array


def reference(kind: Reference, start: Array, goal: Array, times: Array) -> Array:
    """Return where the centre is asked to be at the given times [s] of a window, (K+1, 2) [m].

    'interpolated' (paper, remark on the receding horizon) moves from start to goal at constant
    speed within the window; 'attainable' moves at a speed that sheep can keep, and waits.
    """
    way = goal - start
    length = float(np.linalg.norm(way))
    if kind.kind == 'interpolated':
        fraction = times / times[-1]
    else:
        fraction = np.minimum(kind.speed * times / max(length, 1e-12), 1.0)
    return start + fraction[:, None] * way


@dataclass
class RecedingHorizon:
    """Plans window after window, each solve started from what the last one found.

    The noise paths are drawn once from the seed and shared by all evaluations of the fine
    model (common random numbers), in this and all later windows.
    """

    crowd: Crowd
    control: Control
    goal: Array
    seed: int = 0
    _last: Plan | None = field(default=None, init=False)
    _noise: Array | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        """Check the goal."""
        self.goal = finite('goal', self.goal, (2,))

    @property
    def plan(self) -> Plan | None:
        """The plan of the last window; None before the first."""
        return self._last

    def due(self, t: float) -> bool:
        """Whether a new plan is due at t [s]: the accepted part of the last one is played.

        Also when t lies before the last plan, since then time was set back.
        """
        if self._last is None:
            return True
        played = self._last.index(t) * self._last.dt
        return played < 0 or played > self.control.horizon.accepted - 0.5 * self._last.dt

    def move_goal(self, goal: Array) -> None:
        """Plan for another destination (2,) [m] from the next solve on."""
        self.goal = finite('goal', goal, (2,))

    def restart(self) -> None:
        """Forget the last plan: the next solve starts from standing dogs."""
        self._last = None

    def solve(self, state: HerdState, t: float) -> Window:
        """Plan the window that starts at t [s] in the given state."""
        clock = _Stopwatch()
        horizon, control = self.control.horizon, self.control
        coarse = CoarseModel(self.crowd, state, horizon.dt, horizon.substeps)
        admissible = partial(project, max_speed=control.max_speed)
        optimise = partial(
            _OPTIMISERS[control.optimiser.method],
            project=admissible,
            inner=coarse.inner,
            tolerance=control.optimiser.tolerance,
            max_iterations=control.optimiser.max_iterations,
        )
        times = horizon.dt * np.arange(horizon.intervals * horizon.substeps + 1)
        shape = (horizon.intervals, len(state.d), 2)

        weights = control.weights
        objective = Objective(
            weights.centre,
            weights.spread,
            weights.control,
            reference(control.reference, centre(state.x), self.goal, times),
            np.zeros(shape),
        )
        solution = clock.time(
            'coarse',
            lambda: optimise(partial(coarse.value_and_gradient, objective), start=self._start(t, shape)),
        )
        u, calls, mapping = solution.u, [solution.calls], None
        trajectory = coarse.rollout(u)
        wanted = centre(trajectory.x)

        def fine(u: Array) -> Array:
            noise = self._common_noise(len(state.x), len(times) - 1)
            mean = expected_positions(
                self.crowd, state, u, horizon.dt, horizon.substeps, noise
            )
            return centre(mean)

        def extract(output: Array, start: Array) -> Array:
            individuals = control.mapping.observable == 'individuals'
            match = Objective(1.0, float(individuals), weights.control, output, solution.u)
            found = optimise(partial(coarse.value_and_gradient, match), start=start)
            calls.append(found.calls)
            return found.u

        def misfit(output: Array) -> float:
            return float(np.sqrt(horizon.dt * np.square(output - wanted).sum()))

        expected = wanted
        if control.mapping.max_iterations:
            mapping = space_mapping(
                lambda u: clock.time('fine', lambda: fine(u)),
                lambda output, start: clock.time('extraction', lambda: extract(output, start)),
                misfit,
                admissible,
                u,
                coarse.inner,
                control.mapping.tolerance,
                control.mapping.min_decrease,
                control.mapping.max_iterations,
            )
            u, expected = mapping.u, mapping.output
        self._last = Plan(t, horizon.control_period, u)
        report = _report(solution, mapping, sum(calls), clock)
        return Window(self._last, report, horizon.dt, expected, coarse.rollout(u).d)

    def _start(self, t: float, shape: tuple[int, int, int]) -> Array:
        """Return where the optimiser starts: the last plan, shifted, or standing dogs."""
        if self._last is None or self._last.u.shape != shape:
            return np.zeros(shape)
        return self._last.shifted(t).u

    def _common_noise(self, n: int, steps: int) -> Array:
        paths, dt = self.control.mapping.paths, self.control.horizon.dt
        if self._noise is None or self._noise.shape[:2] != (paths, steps):
            rng = np.random.default_rng(self.seed)
            self._noise = increments(rng, self.crowd, n, dt, steps, paths)
        return self._noise


class _Stopwatch:
    """Seconds spent in each phase."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {'coarse': 0.0, 'fine': 0.0, 'extraction': 0.0}
        self._started = time.perf_counter()

    def time(self, phase: str, work: Callable[[], _T]) -> _T:
        started = time.perf_counter()
        result = work()
        self.seconds[phase] += time.perf_counter() - started
        return result

    def total(self) -> dict[str, float]:
        return {**self.seconds, 'total': time.perf_counter() - self._started}


def _report(
    solution: Solution, mapping: MappingResult | None, calls: int, clock: _Stopwatch
) -> SolveReport:
    return SolveReport(
        status=solution.status,
        objective=solution.value,
        gradient_norm=solution.gradient_norm,
        optimiser_iterations=solution.iterations,
        optimiser_calls=calls,
        mapping_status=mapping.status if mapping else Status.CONVERGED,
        mapping_iterations=mapping.iterations if mapping else 0,
        mapping_residuals=mapping.residuals if mapping else (),
        mapping_error_before=mapping.misfits[0] if mapping else 0.0,
        mapping_error_after=min(mapping.misfits) if mapping else 0.0,
        seconds=clock.total(),
    )
