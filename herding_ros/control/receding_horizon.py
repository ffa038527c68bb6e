# SPDX-License-Identifier: Apache-2.0
"""The receding horizon: window after window, and feedback in between.

A window is planned from a measured state, and corrected for the noise by the space mapping. A
feedback improves the plan from a newer state by a few iterations of the coarse solve. Where
`mapping.feedback` asks for it, the defect, by which the expected centre is off the coarse model's,
is kept: in a feedback the flock is expected where the coarse model has it plus that defect.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
import itertools
from numbers import Integral

from herding_ros.model.crowd import Crowd
from herding_ros.model.expectation import Expectation, ExpectedCentre, Noise
from herding_ros.model.flock import centre, spread
from herding_ros.model.mean_field import mean_field
from herding_ros.model.motion import check_states
from herding_ros.model.sampling import ESTIMATORS, FineModel
from herding_ros.model.state import Array, finite, HerdState, Trajectory
import numpy as np
from numpy.typing import NDArray

from .blur import blurred
from .coarse_model import CoarseModel, RememberingModel
from .costs.checked import Checked
from .costs.control_effort import ControlEffort
from .costs.cost import Cost
from .dog_force import DogForce, Felt
from .drift import Drift
from .hessian import Hessian
from .ncg import ncg
from .objective import Objective
from .parameter_extraction import ParameterExtraction
from .parameters import Control
from .plan import Plan, SLACK
from .pqn import pqn
from .response import Response
from .solution import Budget, never, NoTimeFor, Problem, Projection, Solution, Status
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
from .task import RULES, Task
from .window import Window

OPTIMISERS = {'pqn': pqn, 'spg': spg, 'ncg': ncg}

_NO_INFLUENCE = 1e-3
"""Sheep that dogs move by less than this part of the standoff are not influenced."""


@dataclass(frozen=True)
class _Planned:
    """A plan, which sheep (N,) it is for, the centre expected of them, and the mapping's defect.

    Centre and defect are (intervals + 1, 2) [m]. The defect, the expected minus the coarse centre,
    grows with time from a state that is known. So the best guess of that of a plan from a newer
    state is the same, not shifted in time.
    """

    plan: Plan
    sheep: NDArray[np.bool_]
    centre: Array
    defect: Array


@dataclass(frozen=True)
class _Coarse:
    """What the coarse solve has found, on the finest time grid.

    predicted: under it; drifted: what the drift adds to the centre (K+1, 2) [m]; costs: control
    effort apart; fetches: whether dogs have strays to fetch.
    """

    solution: Solution
    predicted: Trajectory
    drifted: Array
    costs: list[Cost]
    fetches: bool


@dataclass
class RecedingHorizon:
    """Plans window after window, each solve started from what the last one found.

    The noise is drawn from the seed and shared by all evaluations of the fine model (common
    random numbers), in this and all later windows. How many paths each window takes of it, its
    first evaluation settles. `costs` are added to those that the weights ask for.
    Raises ValueError for a goal that is not (2,) [m], a seed below 0, and costs that are no list.
    """

    crowd: Crowd
    control: Control
    goal: Array
    seed: int = 0
    costs: Sequence[Cost] = ()
    _planned: list[_Planned] = field(default_factory=list, init=False)  # by their starts
    felt: Felt = field(init=False)
    """Dogs as plans take them to be felt, from what was learned."""
    _dog_force: DogForce = field(init=False)
    _drift: Drift = field(init=False)
    _response: Response = field(init=False)
    _hessian: Hessian = field(init=False)
    _turns: Iterator[str] = field(default_factory=lambda: itertools.cycle(RULES), init=False)
    _noise: Noise | None = field(default=None, init=False)
    _noise_sheep: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        """Check the goal, the seed and that there is a list of costs."""
        self.goal = finite('goal', self.goal, (2,))
        if not isinstance(self.seed, Integral) or self.seed < 0:
            raise ValueError(f'seed must be an integer of at least 0, got {self.seed!r}')
        if not isinstance(self.costs, Sequence):
            raise ValueError(f'costs must be a list of costs, got {self.costs!r}')
        self._forget()

    @property
    def plan(self) -> Plan | None:
        """The plan that begins last; None before the first."""
        return self._planned[-1].plan if self._planned else None

    def move_goal(self, goal: Array) -> None:
        """Plan for another destination (2,) [m] from the next solve on."""
        self.goal = finite('goal', goal, (2,))

    def restart(self) -> None:
        """Forget all plans: the next solve starts from standing dogs."""
        self._planned, self._turns = [], itertools.cycle(RULES)
        self._forget()

    def adjust(self, crowd: Crowd, control: Control) -> None:
        """Plan with these from the next solve on."""
        self.crowd, self.control, self._noise = crowd, control, None
        self._forget()

    def _forget(self) -> None:
        """Forget what was learned of the crowd."""
        self._drift, self._response, self._hessian = Drift(), Response(), Hessian()
        self._dog_force, self.felt = DogForce(self.crowd, self.control), Felt()

    @property
    def _felt_crowd(self) -> Crowd:
        """The crowd with dogs as they are felt."""
        return self.felt.crowd(self.crowd)

    def learn(self, state: HerdState, t: float) -> None:
        """Compare the herd that is seen at t [s] with what was expected of it at the last look."""
        control, horizon, last = self.control, self.control.horizon, self._playing(t)
        few = len(state.x) <= 2 * control.coarse.markers
        if control.arrival.strays and few:
            self._response.learn(self.crowd, control, state, t)
        if not horizon.has_feedback:
            return
        if few:
            herded = self._response.herded(state.x, control.arrival.strays)
            self._dog_force.learn(state, t, herded)
            self.felt = self._dog_force.felt()
        if last is None or len(last.sheep) != len(state.x):
            return
        periods = round((t - last.plan.t0) / horizon.control_period)
        if 0 < periods < len(last.centre):
            error = centre(state.x[last.sheep]) - last.centre[periods]
            elapsed = periods * horizon.control_period
            self._drift.learn(self.crowd, error, elapsed, horizon.accepted, control.max_speed)

    def coarse_model(self, state: HerdState) -> CoarseModel:
        """Return the model without noise: the flock itself, or the limit of a large one."""
        check_states(self.control.motion, state.d)
        crowd, horizon = self._felt_crowd, self.control.horizon
        markers = self.control.coarse.markers
        # Of less than two sheep to each blob the limit is no simpler, and worse.
        if len(state.x) > 2 * markers:
            crowd, state = mean_field(crowd, state, markers)
        if horizon.has_feedback:
            crowd = blurred(crowd, horizon.feedback, self.control.max_speed)
        return CoarseModel(crowd, state, horizon.dt, horizon.substeps, self.control.motion)

    def solve(self, state: HerdState, t: float, no_time_for: NoTimeFor = never) -> Window:
        """Plan the window that starts at t [s] in the given state.

        Once no_time_for returns True the best plan so far is returned. It is called between
        evaluations of a model, with the kind of the next: 'coarse', 'fine' or 'extraction'.
        """
        clock = Stopwatch()
        control, horizon = self.control, self.control.horizon
        which = self._response.herded(state.x, control.arrival.strays)
        state = state.of_sheep(which)
        coarse = RememberingModel.of(self.coarse_model(state))
        budget = Budget(
            control.optimiser.max_iterations,
            control.optimiser.tolerance_of_method,
            partial(no_time_for, 'coarse'),
        )
        with clock.phase('coarse'):
            found = self._solve_coarse(coarse, t, budget)
            solution = found.solution
            target = centre(found.predicted.x)
        expected: list[Expectation] = []
        extraction_calls = 0
        if not control.mapping.max_iterations or found.fetches:
            # While strays are fetched it is not the centre that counts.
            mapping = MappingResult(solution.u, target, Status.CONVERGED)
        elif no_time_for(FINE):
            mapping = MappingResult(solution.u, target, Status.OUT_OF_TIME)
        else:
            out_of_time = partial(no_time_for, EXTRACTION)
            extraction = ParameterExtraction(
                coarse,
                self._admissible,
                control.max_speed,
                solution.u,
                control.weights.control,
                found.costs,
                out_of_time,
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
        with clock.phase('coarse'):
            predicted = coarse.rollout(mapping.u)
        plan = Plan(t, horizon.control_period, mapping.u)
        defect = mapping.output - centre(predicted.x)
        expected_centre = mapping.output + found.drifted
        # It may be planned ahead: until it starts, what was planned before is played.
        played = [each for each in self._planned if each.plan.end > t + SLACK]
        by_period = slice(None, None, horizon.substeps)
        planned = _Planned(plan, which, expected_centre[by_period], defect[by_period])
        self._planned = _in_order([*played, planned])
        report = SolveReport.of(
            'window', solution, mapping, expected, extraction_calls, self.felt, clock.seconds()
        )
        return Window(
            plan, report, horizon.dt, expected_centre, spread(predicted.x), predicted.d, which
        )

    def improve(self, state: HerdState, t: float, no_time_for: NoTimeFor = never) -> Window:
        """Improve the plan that is played at t [s] in the given state, by few iterations.

        The plan that is returned starts at t and is as long as a window. It is predicted on the
        control's own time grid. no_time_for is called with 'coarse' or 'fine', see `solve`.
        """
        clock = Stopwatch()
        which = self._response.herded(state.x, self.control.arrival.strays)
        state = state.of_sheep(which)
        optimiser, horizon = self.control.optimiser, self.control.horizon
        corrects = self.control.mapping.feedback
        coarse = RememberingModel.of(self.coarse_model(state).on_grid(1))
        budget = Budget(
            optimiser.feedback_iterations,
            optimiser.tolerance_of_method,
            partial(no_time_for, 'coarse'),
        )
        last = self._playing(t)
        defect: Array = np.zeros((horizon.intervals + 1, 2))
        if corrects and last is not None and last.defect.shape == defect.shape:
            defect = last.defect
        rule = next(self._turns)  # all of them would take too long
        with clock.phase('coarse'):
            found = self._solve_coarse(coarse, t, budget, defect, [rule])
        solution, predicted = found.solution, found.predicted
        expected: list[Expectation] = []
        if corrects and not no_time_for(FINE):
            with clock.phase('fine'):
                expected.append(self._expectation(state, t)(solution.u))
            defect = expected[0].centre[:: horizon.substeps] - centre(predicted.x)
        output = centre(predicted.x) + defect
        expected_centre = output + found.drifted
        plan = Plan(t, horizon.control_period, solution.u)
        waiting = [each for each in self._planned if each.plan.t0 > t + SLACK]
        planned = _Planned(plan, which, expected_centre, defect)
        self._planned = _in_order([planned, *waiting])
        mapping = MappingResult(solution.u, output, Status.CONVERGED)
        report = SolveReport.of(
            'feedback', solution, mapping, expected, 0, self.felt, clock.seconds()
        )
        return Window(
            plan, report, horizon.control_period, expected_centre, spread(predicted.x),
            predicted.d, which,
        )  # fmt: skip

    def _playing(self, t: float) -> _Planned | None:
        """Return the plan that is played at t [s]: of those that have begun, the last."""
        begun = [each for each in self._planned if each.plan.t0 <= t + SLACK]
        return begun[-1] if begun else None

    def _solve_coarse(
        self,
        coarse: CoarseModel,
        t: float,
        budget: Budget,
        defect: Array | float = 0.0,
        rules: Sequence[str] = tuple(RULES),
    ) -> _Coarse:
        """Minimise the cost of the window without noise, from the best plan at hand.

        These are the plan that is played on and what the given rules would do. The plan that is
        found costs no more than any of them. The flock is expected where the coarse model has it
        plus the defect, on the finest time grid. Most of the work is done on the control's own,
        where a step is cheaper.
        """
        horizon, optimiser = self.control.horizon, self.control.optimiser
        control_effort = ControlEffort(self.control.weights.control)
        task = Task.of(self.control, coarse, self.goal)
        candidates = {'last plan': self._played_on(t, len(coarse.state.d))}
        if not budget.out_of_time():
            candidates |= task.rule_plans(coarse.on_grid(1), rules)
        solutions: list[Solution] = []
        limit = budget.max_iterations
        # The curvature hardly depends on the time grid, nor on the second in which a plan begins.
        hessian = self._hessian = self._hessian.continued(candidates['last plan'].shape)
        for substeps in sorted({1, coarse.substeps}):
            model = coarse.on_grid(substeps)
            times = model.dt * np.arange(horizon.intervals * substeps + 1, dtype=np.float64)
            drifted = self._drift.path(self.crowd, times)
            costs = [*task.costs(times, defect + drifted), *map(Checked, self.costs)]
            objective = Objective([*costs, control_effort])
            value = partial(_value, model, objective, self._admissible)
            values = {name: value(u) for name, u in candidates.items()}
            name = min(values, key=values.__getitem__)
            problem = Problem(
                partial(model.value_and_gradient, objective),
                self._admissible,
                model.inner,
                self.control.max_speed,
                hessian,
                control_effort.step,
            )
            minimise = OPTIMISERS[optimiser.method]
            start = candidates[name]
            solutions.append(minimise(problem, start, replace(budget, max_iterations=limit)))
            candidates[name] = solutions[-1].u
            limit = -(-limit // 3)
        solution = replace(
            solutions[-1],
            iterations=sum(each.iterations for each in solutions),
            calls=sum(each.calls for each in solutions),
        )
        predicted = coarse.rollout(solution.u)
        hurried = solution.status is Status.OUT_OF_TIME
        if not hurried and self._is_without_influence(coarse, predicted, task):
            solution = replace(solution, status=Status.NO_INFLUENCE)
        fetches = task.errands is not None and len(task.errands.dogs) > 0
        return _Coarse(solution, predicted, drifted, costs, fetches)

    def _played_on(self, t: float, dogs: int) -> Array:
        """Return the control (intervals, M, 2) of the plan that is played at t [s], continued."""
        u: Array = np.zeros((self.control.horizon.intervals, dogs, 2))
        last = self._playing(t)
        return last.plan.shifted(t).u if last is not None and last.plan.u.shape == u.shape else u

    def _is_without_influence(
        self, coarse: CoarseModel, predicted: Trajectory, task: Task
    ) -> bool:
        """Whether sheep that are not home go as they would if the dogs stood."""
        if task.reach is None:
            return True
        if float(np.linalg.norm(task.start - self.goal)) <= task.reach.standoff:
            return False
        stand = np.zeros((self.control.horizon.intervals, len(coarse.state.d), 2))
        moved = predicted.x[-1] - coarse.rollout(stand).x[-1]
        return float(np.abs(moved).max()) < _NO_INFLUENCE * task.reach.standoff

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
        if mapping.method == 'output':
            in_norm = mapping.tolerance * np.sqrt(self.control.horizon.length)
            return output_mapping(
                problem,
                extraction.centre,
                clock.timing('extraction', extraction.near),
                self.control.weights.control,
                Budget(mapping.max_iterations, in_norm),
                no_time_for,
            )
        return aggressive_mapping(
            problem,
            clock.timing('extraction', extraction.extract),
            self._admissible,
            coarse.inner,
            Budget(mapping.max_iterations, mapping.residual),
            MIN_DECREASE if mapping.residual else -np.inf,
            no_time_for=no_time_for,
        )

    def _expectation(self, state: HerdState, t: float) -> ExpectedCentre:
        """Return the expected centre from a state at t [s] on, as a function of the control."""
        horizon, mapping = self.control.horizon, self.control.mapping
        steps = horizon.intervals * horizon.substeps
        motion = self.control.motion
        fine = FineModel(self._felt_crowd, state, horizon.dt, steps, horizon.substeps, t, motion)
        estimator = ESTIMATORS[mapping.estimator]
        if self._noise is None or self._noise_sheep != fine.sheep:
            self._noise = Noise(fine, estimator, self.seed)
            self._noise_sheep = fine.sheep
        return ExpectedCentre(fine, estimator, self._noise, mapping.standard_error, mapping.paths)


def _value(model: CoarseModel, objective: Objective, project: Projection, u: Array) -> float:
    """Return the cost of the admissible control nearest to u."""
    u = project(u)
    return objective.value_and_derivatives(model.rollout(u), u)[0]


def _in_order(planned: list[_Planned]) -> list[_Planned]:
    """Return them by their starts, of two with the same start the newer last."""
    return sorted(planned, key=lambda each: each.plan.t0)
