# SPDX-License-Identifier: Apache-2.0
"""The pilot decides what the dogs do, given the time and what was observed. No ROS.

Two pilots share what is here: the filter, the goal and the count of what went wrong. They differ
in how they keep time: `LockstepPilot` replies to each observation, however long a solve takes;
`RealTimePilot` gives commands by its own clock and plans ahead in the background.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
import math
import threading
from typing import Protocol

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.field import field_of
from herding_ros.model.flock import centre, distance, spread, without_strays
from herding_ros.model.motion import Obedient
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array, finite, HerdState
import numpy as np
from numpy.typing import NDArray

from .command_filter import CommandFilter, keeps_distances
from .estimator import StateEstimator
from .obedience import Judgement, Obedience
from .parameters import Control
from .plan import SLACK
from .schedule import ScheduledPlan
from .solution import NoTimeFor, Status
from .solve_report import SolveReport
from .surprise import Surprise, surprise
from .window import Window
from .zero_velocities import ZeroVelocities

_NAMED = 10
"""Of no more lost sheep the names are told."""

_TRIAL = 5.0
"""Every so many times `dog_timeout` a dog that does not do as told is tried for that time."""

_REPEAT = 30.0
"""Time after which an event is reported again that has occurred again [s]."""


class Planner(Protocol):
    """Plans a window from a state; `RecedingHorizon` is one."""

    crowd: Crowd
    control: Control
    goal: Array

    def move_goal(self, goal: Array) -> None:
        """Plan for another goal (2,) [m] from the next solve on."""

    def restart(self) -> None:
        """Start the next solve from standing dogs."""

    def adjust(self, crowd: Crowd, control: Control) -> None:
        """Plan with these from the next solve on."""

    def learn(self, state: HerdState, t: float) -> None:
        """Compare the herd that is seen at t [s] with what was expected; before each plan."""

    def solve(self, state: HerdState, t: float, no_time_for: NoTimeFor = ...) -> Window:
        """Plan the window that starts at t [s] in the given state."""

    def improve(self, state: HerdState, t: float, no_time_for: NoTimeFor = ...) -> Window:
        """Improve the plan that is played at t [s] in the given state, from there on."""


@dataclass(frozen=True)
class Observed:
    """The sheep and the visible dogs at an instant.

    stamp: time [ns]; ids: (N,) names of the sheep; state: of these sheep and of the visible
    dogs; dogs: these, by their indices from 0; is_velocity_seen: (N,), None: all. Of the other
    sheep only the positions count.
    """

    stamp: int
    ids: NDArray[np.integer]
    state: HerdState
    dogs: tuple[int, ...]
    is_velocity_seen: NDArray[np.bool_] | None = None

    @classmethod
    def complete(cls, t: float, state: HerdState, velocities: bool = True) -> Observed:
        """Return an observation at t [s] of all sheep, named by their rows, and all dogs.

        Without velocities of sheep these are 0, and only the positions count.
        """
        ids, dogs = np.arange(len(state.x)), tuple(range(len(state.d)))
        if velocities:
            return cls(round(t * 1e9), ids, state, dogs)
        blind = replace(state, v=np.zeros_like(state.v))
        return cls(round(t * 1e9), ids, blind, dogs, np.zeros(len(ids), dtype=np.bool_))

    @property
    def t(self) -> float:
        """Time [s]."""
        return self.stamp * 1e-9


@dataclass(frozen=True)
class Announcement:
    """A new plan: its number from 0, and by how much it was ready before its start [s]."""

    plan: ScheduledPlan
    number: int
    margin: float


@dataclass(frozen=True)
class Event:
    """Something that a person should read; level: 'info', 'warning' or 'error'."""

    level: str
    text: str


@dataclass(frozen=True)
class Decision:
    """What the pilot decided.

    command: velocities (M, 2) [m/s] of all dogs; None before the first plan. announcement: a plan
    that is new. events: what has changed or gone wrong. error: why a plan was not made, if so.
    asked: what the plan asked for (M, 2) [m/s] where dogs are told something else to keep apart;
    None where they are not.
    """

    command: Array | None
    announcement: Announcement | None = None
    events: tuple[Event, ...] = ()
    error: Exception | None = None
    asked: Array | None = None


@dataclass(frozen=True)
class Condition:
    """What the pilot is doing, in words, and whether that is as it should be."""

    doing: str
    good: bool


class Pilot:
    """What both pilots share; see `LockstepPilot` and `RealTimePilot`."""

    def __init__(self, planner: Planner, dogs: int) -> None:
        """Plan by `planner`, not to be used elsewhere, for so many dogs."""
        self.dogs = dogs
        self.plans_made = self.feedbacks_made = 0
        self.deadlines_missed = self.plans_failed = self.commands_changed = 0
        self.estimate: Observed | None = None
        """The most likely state at the last observation, once what is under way is carried out.

        Dogs that do not do as told are left out.
        """
        self._planner = planner
        self._crowd, self._control = planner.crowd, planner.control
        self._goal = _as_pair(planner.goal)
        horizon = planner.control.horizon
        self._period = horizon.control_period
        self._estimator = StateEstimator(
            planner.crowd,
            planner.control.sensor,
            self._period,
            horizon.substeps,
            planner.control.motion,
        )
        self._stopping = threading.Event()
        self._events: list[Event] = []
        self._said: dict[str, float] = {}  # when
        self._error: Exception | None = None
        self._overruled: Array | None = None
        self._start_afresh()

    def _start_afresh(self) -> None:
        """Forget the past, as at the start or when time was set back."""
        self._time = -math.inf
        self._said.clear()
        self._is_as_told = True  # how dogs are felt
        self._wrong_since = math.inf  # one plan after another
        self._zero_velocities = ZeroVelocities()
        self._visible: tuple[int, ...] = ()
        self._seen: tuple[int, ...] = ()
        self._command: Array = np.zeros((self.dogs, 2))  # the last one
        self._filter = CommandFilter(self.dogs)
        self._obedience = Obedience(self.dogs)
        self._told_of: set[int] = set()  # dogs that are said not to do as told
        self._judged: dict[int, Judgement] = {}  # when their standing changed last
        late = self._control.periods_of_delay
        self._under_way: deque[Array] = deque(np.zeros((self.dogs, 2)) for _ in range(late))
        self._commands, self._sum_of_commands = 0, np.zeros_like(self._command)  # in effect
        self._afresh = True
        self.estimate = None
        self._estimator.reset()

    def move_goal(self, goal: Array) -> bool:
        """Herd to another goal (2,) [m]; return whether it is another one and asks for a plan."""
        before, self._goal = self._goal, _as_pair(goal)
        return self._goal != before

    def adjust(self, crowd: Crowd, control: Control) -> None:
        """Use these from the next plan on."""
        self._crowd, self._control = crowd, control

    def stop(self) -> None:
        """End a solve that is under way early; may be called from any thread."""
        self._stopping.set()

    @property
    def silent_dogs(self) -> list[str]:
        """Names of the dogs that are not visible."""
        return [dog_name(m) for m in range(self.dogs) if m not in self._visible]

    @property
    def disobedient_dogs(self) -> list[str]:
        """Names of the dogs that do not do as they are told."""
        return [dog_name(m) for m in sorted(self._obedience.disobedient)]

    def estimate_values(self) -> dict[str, object]:
        """Return where the flock is, and what a filter knows of its own errors, by name."""
        if self.estimate is None:
            return {}
        flock = without_strays(self.estimate.state.x, self._control.arrival.strays)
        seen: dict[str, object] = {
            'distance_m': float(distance(flock, np.array(self._goal))),
            'spread_m': float(spread(flock)),
        }
        deviations = self._estimator.deviations
        if deviations is None:
            return seen
        return seen | {
            'sheep_out_of_sight': self._estimator.carried,
            'position_error_m': deviations[0],
            'velocity_error_m_s': deviations[1],
        }

    def _advance_to(self, t: float) -> float:
        """Return the time [s] to decide for: t, or the last time if t is before it by jitter."""
        if is_set_back(t, self._time, self._period):
            self._say(
                'warning',
                f'time was set back from {self._time:.3f} to {t:.3f} s: the dogs stop, and '
                'planning starts afresh',
            )
            self._start_afresh()
        self._time = max(self._time, t)
        return self._time

    def _prepare_planner(self) -> None:
        """Apply to the planner, while it is idle, what has changed since its last plan."""
        planner = self._planner
        if (self._crowd, self._control) != (planner.crowd, planner.control):
            planner.adjust(self._crowd, self._control)
        self._estimator.crowd = self._crowd
        planner.move_goal(np.array(self._goal))
        if self._afresh:
            planner.restart()
        self._afresh = False

    def _observe(self, observed: Observed) -> Observed:
        """Filter an observation; each counts once."""
        last = self.estimate
        if last is None or (observed.stamp, observed.dogs) != (last.stamp, self._seen):
            u = self._sum_of_commands / self._commands if self._commands else self._command
            self._commands, self._sum_of_commands = 0, np.zeros_like(u)
            try:
                state = self._estimator.update(
                    observed.t,
                    observed.ids,
                    observed.state,
                    u,
                    observed.dogs,
                    observed.is_velocity_seen,
                )
                ids = self._estimator.ids
            except (ValueError, ArithmeticError) as error:  # the prediction is not finite
                self._record_failure(error)
                self._estimator.reset()
                state, ids = observed.state, observed.ids
            self._tell_of_hidden_sheep()
            self._tell_of_zero_velocities(observed)
            self._seen = observed.dogs
            self._watch_dogs(observed, u)
            state, dogs = self._without_disobedient_dogs(state, observed.dogs)
            try:
                state = self._once_carried_out(state, dogs)
            except (ValueError, ArithmeticError) as error:  # the prediction is not finite
                self._record_failure(error)
            last = self.estimate = Observed(observed.stamp, ids, state, dogs)
        return last

    def _once_carried_out(self, state: HerdState, dogs: tuple[int, ...]) -> HerdState:
        """Return the state in which the commands that are under way have been carried out."""
        if not self._under_way:
            return state
        horizon, u = self._control.horizon, np.array(self._under_way)[:, list(dogs)]
        motion = self._control.motion
        return rollout(self._crowd, state, u, horizon.dt, horizon.substeps, motion=motion).at(-1)

    def _watch_dogs(self, observed: Observed, u: Array) -> None:
        """Compare where dogs are with where commands u (M, 2) [m/s] led since the last time."""
        changed = self._obedience.observe(
            observed.t, observed.state.d, observed.dogs, u, self._control
        )
        self._judged |= changed
        # What cannot be said so soon again is said later, if it is still so.
        for m in sorted(self._told_of ^ self._obedience.disobedient.keys()):
            if self._say(*self._standing_of(m, self._judged[m])):
                self._told_of ^= {m}

    def _standing_of(self, m: int, judgement: Judgement) -> tuple[str, str, str]:
        """Return level, text and cause of the event that a dog is told, or no longer."""
        name = dog_name(m)
        if m not in self._obedience.disobedient:
            return 'info', f'{name} does as told again: it is planned with', ''
        return (
            'warning',
            f'{name} does not do as told: its commands led it at {judgement.told[m]:.3g} m/s for '
            f'dog_timeout, its odometry is {judgement.off[m]:.3g} m/s off that. Planning without; '
            'others keep away. It is told to run away from the flock now and then, and taken back '
            'when it does. See what holds it, or whether odometry is stuck; motion.kind and delay '
            'must be its own',
            f'{name} does not do as told',
        )

    def _without_disobedient_dogs(
        self, state: HerdState, dogs: tuple[int, ...]
    ) -> tuple[HerdState, tuple[int, ...]]:
        """Return the state without these dogs, and the others' indices; if there are others."""
        good = [row for row, m in enumerate(dogs) if m not in self._obedience.disobedient]
        if len(good) in (0, len(dogs)):
            return state, dogs
        for row, m in enumerate(dogs):
            if row not in good:
                self._filter.place(m, state.dogs[row])
        return replace(state, d=state.d[good]), tuple(dogs[row] for row in good)

    def _tell_of_hidden_sheep(self) -> None:
        timeout = self._control.sensor.timeout
        if self._estimator.is_new:
            self._say(
                'warning',
                f'no observation for longer than sensor.timeout, {timeout:g} s: the filter starts '
                'afresh',
            )
        if self._estimator.carried:
            self._say(
                'info',
                f'sheep out of sight are carried along by the model for up to {timeout:g} s',
            )
        if lost := self._estimator.lost:
            names = ', '.join(map(str, lost[:_NAMED])) + ' ...' * (len(lost) > _NAMED)
            self._say(
                'warning',
                f'sheep out of sight for {timeout:g} s are lost, the plans go on '
                f'without them: {names}',
            )

    def _tell_of_zero_velocities(self, observed: Observed) -> None:
        """Say so when the flock moves, with inertia, but all velocities are exactly zero."""
        seen = observed.is_velocity_seen
        if self._crowd.order == 1 or not (seen is None or seen.all()):
            return
        found = self._zero_velocities.observe(
            observed.t, observed.ids, observed.state, self._control
        )
        if found is not None:
            moved, elapsed = found
            self._say(
                'warning',
                f'the flock has moved by {moved:.2g} m in {elapsed:.2g} s, but all of its '
                'velocities are 0: plans begin as if it stood. If nothing sees velocities, leave '
                'them out and set sensor.position_noise, or crowd.order to 1',
                cause='velocities are 0',
            )

    def _is_feedback_due(self, plan: ScheduledPlan, estimate: Observed) -> bool:
        """Whether a plan, made for the dogs that are visible, is to be improved.

        It is once the observation that it was made from is `horizon.feedback` old, when the goal
        has moved, or when the flock is not where the plan has it.
        """
        horizon = self._control.horizon
        if not horizon.has_feedback or plan.request.dogs != estimate.dogs:
            return False
        age = estimate.t - plan.observed
        if age < SLACK:
            return False
        off = surprise(self._crowd, self._control, plan.window, age, estimate.state, estimate.t)
        self._tell_of_wrong_plans(plan, off, estimate.t)
        return off is not None or age > horizon.feedback - SLACK or plan.request.goal != self._goal

    def _tell_of_wrong_plans(self, plan: ScheduledPlan, off: Surprise | None, t: float) -> None:
        """Say so when one plan after another meets a surprise, for longer than `accepted`."""
        if off is None:
            self._wrong_since = math.inf
            return
        self._wrong_since = min(self._wrong_since, t)
        if plan.observed > self._wrong_since + self._control.horizon.accepted - SLACK:
            self._say(
                'warning',
                'the flock is never where plans expect it, beyond what noise explains: its centre '
                f'is {off.centre:.2g} m off, its spread {off.spread:.2g} m, in '
                f'{t - plan.observed:.2g} s. Each time a plan is made anew, which costs time. See '
                'that crowd.* is how sheep move (fit), and that they keep their ids',
                cause='the flock is never where plans expect it',
            )

    def _filtered(self, asked: Array, estimate: Observed) -> Array:
        """Return the commands (M, 2) [m/s] for those that a plan asks for; count and say why."""
        control, field = self._control, field_of(self._crowd)
        if keeps_distances(control, field) and not isinstance(control.motion, Obedient):
            self._say(
                'warning',
                'dogs are not kept apart: bodies.separation and bodies.sheep_distance are for '
                f'commands that are velocities, but motion is {type(control.motion).__name__}; '
                'set both to 0',
            )
        asked = self._with_trials(asked, estimate)
        command = self._filter.filtered(
            asked, self._command, estimate.state, estimate.dogs, control, field
        )
        if command.too_near:
            self._say(
                'warning',
                'dogs are nearer to each other than bodies.separation, '
                f'{control.bodies.separation:g} m: they part',
            )
        if command.changed:
            self._overruled = asked
            self.commands_changed += 1
            walls = ' and off walls' if len(field.bars) else ''
            self._say('info', f'commands are changed to keep dogs apart{walls}; they are counted')
        return command.u

    def _with_trials(self, asked: Array, estimate: Observed) -> Array:
        """Tell dogs that did not do as told to run away from the flock now and then."""
        out, timeout = asked.copy(), self._control.dog_timeout
        for m, since in self._obedience.disobedient.items():
            waited = (estimate.t - since) % (_TRIAL * timeout)
            place = self._filter.place_of(m)
            is_planned_with, is_silent = m in estimate.dogs, m not in self._seen
            if is_planned_with or is_silent or waited < (_TRIAL - 1.0) * timeout:
                continue
            away = place - centre(estimate.state.x)
            run = 0.5 * self._control.max_speed * away / max(float(np.linalg.norm(away)), TINY)
            if self._filter.is_free(m, place + timeout * run, self._control):
                out[m] = run
        return out

    def _announce(self, plan: ScheduledPlan, margin: float) -> Announcement:
        self.plans_made += 1
        self.feedbacks_made += plan.window.report.kind == 'feedback'
        if plan.window.report.status is Status.NO_INFLUENCE:
            self._say(
                'warning',
                'no influence: no sheep notices the dogs within the window; they go towards the '
                'sheep, unless crowd.dog has no force or weights.beyond and weights.dogs are 0',
            )
        self._tell_how_dogs_are_felt(plan.window.report)
        return Announcement(plan, self.plans_made - 1, margin)

    def _tell_how_dogs_are_felt(self, report: SolveReport) -> None:
        is_as_told = report.felt_strength == report.felt_range == 1.0
        if is_as_told == self._is_as_told:
            return
        if is_as_told:
            is_said = self._say('info', 'sheep feel dogs as crowd.dog says, after all')
        else:
            is_said = self._say(
                'warning',
                f'sheep feel dogs {report.felt_range:.2g} times as far and '
                f'{report.felt_strength:.2g} times as strongly as crowd.dog says, by how they '
                'move; plans go by that, and by what further looks tell',
                cause='how dogs are felt',
            )
        if is_said:  # else later, if it is still so: what was said last is to be true
            self._is_as_told = is_as_told

    def _record_failure(self, error: Exception) -> None:
        self._error = error
        if not self.plans_failed:
            self._say('error', f'a plan could not be made: {error!r}; further ones are counted')
        self.plans_failed += 1

    def _say(self, level: str, text: str, cause: str = '') -> bool:
        """Add an event, unless one of the same cause, else the same one, was added recently.

        Return whether it was added.
        """
        now, cause = self._time, cause or text
        self._said = {said: when for said, when in self._said.items() if now < when + _REPEAT}
        if cause in self._said:
            return False
        self._said[cause] = now
        self._events.append(Event(level, text))
        return True

    def _decision(self, command: Array | None, announcement: Announcement | None) -> Decision:
        if command is not None:
            self._command = command
            self._under_way.append(command)
            acting = self._under_way.popleft()
            self._commands, self._sum_of_commands = (
                self._commands + 1,
                self._sum_of_commands + acting,
            )
        decision = Decision(
            command, announcement, tuple(self._events), self._error, self._overruled
        )
        self._events, self._error, self._overruled = [], None, None
        return decision


def is_set_back(t: float, last: float, control_period: float) -> bool:
    """Return whether time [s] was set back to t; by less than a control period is jitter."""
    return t <= last - control_period + SLACK


def dog_name(m: int) -> str:
    """Return the name of the dog with this index from 0, as topics and frames have it."""
    return f'dog_{m + 1}'


def _as_pair(goal: Array) -> tuple[float, float]:
    x, y = finite('goal', goal, (2,))
    return float(x), float(y)


Clock = Callable[[], float]
"""Returns the time [s]."""
