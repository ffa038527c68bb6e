"""One window of the receding horizon: from a measured state to a plan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
import time
from typing import TypeVar

import numpy as np

from herding_ros.model.crowd import Crowd
from herding_ros.model.expectation import Expectation, ExpectedCentre, Noise
from herding_ros.model.flock import centre
from herding_ros.model.mean_field import mean_field
from herding_ros.model.sampling import ESTIMATORS, FineModel
from herding_ros.model.state import Array, finite, HerdState

from . import space_mapping
from .coarse_model import CentreSensitivity, CoarseModel
from .costs.cost import Cost
from .costs.tracking import Tracking
from .gauss_newton import gauss_newton
from .ncg import ncg
from .objective import Objective
from .parameters import Control
from .plan import Plan
from .reference import reference
from .solution import never, NoTimeFor, OutOfTime, Solution, Status
from .space_mapping import EXTRACTION, FINE, MappingResult
from .spg import spg

_T = TypeVar('_T')

OPTIMISERS = {'spg': spg, 'ncg': ncg}

_NODE_SPACING = 0.5
"""Time between the instants at which parameter extraction compares centres [s].

Sheep answer within 1 / friction = 2 s: a centre moves smoothly in between.
"""
_EXTRACTION_TOLERANCE = 1e-4
_EXTRACTION_ITERATIONS = 5


@dataclass(frozen=True)
class SolveReport:
    """How a plan was found."""

    status: Status
    """Of the coarse solve; a solve that did not converge is a status, not an error."""
    objective: float
    gradient_norm: float
    optimiser_iterations: int
    optimiser_calls: int
    """Evaluations of value and gradient in the coarse solve, on both time grids."""
    fine_calls: int
    """Monte Carlo evaluations of the fine model, each of all paths."""
    paths: tuple[int, ...]
    """Paths of an evaluation, by level, the finest last; empty without mapping."""
    standard_error: float
    """The largest of these evaluations' [m]; 0 without mapping."""
    extraction_calls: int
    """Rollouts of the coarse model in parameter extraction."""
    mapping_status: Status
    mapping_iterations: int
    mapping_residuals: tuple[float, ...]
    """|T(u_f) - u_c| / |u_c| of each iterate; empty without aggressive mapping."""
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


@dataclass
class RecedingHorizon:
    """Plans window after window, each solve started from what the last one found.

    The noise is drawn from the seed and shared by all evaluations of the fine model (common
    random numbers), in this and all later windows. How many paths each window takes of it, its
    first evaluation settles. `costs` are added to those that the weights ask for.
    """

    crowd: Crowd
    control: Control
    goal: Array
    seed: int = 0
    costs: Sequence[Cost] = ()
    _last: Plan | None = field(default=None, init=False)
    _noise: Noise | None = field(default=None, init=False)
    _noise_sheep: int = field(default=0, init=False)

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

    def adjust(self, crowd: Crowd, control: Control) -> None:
        """Plan with these from the next solve on."""
        self.crowd, self.control, self._noise = crowd, control, None

    def coarse_model(self, state: HerdState) -> CoarseModel:
        """Return the model without noise: the flock itself, or the limit of a large one."""
        crowd, horizon, markers = self.crowd, self.control.horizon, self.control.coarse.markers
        # Of less than two sheep to each blob the limit is no simpler, and worse.
        if len(state.x) > 2 * markers:
            crowd, state = mean_field(crowd, state, markers)
        return CoarseModel(crowd, state, horizon.dt, horizon.substeps, self.control.motion)

    def solve(self, state: HerdState, t: float, no_time_for: NoTimeFor = never) -> Window:
        """Plan the window that starts at t [s] in the given state.

        Once no_time_for says True the best so far is returned. It is asked between evaluations
        of a model, for the one that is next: 'coarse', 'fine' or 'extraction'.
        """
        clock = _Stopwatch()
        control, horizon = self.control, self.control.horizon
        coarse = self.coarse_model(state)
        with clock.phase('coarse'):
            solution = self._solve_coarse(coarse, t, partial(no_time_for, 'coarse'))
            coarse_centre = _remembering(lambda u: centre(coarse.rollout(u).x))
            wanted = coarse_centre(solution.u)
        if control.mapping.max_iterations and not no_time_for(FINE):
            expectation = self._expectation(state, t)
            mapping, extractions, expected = self._map(
                coarse, expectation, coarse_centre, solution.u, clock, no_time_for
            )
        else:
            left_out = Status.OUT_OF_TIME if control.mapping.max_iterations else Status.CONVERGED
            mapping = MappingResult(solution.u, wanted, left_out, (), ())
            extractions, expected = 0, []
        plan = Plan(t, horizon.control_period, mapping.u)
        self._last = plan
        report = SolveReport(
            status=solution.status,
            objective=solution.value,
            gradient_norm=solution.gradient_norm,
            optimiser_iterations=solution.iterations,
            optimiser_calls=solution.calls,
            fine_calls=len(expected),
            paths=expected[0].paths if expected else (),
            standard_error=max((each.standard_error for each in expected), default=0.0),
            extraction_calls=extractions,
            mapping_status=mapping.status,
            mapping_iterations=mapping.iterations,
            mapping_residuals=mapping.residuals,
            mapping_error_before=mapping.misfits[0] if mapping.misfits else 0.0,
            mapping_error_after=min(mapping.misfits, default=0.0),
            seconds=clock.seconds(),
        )
        return Window(plan, report, horizon.dt, mapping.output, coarse.rollout(plan.u).d)

    def _solve_coarse(self, coarse: CoarseModel, t: float, out_of_time: OutOfTime) -> Solution:
        """Minimise the cost of the window without noise, from the last plan on.

        Most of the way is done on the control's own time grid, where a step is cheaper.
        """
        horizon, weights = self.control.horizon, self.control.weights
        no_control: Array = np.zeros((horizon.intervals, len(coarse.state.d), 2))
        u = no_control
        if self._last is not None and self._last.u.shape == u.shape:
            u = self._last.shifted(t).u
        solutions = []
        limit = self.control.optimiser.max_iterations
        for substeps in sorted({1, coarse.substeps}):
            model = replace(coarse, dt=coarse.interval / substeps, substeps=substeps)
            steps = horizon.intervals * substeps
            times = model.dt * np.arange(steps + 1, dtype=np.float64)
            route = reference(self.control.reference, coarse.state, self.goal, times)
            objective = Objective.weighted(weights, route, no_control, self.costs)
            solutions.append(self._optimise(model, objective, u, limit, out_of_time))
            u = solutions[-1].u
            limit = -(-limit // 3)
        return replace(
            solutions[-1],
            iterations=sum(each.iterations for each in solutions),
            calls=sum(each.calls for each in solutions),
        )

    def _optimise(
        self,
        coarse: CoarseModel,
        objective: Objective,
        start: Array,
        max_iterations: int,
        out_of_time: OutOfTime,
    ) -> Solution:
        optimiser = self.control.optimiser
        return OPTIMISERS[optimiser.method](
            partial(coarse.value_and_gradient, objective),
            self._admissible,
            start,
            coarse.inner,
            optimiser.tolerance,
            max_iterations,
            out_of_time,
        )

    def _admissible(self, u: Array) -> Array:
        return self.control.motion.project(u, self.control.max_speed)

    def _map(
        self,
        coarse: CoarseModel,
        expectation: ExpectedCentre,
        coarse_centre: Callable[[Array], Array],
        u_coarse: Array,
        clock: _Stopwatch,
        no_time_for: NoTimeFor,
    ) -> tuple[MappingResult, int, list[Expectation]]:
        """Correct the coarse optimum for the noise.

        Also return the rollouts in parameter extraction, and what the fine model said.
        """
        horizon, mapping = self.control.horizon, self.control.mapping
        gamma = self.control.weights.control
        no_time_to_extract = partial(no_time_for, EXTRACTION)
        wanted = coarse_centre(u_coarse)
        every = max(round(_NODE_SPACING / horizon.dt), 1)
        calls = 0
        expected: list[Expectation] = []

        def fine(u: Array) -> Array:
            with clock.phase('fine'):
                expected.append(expectation(u))
                return expected[-1].centre

        @_remembering
        def sensitivity(u: Array) -> CentreSensitivity:
            return coarse.centre_sensitivity(u, every)

        def match(
            target: Array,
            start: Array,
            anchor: Array,
            weight: float,
            linearise: Callable[[Array], CentreSensitivity],
        ) -> Array:
            """Admissible control near the anchor under which the coarse centre is at target."""
            nonlocal calls
            with clock.phase('extraction'):
                linear = linearise(start)
                found = gauss_newton(
                    lambda u: linear.residual(coarse_centre(u) - target),
                    linearise,
                    anchor,
                    weight,
                    self._admissible,
                    start,
                    coarse.inner,
                    _EXTRACTION_TOLERANCE,
                    _EXTRACTION_ITERATIONS,
                    no_time_to_extract,
                )
                calls += found.calls
                return found.u

        def match_individuals(target: Array, start: Array) -> Array:
            nonlocal calls
            with clock.phase('extraction'):
                objective = Objective([Tracking(1.0, 1.0, target)], gamma, u_coarse)
                limit = self.control.optimiser.max_iterations
                found = self._optimise(coarse, objective, start, limit, no_time_to_extract)
                calls += found.calls
                return found.u

        def misfit(output: Array) -> float:
            return float(np.sqrt(horizon.dt * np.square(output - wanted).sum()))

        if mapping.method == 'output':
            result = space_mapping.output(
                fine,
                coarse_centre,
                # One linearisation for all: what it misses is corrected like any other defect.
                lambda target, u, damping: match(
                    target, u, u, damping, lambda _: sensitivity(u_coarse)
                ),
                misfit,
                u_coarse,
                gamma,
                mapping.accuracy * np.sqrt(horizon.length),
                mapping.max_iterations,
                no_time_for,
            )
        else:
            result = space_mapping.aggressive(
                fine,
                match_individuals
                if mapping.observable == 'individuals'
                else lambda target, start: match(target, start, u_coarse, gamma, sensitivity),
                misfit,
                self._admissible,
                u_coarse,
                coarse.inner,
                mapping.tolerance,
                mapping.min_decrease,
                mapping.max_iterations,
                no_time_for=no_time_for,
            )
        return result, calls, expected

    def _expectation(self, state: HerdState, t: float) -> ExpectedCentre:
        """Return the expected centre from a state at t [s] on, as a function of the control."""
        horizon, mapping = self.control.horizon, self.control.mapping
        steps = horizon.intervals * horizon.substeps
        motion = self.control.motion
        fine = FineModel(self.crowd, state, horizon.dt, steps, horizon.substeps, t, motion)
        estimator = ESTIMATORS[mapping.estimator]
        if self._noise is None or self._noise_sheep != fine.sheep:
            self._noise = Noise(fine, estimator, self.seed)
            self._noise_sheep = fine.sheep
        return ExpectedCentre(fine, estimator, self._noise, mapping.standard_error, mapping.paths)


def _remembering(function: Callable[[Array], _T]) -> Callable[[Array], _T]:
    """Return the same function, which computes nothing twice."""
    seen: dict[bytes, _T] = {}

    def remembered(u: Array) -> _T:
        key = u.tobytes()
        if key not in seen:
            seen[key] = function(u)
        return seen[key]

    return remembered


class _Stopwatch:
    """Seconds spent in each phase."""

    def __init__(self) -> None:
        self._seconds = {'coarse': 0.0, 'fine': 0.0, 'extraction': 0.0}
        self._started = time.perf_counter()

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self._seconds[name] += time.perf_counter() - started

    def seconds(self) -> dict[str, float]:
        return {**self._seconds, 'total': time.perf_counter() - self._started}
