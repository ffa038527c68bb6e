# SPDX-License-Identifier: Apache-2.0
"""The receding horizon: window after window, from a measured state to a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from herding_ros.model.crowd import Crowd
from herding_ros.model.expectation import Expectation, ExpectedCentre, Noise
from herding_ros.model.flock import centre
from herding_ros.model.mean_field import mean_field
from herding_ros.model.sampling import ESTIMATORS, FineModel
from herding_ros.model.state import Array, finite, HerdState
import numpy as np

from .coarse_model import CoarseModel
from .costs.control_effort import ControlEffort
from .costs.cost import Cost
from .ncg import ncg
from .objective import Objective, weighted_costs
from .parameter_extraction import ParameterExtraction
from .parameters import Control
from .plan import Plan
from .pqn import pqn
from .reference import reference
from .solution import Budget, never, NoTimeFor, OutOfTime, Problem, Solution, Status
from .solve_report import SolveReport, Stopwatch
from .space_mapping import (
    aggressive_mapping,
    EXTRACTION,
    FINE,
    MappingProblem,
    MappingResult,
    MIN_DECREASE,
    output_mapping,
)
from .spg import spg
from .window import Window

OPTIMISERS = {'pqn': pqn, 'spg': spg, 'ncg': ncg}


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

        Once no_time_for returns True the best plan so far is returned. It is called between
        evaluations of a model, with the kind of the next: 'coarse', 'fine' or 'extraction'.
        """
        clock = Stopwatch()
        control, horizon = self.control, self.control.horizon
        coarse = self.coarse_model(state)
        with clock.phase('coarse'):
            solution, costs = self._solve_coarse(coarse, t, partial(no_time_for, 'coarse'))
            target = centre(coarse.rollout(solution.u).x)
        expected: list[Expectation] = []
        extraction_calls = 0
        if not control.mapping.max_iterations:
            mapping = MappingResult(solution.u, target, Status.CONVERGED)
        elif no_time_for(FINE):
            mapping = MappingResult(solution.u, target, Status.OUT_OF_TIME)
        else:
            out_of_time = partial(no_time_for, EXTRACTION)
            extraction = ParameterExtraction(
                coarse, self._admissible, solution.u, control.weights.control, costs, out_of_time
            )
            expectation = self._expectation(state, t)

            def fine(u: Array) -> Array:
                expected.append(expectation(u))
                return expected[-1].centre

            def misfit(output: Array) -> float:
                return float(np.sqrt(horizon.dt * np.square(output - target).sum()))

            problem = MappingProblem(clock.timing('fine', fine), misfit, solution.u)
            mapping = self._map(problem, extraction, coarse, clock, no_time_for)
            extraction_calls = extraction.calls
        plan = self._last = Plan(t, horizon.control_period, mapping.u)
        report = SolveReport.of(solution, mapping, expected, extraction_calls, clock.seconds())
        dogs = coarse.dogs(plan.u)[:, :2].transpose(0, 2, 1)
        return Window(plan, report, horizon.dt, mapping.output, dogs)

    def _solve_coarse(
        self, coarse: CoarseModel, t: float, out_of_time: OutOfTime
    ) -> tuple[Solution, list[Cost]]:
        """Minimise the cost of the window without noise, from the last plan on.

        Most of it is done on the control's own time grid, where a step is cheaper. Also return
        the costs on the finer one, control effort apart.
        """
        horizon, optimiser = self.control.horizon, self.control.optimiser
        gamma = self.control.weights.control
        u: Array = np.zeros((horizon.intervals, len(coarse.state.d), 2))
        if self._last is not None and self._last.u.shape == u.shape:
            u = self._last.shifted(t).u
        solutions: list[Solution] = []
        costs: list[Cost] = []
        limit = optimiser.max_iterations
        for substeps in sorted({1, coarse.substeps}):
            model = replace(coarse, dt=coarse.interval / substeps, substeps=substeps)
            steps = horizon.intervals * substeps
            times = model.dt * np.arange(steps + 1, dtype=np.float64)
            route = reference(self.control.reference, coarse.state, self.goal, times)
            costs = [*weighted_costs(self.control.weights, route), *self.costs]
            objective = Objective([*costs, ControlEffort(gamma)])
            problem = Problem(
                partial(model.value_and_gradient, objective),
                self._admissible,
                model.inner,
                self.control.max_speed,
            )
            budget = Budget(limit, optimiser.tolerance, out_of_time)
            solutions.append(OPTIMISERS[optimiser.method](problem, u, budget))
            u = solutions[-1].u
            limit = -(-limit // 3)
        solution = replace(
            solutions[-1],
            iterations=sum(each.iterations for each in solutions),
            calls=sum(each.calls for each in solutions),
        )
        return solution, costs

    def _admissible(self, u: Array) -> Array:
        return self.control.motion.project(u, self.control.max_speed)

    def _map(
        self,
        problem: MappingProblem,
        extraction: ParameterExtraction,
        coarse: CoarseModel,
        clock: Stopwatch,
        no_time_for: NoTimeFor,
    ) -> MappingResult:
        """Correct the coarse optimum for the noise."""
        mapping = self.control.mapping
        budget = Budget(mapping.max_iterations, mapping.tolerance)
        if mapping.method == 'output':
            in_norm = mapping.tolerance * np.sqrt(self.control.horizon.length)
            return output_mapping(
                problem,
                extraction.centre,
                clock.timing('extraction', extraction.near),
                self.control.weights.control,
                replace(budget, tolerance=in_norm),
                no_time_for,
            )
        return aggressive_mapping(
            problem,
            clock.timing('extraction', extraction.extract),
            self._admissible,
            coarse.inner,
            budget,
            MIN_DECREASE if mapping.tolerance else -np.inf,
            no_time_for=no_time_for,
        )

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
