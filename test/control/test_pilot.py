# SPDX-License-Identifier: Apache-2.0
"""Both pilots, with a clock that is set by hand and plans that say what they are for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math

from herding_ros.control.closed_loop import as_policy
from herding_ros.control.lockstep_pilot import LockstepPilot
from herding_ros.control.parameters import Bodies, Control, Horizon, OutOfStepError, Sensor, Timing
from herding_ros.control.pilot import Decision, Observed
from herding_ros.control.plan import Plan
from herding_ros.control.real_time_pilot import RealTimePilot
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.schedule import ScheduledPlan
from herding_ros.control.solution import never, NoTimeFor, Status
from herding_ros.control.solve_report import SolveReport
from herding_ros.control.window import Window
from herding_ros.model import flock
from herding_ros.model.crowd import Crowd
from herding_ros.model.motion import Holonomic
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

PERIOD, LENGTH, ACCEPTED, LEAD = 0.1, 4.0, 2.0, 1.0
FEEDBACK = 0.5
HORIZON = Horizon(LENGTH, ACCEPTED, feedback=ACCEPTED, control_period=PERIOD)
AS_PLANNED = Bodies(separation=0.0, ramp=0.0)
CONTROL = Control(horizon=HORIZON, bodies=AS_PLANNED)
IMPROVING = replace(CONTROL, horizon=replace(HORIZON, feedback=FEEDBACK))
GOAL = (1.0, 0.0)
NEW_GOAL = (0.0, 1.0)
REPORT = SolveReport(
    'window',
    Status.CONVERGED,
    0.0,
    0.0,
    0,
    0,
    0,
    (),
    0.0,
    0,
    Status.CONVERGED,
    0,
    (),
    0.0,
    0.0,
    1.0,
    1.0,
    {},
)


class FakePlanner:
    """Plans that all dogs run along the goal, (1e-3 goal) m/s: so a command shows its goal.

    An improved plan has them run half as fast. All expect the sheep of `seen` to stay there.
    """

    def __init__(self, control: Control = CONTROL) -> None:
        self.crowd, self.control, self.goal = Crowd(), control, np.array(GOAL)
        self.restarts = 0
        self.solved: list[tuple[float, HerdState]] = []
        self.improved: list[tuple[float, HerdState]] = []
        self.learned: list[tuple[float, HerdState]] = []
        self.error: Exception | None = None
        self.speed = 1e-3
        self.report = REPORT

    def move_goal(self, goal: Array) -> None:
        self.goal = goal

    def restart(self) -> None:
        self.restarts += 1

    def adjust(self, crowd: Crowd, control: Control) -> None:
        self.crowd, self.control = crowd, control

    def learn(self, state: HerdState, t: float) -> None:
        self.learned.append((t, state))

    def solve(self, state: HerdState, t: float, no_time_for: NoTimeFor = never) -> Window:
        self.solved.append((t, state))
        return self._window(self.speed, state, t, no_time_for)

    def improve(self, state: HerdState, t: float, no_time_for: NoTimeFor = never) -> Window:
        self.improved.append((t, state))
        return self._window(0.5 * self.speed, state, t, no_time_for)

    def _window(self, speed: float, state: HerdState, t: float, no_time_for: NoTimeFor) -> Window:
        self.stopped = no_time_for('coarse')
        if self.error is not None:
            raise self.error
        intervals = self.control.horizon.intervals
        u = np.broadcast_to(speed * self.goal, (intervals, len(state.d), 2))
        x = seen(0.0).state.x
        centre = np.broadcast_to(flock.centre(x), (intervals + 1, 2))
        spread = np.full(intervals + 1, flock.spread(x))
        dogs = np.zeros((intervals + 1, *state.d.shape))
        return Window(Plan(t, PERIOD, u), self.report, PERIOD, centre, spread, dogs)


def seen(
    t: float, dogs: tuple[int, ...] = (0, 1, 2), sheep: int = 2, gust: float = 0.0
) -> Observed:
    d = np.array([[-0.5, 0.1 * m] for m in dogs])
    x = np.array([[0.1 * i + gust, 0.0] for i in range(sheep)])
    return Observed(round(t * 1e9), np.arange(sheep), HerdState(x, np.zeros_like(x), d), dogs)


def goal_of(command: Array) -> list[tuple[float, float]]:
    """The goals that the dogs run to, (0, 0) for one that stands."""
    return [(float(x), float(y)) for x, y in 1e3 * command]


class Field:
    """A real-time pilot at work: time passes in control periods, and a solve takes `solving`."""

    def __init__(
        self,
        solving: float = 0.3,
        lead: float = LEAD,
        timeout: float = 0.5,
        control: Control = CONTROL,
    ) -> None:
        self.t = 100.0
        self.elapsed = 0.0  # which goes on when t is set back
        self.solving = solving
        self.planner = FakePlanner(control)
        self.pending: list[tuple[float, Callable[[], None]]] = []
        self.pilot = RealTimePilot(
            self.planner, 3, Timing(lead, timeout), lambda: self.t, self._later
        )
        self.dogs: tuple[int, ...] = (0, 1, 2)
        self.visible = True
        self.gust = 0.0
        self.ends_when_dropped = False
        self.decisions: list[tuple[float, Decision]] = []

    def _later(self, function: Callable[[], None]) -> None:
        self.pending.append((self.elapsed + self.solving, function))

    def tick(self, step: float = PERIOD) -> Decision:
        """Let a control period pass, and solves end that are over by then."""
        self.t += step
        self.elapsed += PERIOD
        for end, function in list(self.pending):
            dropped = self.ends_when_dropped and function.__self__.dropped  # type: ignore[attr-defined]
            if end <= self.elapsed + 1e-9 or dropped:
                self.pending.remove((end, function))
                function()
        visible = self.visible and self.dogs
        observed = seen(self.t, self.dogs, gust=self.gust) if visible else None
        decision = self.pilot.decide(self.t, observed)
        self.decisions.append((self.t, decision))
        return decision

    def run(self, seconds: float) -> list[Decision]:
        return [self.tick() for _ in range(round(seconds / PERIOD))]

    def run_until(self, condition: Callable[[Decision], object], limit: float = 60.0) -> Decision:
        for _ in range(round(limit / PERIOD)):
            decision = self.tick()
            if condition(decision):
                return decision
        raise AssertionError('waited too long')

    def herding(self) -> Field:
        """Run until the first plan is played."""
        self.run_until(lambda decision: decision.command is not None)
        return self

    @property
    def plans(self) -> list[ScheduledPlan]:
        """Those that were announced."""
        return [each.announcement.plan for _, each in self.decisions if each.announcement]

    @property
    def starts(self) -> list[float]:
        return [t for t, _ in self.planner.solved]

    def said(self, words: str) -> list[str]:
        return [
            event.text
            for _, decision in self.decisions
            for event in decision.events
            if words in event.text
        ]


def command(decision: Decision) -> Array:
    assert decision.command is not None
    return decision.command


# In lockstep.


def lockstep(control: Control = CONTROL) -> tuple[LockstepPilot, FakePlanner]:
    planner = FakePlanner(control)
    return LockstepPilot(planner, 3), planner


def test_lockstep_plans_when_due_and_replies_each_time() -> None:
    pilot, planner = lockstep()
    decisions = [pilot.decide(seen(0.1 * k)) for k in range(45)]
    assert [t for t, _ in planner.solved] == pytest.approx([0.0, 2.0, 4.0])
    assert all(goal_of(command(decision)) == [GOAL] * 3 for decision in decisions)
    numbers = [d.announcement.number for d in decisions if d.announcement]
    assert numbers == [0, 1, 2]
    assert pilot.plans_made == 3
    assert not any(decision.events for decision in decisions)
    assert all(decision.asked is None for decision in decisions)


@pytest.mark.parametrize('keeps_time', [False, True])
def test_commands_keep_dogs_apart_and_that_is_counted_and_said_once(keeps_time: bool) -> None:
    bodies = Bodies(
        separation=0.12, margin=0.0, ramp=0.0
    )  # dogs are 0.1 m from each other, side by side; they do not move, whatever they are told
    control = replace(CONTROL, bodies=bodies, dog_timeout=0.0)
    if keeps_time:
        field = Field(control=control).herding()
        decisions = field.run(3.0)
        events = [event for _, decision in field.decisions for event in decision.events]
        pilot: LockstepPilot | RealTimePilot = field.pilot
    else:
        pilot, _ = lockstep(control)
        decisions = [pilot.decide(seen(0.1 * k)) for k in range(30)]
        events = [event for decision in decisions for event in decision.events]
    u = command(decisions[-1])
    assert u[:, 0] == pytest.approx(1e-3)  # on they run
    assert u[0, 1] < -1e-3 < 1e-3 < u[2, 1]  # and part
    asked = decisions[-1].asked
    assert asked is not None
    assert goal_of(asked) == [GOAL] * 3
    assert pilot.commands_changed >= len(decisions)
    assert [event.level for event in events] == ['warning', 'info']
    assert 'nearer to each other than bodies.separation, 0.12 m' in events[0].text


def test_dogs_whose_commands_are_no_velocities_are_not_kept_apart_and_that_is_said() -> None:
    class Sledge(Holonomic.__base__):  # type: ignore[misc, name-defined]
        """Moves as a holonomic dog does, and need not."""

        project, rollout, transpose = Holonomic.project, Holonomic.rollout, Holonomic.transpose
        state, odometry = Holonomic.state, Holonomic.odometry

    control = replace(
        CONTROL, bodies=Bodies(separation=0.12, ramp=0.0), motion=Sledge(), dog_timeout=0.0
    )
    pilot, _ = lockstep(control)
    decisions = [pilot.decide(seen(0.1 * k)) for k in range(30)]
    assert goal_of(command(decisions[-1])) == [GOAL] * 3
    (event,) = [event for decision in decisions for event in decision.events]
    assert 'not kept apart' in event.text
    assert 'Sledge' in event.text


def test_a_plan_without_influence_is_said_once() -> None:
    pilot, planner = lockstep()
    planner.report = replace(REPORT, status=Status.NO_INFLUENCE)
    events = [event for k in range(45) for event in pilot.decide(seen(0.1 * k)).events]
    assert [event.level for event in events] == ['warning']
    assert 'no influence' in events[0].text
    assert pilot.plans_made == 3


def test_dogs_that_are_felt_otherwise_than_told_are_told_of_once_and_when_it_is_over() -> None:
    pilot, planner = lockstep()
    events = []
    for k in range(65):
        if k in (0, 25, 45):
            planner.report = replace(REPORT, felt_strength=0.5 if k == 25 else 1.0)
        events += [(k, event) for event in pilot.decide(seen(0.1 * k)).events]
    assert [(k, event.level) for k, event in events] == [(40, 'warning'), (60, 'info')]
    assert '1 times as far and 0.5 times as strongly' in events[0][1].text
    assert 'as crowd.dog says' in events[1][1].text


def test_how_dogs_are_felt_now_is_told_even_if_the_same_was_told_and_taken_back_just_before() -> (
    None
):
    pilot, planner = lockstep()
    events = []
    for k in range(400):
        if k in (0, 25, 45, 65):
            planner.report = replace(REPORT, felt_strength=0.5 if k in (25, 65) else 1.0)
        events += [(k, event.level) for event in pilot.decide(seen(0.1 * k)).events]
    assert events == [(40, 'warning'), (60, 'info'), (340, 'warning')]


def test_lockstep_reply_is_that_of_the_real_planner() -> None:
    control = Control(bodies=AS_PLANNED, horizon=Horizon(length=1.0, accepted=0.5, feedback=0.2))
    herd = seen(0.0, sheep=4).state
    pilot = LockstepPilot(RecedingHorizon(Crowd(), control, np.array(GOAL), seed=7), 3)
    by_hand = RecedingHorizon(Crowd(), control, np.array(GOAL), seed=7)
    for k in range(8):
        make = {0: by_hand.solve, 2: by_hand.improve, 4: by_hand.improve}.get(k % 5)
        if make is not None:
            by_hand.learn(herd, 0.1 * k)
            plan = make(herd, 0.1 * k).plan
        reply = pilot.decide(Observed.complete(0.1 * k, herd))
        np.testing.assert_array_equal(reply.command, plan.at(0.1 * k))


@pytest.mark.parametrize('start', [0, 3_000_000_000, 1_700_000_000_123_456_789])
def test_lockstep_improves_the_plan_between_two_windows(start: int) -> None:
    """At times since 1970 as well, which are exact to 2.4e-7 s in double precision."""
    pilot, planner = lockstep(IMPROVING)
    speeds = []
    for k in range(45):
        observed = replace(seen(0.0), stamp=start + 100_000_000 * k)
        decision = pilot.decide(observed)
        speeds.append(command(decision)[0, 0])
        assert (decision.announcement is not None) == (k % 5 == 0)
    windows, improved = ([round((t - start * 1e-9) / 0.1) for t, _ in each] for each in
                         (planner.solved, planner.improved))  # fmt: skip
    assert windows == [0, 20, 40]
    assert improved == [5, 10, 15, 25, 30, 35]
    np.testing.assert_allclose(speeds, [1e-3 * (1.0 if k % 20 < 5 else 0.5) for k in range(45)])
    assert pilot.plans_made == 9


@pytest.mark.parametrize('feedback', [ACCEPTED, 10 * ACCEPTED])
def test_lockstep_without_feedback_plans_windows_only(feedback: float) -> None:
    """Whatever the flock does meanwhile."""
    pilot, planner = lockstep(Control(horizon=replace(HORIZON, feedback=feedback)))
    for k in range(45):
        pilot.decide(seen(0.1 * k, gust=0.3 * (k > 3)))
    assert [t for t, _ in planner.solved] == pytest.approx([0.0, 2.0, 4.0])
    assert not planner.improved


def test_lockstep_improves_at_once_when_surprised_and_once_for_each_surprise() -> None:
    pilot, planner = lockstep(IMPROVING)
    for k in range(20):
        pilot.decide(seen(0.1 * k, gust=0.3 * (k >= 2)))
    # The plans of this planner go on to expect the sheep where they were.
    assert [t for t, _ in planner.improved] == pytest.approx([0.1 * k for k in range(2, 20)])
    assert len(planner.solved) == 1
    pilot, planner = lockstep(IMPROVING)
    for k in range(20):
        pilot.decide(seen(0.1 * k, gust=0.3 * (k == 2)))
    assert [t for t, _ in planner.improved] == pytest.approx([0.2, 0.7, 1.2, 1.7])


@pytest.mark.parametrize(
    ('order', 'v', 'is_seen', 'speed', 'told'),
    [
        (2, 0.0, True, 0.02, 1),
        (2, 0.02, True, 0.02, 0),
        (2, 0.0, True, 0.002, 0),  # it stands, and the camera trembles
        (2, 0.0, False, 0.02, 0),
        (1, 0.0, True, 0.02, 0),
    ],
)
def test_a_flock_that_moves_without_velocities_is_told_of_once(
    order: int, v: float, is_seen: bool, speed: float, told: int
) -> None:
    sensor = Sensor(position_noise=0.0 if is_seen else 0.01)
    pilot, planner = lockstep(replace(CONTROL, sensor=sensor))
    planner.crowd = replace(planner.crowd, order=order)
    pilot.adjust(planner.crowd, planner.control)
    events = []
    for k in range(250):
        observed = seen(0.1 * k, gust=0.1 * k * speed)
        state = replace(observed.state, v=np.full_like(observed.state.v, v))
        which = np.full(len(state.x), is_seen)
        decision = pilot.decide(replace(observed, state=state, is_velocity_seen=which))
        events += [event.text for event in decision.events if 'velocities are 0' in event.text]
    assert len(events) == told
    if told:
        assert 'has moved by 0.04 m in 2 s' in events[0]


@pytest.mark.parametrize('keeps_time', [False, True])
def test_a_model_that_is_wrong_at_every_look_is_told_of_once_but_no_gust_is(
    keeps_time: bool,
) -> None:
    """The plans of this planner always expect the sheep of `seen`."""
    events: list[str] = []
    if keeps_time:
        field = improving()
        for gust in (0.3, 0.0, 0.3):
            field.gust = gust
            field.run(ACCEPTED - 2 * FEEDBACK)
        field.gust = 0.0
        field.run(ACCEPTED)
        # Out of sight, and then elsewhere.
        field.visible = False
        field.run(2 * ACCEPTED)
        field.visible, field.gust = True, 0.3
        field.run(ACCEPTED - 2 * FEEDBACK)
        assert not field.said('never where plans expect it')
        field.run(3 * ACCEPTED)
        events = field.said('never where plans expect it')
    else:
        pilot, _ = lockstep(IMPROVING)
        for k in range(100):
            decision = pilot.decide(seen(0.1 * k, gust=0.3 * (k in range(5, 20) or k > 50)))
            events += [event.text for event in decision.events]
            assert bool(events) == (k > 51 + round(ACCEPTED / PERIOD))
    assert len(events) == 1
    assert 'its centre is 0.3 m off' in events[0]


def test_lockstep_plans_a_window_anew_for_another_goal_and_without_a_dog() -> None:
    """Neither is a matter of improving the plan."""
    pilot, planner = lockstep(IMPROVING)
    for k in range(4):
        pilot.decide(seen(0.1 * k))
    pilot.move_goal(np.array(NEW_GOAL))
    for k in range(4, 8):
        pilot.decide(seen(0.1 * k))
    for k in range(8, 14):
        pilot.decide(seen(0.1 * k, dogs=(0, 2)))
    assert [t for t, _ in planner.solved] == pytest.approx([0.0, 0.4, 0.8])
    assert [t for t, _ in planner.improved] == pytest.approx([1.3])


def test_lockstep_plays_the_last_plan_on_when_an_improvement_fails_and_says_so_once() -> None:
    pilot, planner = lockstep(IMPROVING)
    pilot.decide(seen(0.0))
    planner.error = ArithmeticError('the solver is broken')
    decisions = [pilot.decide(seen(0.1 * k)) for k in range(1, 15)]
    assert all(goal_of(command(decision)) == [GOAL] * 3 for decision in decisions)
    assert pilot.plans_failed == 10  # at 0.5 s and each time after
    events = [event for decision in decisions for event in decision.events]
    assert [event.level for event in events] == ['error']
    planner.error = None
    assert command(pilot.decide(seen(1.5)))[0, 0] == 0.5e-3
    # The window comes when it should.
    for k in range(16, 21):
        pilot.decide(seen(0.1 * k))
    assert planner.solved[-1][0] == pytest.approx(2.0)


def test_lockstep_plans_for_a_moved_goal_at_once_and_for_the_same_goal_not_again() -> None:
    pilot, planner = lockstep()
    pilot.decide(seen(0.0))
    assert not pilot.move_goal(np.array(GOAL))
    assert pilot.decide(seen(0.1)).announcement is None
    assert pilot.move_goal(np.array(NEW_GOAL))
    reply = pilot.decide(seen(0.2))
    assert goal_of(command(reply)) == [NEW_GOAL] * 3
    assert reply.announcement is not None
    assert reply.announcement.plan.request.goal == NEW_GOAL
    assert [t for t, _ in planner.solved] == pytest.approx([0.0, 0.2])


@pytest.mark.parametrize('goal', [(math.nan, 0.0), (1.0,), (1.0, 2.0, 3.0), (math.inf, 0.0)])
def test_a_goal_that_is_not_a_point_is_refused_and_changes_nothing(
    goal: tuple[float, ...],
) -> None:
    pilot, planner = lockstep()
    pilot.decide(seen(0.0))
    with pytest.raises(ValueError, match='goal'):
        pilot.move_goal(np.array(goal))
    assert goal_of(command(pilot.decide(seen(0.1)))) == [GOAL] * 3
    assert len(planner.solved) == 1


def test_lockstep_starts_afresh_when_time_is_set_back() -> None:
    pilot, planner = lockstep()
    for t in (0.0, 0.1, 2.0, 0.0, 0.0):
        pilot.decide(seen(t))
    assert [t for t, _ in planner.solved] == [0.0, 2.0, 0.0]
    assert planner.restarts == 2  # the first plan counts as well


def test_lockstep_takes_a_step_back_of_less_than_a_control_period_for_jitter() -> None:
    pilot, planner = lockstep()
    for t in (0.0, 0.1, 1.0, 0.95, 1.05):
        pilot.decide(seen(t))
    assert len(planner.solved) == 1
    assert planner.restarts == 1


def test_lockstep_notices_another_period_than_its_own_also_after_a_reset() -> None:
    pilot, _ = lockstep()
    for t in (5.0, 5.0, 5.1, 5.4, 0.0):  # the first one may be repeated
        pilot.decide(seen(t))
    message = (
        r'control_period .* must be dt \* substeps of the sim in lockstep, 0\.2 s, got 0\.1 s'
    )
    with pytest.raises(OutOfStepError, match=message):
        pilot.decide(seen(0.2))


@pytest.mark.parametrize('what', ['error', 'nan'])
def test_lockstep_counts_a_failed_solve_and_plays_the_last_plan_on(what: str) -> None:
    pilot, planner = lockstep()
    for t in (0.0, 0.1):
        pilot.decide(seen(t))
    if what == 'error':
        planner.error = ArithmeticError('the solver is broken')
    else:
        planner.speed = math.nan
    replies = [pilot.decide(seen(0.1 * k)) for k in range(20, 45)]
    assert pilot.plans_failed == 25
    assert sum(bool(reply.events) for reply in replies) == 1  # said once, counted always
    assert all(reply.error is not None for reply in replies)
    on = [goal_of(command(reply))[0] for reply in replies]
    assert on == [GOAL] * 20 + [(0.0, 0.0)] * 5  # the old plan ends at 4 s
    planner.error, planner.speed = None, 1e-3
    assert goal_of(command(pilot.decide(seen(4.5)))) == [GOAL] * 3


def test_lockstep_stands_while_no_plan_was_ever_made() -> None:
    pilot, planner = lockstep()
    planner.error = RuntimeError('no')
    assert goal_of(command(pilot.decide(seen(0.0)))) == [(0.0, 0.0)] * 3
    assert not pilot.condition(0.0).good


def test_in_a_closed_loop_a_failed_solve_is_raised() -> None:
    pilot, planner = lockstep()
    planner.error = ArithmeticError('the solver is broken')
    with pytest.raises(ArithmeticError, match='broken'):
        as_policy(pilot, [])(seen(0.0).state, 0.0)


def test_lockstep_uses_new_parameters_from_the_next_plan_on() -> None:
    pilot, planner = lockstep()
    pilot.decide(seen(0.0))
    changed = Control(horizon=CONTROL.horizon, max_speed=0.04)
    pilot.adjust(Crowd(noise=0.03), changed)
    pilot.decide(seen(0.1))
    assert planner.control is CONTROL
    pilot.decide(seen(2.0))
    assert planner.control is changed
    assert planner.crowd.noise == 0.03


def test_a_stopped_pilot_ends_its_solve_early() -> None:
    pilot, planner = lockstep()
    for t in (0.0, 0.1):
        pilot.decide(seen(t))
    assert not planner.stopped
    pilot.stop()
    pilot.decide(seen(2.0))
    assert planner.stopped


# By its own clock.


def test_no_command_before_the_first_plan_starts_and_that_is_announced_before() -> None:
    field = Field()
    announced = field.run_until(lambda decision: decision.announcement)
    assert announced.announcement is not None
    assert announced.announcement.margin == pytest.approx(LEAD - field.solving, abs=1e-6)
    assert announced.announcement.plan.start == pytest.approx(field.t + LEAD - field.solving)
    assert all(decision.command is None for _, decision in field.decisions)
    assert field.pilot.condition(field.t).doing == 'standing: the first plan is not ready yet'
    field.herding()
    assert field.t == pytest.approx(announced.announcement.plan.start)
    assert field.pilot.condition(field.t).good


def test_windows_join_without_a_gap() -> None:
    field = Field().herding()
    field.run(10.0)
    assert np.diff(field.starts) == pytest.approx(ACCEPTED)
    assert field.pilot.deadlines_missed == field.pilot.plans_failed == 0


@pytest.mark.parametrize('lead', [0.3, 1.0, 1.9, 5.0])
def test_windows_join_whatever_the_lead(lead: float) -> None:
    """Also where it is longer than a window."""
    field = Field(0.2, lead).herding()
    field.run(20.0)
    assert np.diff(field.starts) == pytest.approx(ACCEPTED)
    assert all(decision.command.any() for _, decision in field.decisions[-150:])


def test_next_plan_begins_from_the_state_that_the_commands_lead_to() -> None:
    field = Field().herding()
    first, ahead = field.planner.solved[0][1], field.planner.solved
    field.run(ACCEPTED)
    assert len(ahead) == 2
    # The first plan runs from LEAD after the observation: till then the dogs stand.
    np.testing.assert_allclose(first.d, seen(0.0).state.d, rtol=0, atol=1e-15)
    moved = ahead[1][1].d - seen(0.0).state.d  # observed dogs never move in this field
    np.testing.assert_allclose(moved, np.tile(1e-3 * np.array(GOAL), (3, 1)) * LEAD, atol=1e-12)


def test_it_is_learned_of_what_is_seen_not_of_what_is_predicted() -> None:
    field = Field().herding()
    field.run(ACCEPTED)
    for (seen_at, state), (start, _) in zip(
        field.planner.learned, field.planner.solved, strict=True
    ):
        assert seen_at == pytest.approx(start - LEAD)
        np.testing.assert_array_equal(state.d, seen(0.0).state.d)


def test_slow_solves_leave_the_second_half_and_then_the_dogs_stand_and_it_recovers() -> None:
    field = Field().herding()
    begun = field.t
    field.solving = 6.0
    field.run_until(lambda decision: not command(decision).any())
    assert field.t == pytest.approx(begun + LENGTH)  # the whole plan was played
    doing = {field.pilot.condition(t).doing for t in (begun + 2.5, begun + 4.5)}
    assert doing == {
        'playing the second half: the next plan is late',
        'standing: the plan is over and the next is not ready yet',
    }
    assert not field.pilot.condition(begun + 2.5).good
    assert field.pilot.deadlines_missed == 1  # once for each plan that is late
    assert len(field.said('a plan is late')) == 1
    field.solving = 0.3
    field.run_until(lambda decision: command(decision).any())
    field.run(10.0)
    assert field.pilot.condition(field.t).doing == 'playing a plan'
    assert field.pilot.deadlines_missed == 1


def test_late_plan_is_announced_as_late_and_played_from_where_it_should_be() -> None:
    field = Field(solving=LEAD + 0.25)
    announced = field.run_until(lambda decision: decision.announcement)
    assert announced.announcement is not None
    assert announced.announcement.margin == pytest.approx(-0.3, abs=1e-6)
    assert goal_of(command(announced)) == [GOAL] * 3
    assert field.pilot.deadlines_missed == 1


def test_failed_solves_are_counted_and_tried_again() -> None:
    field = Field().herding()
    field.planner.error = ArithmeticError('the solver is broken')
    field.run_until(lambda decision: not command(decision).any())
    assert field.pilot.plans_failed > 3
    assert len(field.said('the solver is broken')) == 1
    field.planner.error = None
    field.run_until(lambda decision: command(decision).any())


def test_dogs_stand_while_no_sheep_are_visible_and_go_on_afterwards() -> None:
    field = Field().herding()
    field.visible = False
    assert not command(field.tick()).any()
    assert field.pilot.condition(field.t).doing == 'standing: no sheep or no dogs in sight'
    field.visible = True
    assert command(field.tick()).any()
    field.visible = False
    field.run(10.0)  # longer than any plan lasts
    field.visible = True
    field.run_until(lambda decision: command(decision).any(), limit=2 * LEAD)


def test_silent_dog_is_planned_without_and_taken_back() -> None:
    field = Field().herding()
    field.dogs = (0, 2)
    planned = field.run_until(lambda decision: decision.announcement)
    assert planned.announcement is not None
    assert planned.announcement.plan.request.dogs == (0, 2)
    assert field.said('no odometry from dog_2: planning without')
    assert field.pilot.silent_dogs == ['dog_2']
    assert not field.pilot.condition(field.t).good
    field.run(LEAD)
    assert goal_of(command(field.tick())) == [GOAL, (0.0, 0.0), GOAL]
    field.dogs = (0, 1, 2)
    field.run(LEAD + 2 * field.solving)
    assert goal_of(command(field.tick())) == [GOAL] * 3
    assert field.said('odometry from all dogs again')


def test_first_plan_waits_a_moment_for_all_dogs() -> None:
    field = Field(timeout=0.5)
    field.dogs = (1,)
    field.run(0.5)
    assert not field.planner.solved
    field.dogs = (0, 1, 2)
    field.herding()
    assert field.planner.solved[0][1].d.shape == (3, 2)
    alone = Field(timeout=0.5)
    alone.dogs = (1,)
    alone.herding()
    assert alone.planner.solved[0][1].d.shape == (1, 2)


def test_moved_goal_is_planned_for_at_once_and_the_old_plan_goes_on_until_then() -> None:
    field = Field().herding()
    field.run(0.5)
    moved = field.t
    field.pilot.move_goal(np.array(NEW_GOAL))
    decisions = field.run(LEAD + 0.2)
    goals = [goal_of(command(decision))[0] for decision in decisions]
    assert goals[0] == GOAL
    assert goals[-1] == NEW_GOAL
    assert (0.0, 0.0) not in goals
    assert field.starts[-1] == pytest.approx(moved + PERIOD + LEAD)


def test_goal_that_is_moved_back_before_a_plan_is_begun_asks_for_nothing() -> None:
    field = Field().herding()
    before = len(field.planner.solved)
    field.pilot.move_goal(np.array(NEW_GOAL))
    field.pilot.move_goal(np.array(GOAL))
    field.run(0.5)
    assert len(field.planner.solved) == before


def test_of_two_plans_with_the_same_start_the_newer_is_played() -> None:
    """As when the clock stands, or is set back by a little, while the goal moves."""
    field = Field(solving=0.0).herding()
    for goal in ((3.0, 0.0), NEW_GOAL):
        field.pilot.move_goal(np.array(goal))
        field.tick(0.0)
    field.tick(0.0)
    assert field.starts[-1] == field.starts[-2]
    field.run(LEAD + 2 * PERIOD)
    assert goal_of(command(field.tick())) == [NEW_GOAL] * 3


def test_newest_of_several_goals_wins() -> None:
    field = Field().herding()
    for goal in ((3.0, 0.0), (2.0, 0.0), NEW_GOAL):
        field.pilot.move_goal(np.array(goal))
        field.tick()
    field.run(LEAD + 2 * field.solving + PERIOD)
    assert goal_of(command(field.tick())) == [NEW_GOAL] * 3


@pytest.mark.parametrize('every', [0.1, 1.0])
@pytest.mark.parametrize('moves', [True, False])
def test_goals_at_any_rate_do_not_starve_the_dogs(every: float, moves: bool) -> None:
    """A solve takes longer than the time between two goals."""
    field = Field(solving=0.9, lead=3.0).herding()
    begun = len(field.planner.solved)
    goal = np.array(GOAL)
    for k in range(400):
        if k % round(every / PERIOD) == 0:
            goal = goal + np.array([0.01, 0.0]) if moves else goal
            field.pilot.move_goal(goal)
        assert command(field.tick()).any()
    if moves:
        # What is played was asked for a lead and two solves ago at most.
        age = (goal[0] - goal_of(command(field.decisions[-1][1]))[0][0]) / 0.01 * every
        assert age <= 3.0 + 2 * 0.9 + 3 * PERIOD + every
    else:
        assert len(field.planner.solved) - begun == 20  # one for each window
    assert field.pilot.deadlines_missed == 0


def test_a_dog_whose_radio_comes_and_goes_does_not_stop_the_others() -> None:
    field = Field(solving=0.4, lead=3.0, timeout=0.5).herding()
    for k in range(600):
        field.dogs = (0, 1, 2) if k % 29 < 19 else (0, 1)
        assert goal_of(command(field.tick()))[:2] == [GOAL] * 2
    assert len(field.said('no odometry from dog_3')) == 2  # in a minute, of twenty times
    assert field.pilot.plans_failed == field.pilot.deadlines_missed == 0


def test_dogs_stop_in_the_period_in_which_time_is_set_back() -> None:
    field = Field().herding()
    assert command(field.tick()).any()
    stopped = field.tick(-0.3)
    assert not command(stopped).any()
    assert field.said('time was set back')
    # Zero is commanded until there is a plan for the new time.
    again = field.run_until(lambda decision: command(decision).any(), limit=2.0)
    assert again is field.decisions[-1][1]
    assert field.planner.restarts == 2


def test_plan_for_the_time_before_a_reset_is_dropped() -> None:
    field = Field(solving=0.5).herding()
    field.run_until(lambda _: field.pending)
    field.tick(-50.0)
    assert len(field.pending) == 1  # it ends in its own time
    announced = field.run_until(lambda decision: decision.announcement).announcement
    assert announced is not None
    assert field.t < announced.plan.start <= field.t + LEAD
    assert announced.number == 1


@pytest.mark.parametrize('step', [0.02, 0.09])
def test_small_steps_back_are_jitter(step: float) -> None:
    field = Field().herding()
    solved = len(field.planner.solved)
    assert command(field.tick(-step)).any()
    assert command(field.tick()).any()
    assert field.planner.restarts == 1
    assert not field.said('time was set back')
    assert len(field.planner.solved) <= solved + 1


def test_clock_that_leaps_ahead_beyond_the_plan_stops_the_dogs_until_the_next() -> None:
    field = Field().herding()
    assert not command(field.tick(1000.0)).any()
    field.run_until(lambda decision: command(decision).any(), limit=2 * LEAD)


def test_observation_counts_once_in_the_filter() -> None:
    """The clock may tick several times for one observation."""
    planner = FakePlanner(Control(horizon=CONTROL.horizon, sensor=Sensor(0.05, 0.05)))
    pilot = RealTimePilot(planner, 3, Timing(LEAD, 0.5), lambda: 0.0, lambda function: None)
    observed = seen(10.0)
    pilot.decide(10.0, observed)
    first = pilot.estimate
    pilot.decide(10.1, observed)
    assert pilot.estimate is first
    pilot.decide(10.2, seen(10.1))
    assert pilot.estimate is not first


def test_filter_that_fails_is_counted_and_the_observation_is_used_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    field = Field().herding()

    def fail(*_: object) -> HerdState:
        raise ValueError('sheep positions x holds NaN')

    monkeypatch.setattr(field.pilot._estimator, 'update', fail)
    assert command(field.tick()).any()
    assert field.pilot.plans_failed == 1
    assert field.pilot.estimate is not None
    np.testing.assert_array_equal(field.pilot.estimate.state.x, seen(0.0).state.x)


def test_the_filter_is_told_the_mean_of_the_commands_since_the_last_observation() -> None:
    """Of which sensors of a low rate, as GPS, leave many."""
    pilot, _ = lockstep()
    told: list[Array] = []

    def update(t: float, ids: Array, state: HerdState, u: Array, *_: object) -> HerdState:
        told.append(u)
        return state

    pilot._estimator.update = update  # type: ignore[method-assign, assignment]
    given = np.random.default_rng(0).normal(size=(4, 3, 2))
    for commands in (given[:1], given[1:], []):
        for u in commands:
            pilot._decision(u, None)
        pilot._observe(seen(0.1 * len(told)))
    np.testing.assert_array_equal(told[0], given[0])
    np.testing.assert_allclose(told[1], given[1:].mean(axis=0), rtol=1e-12)
    np.testing.assert_array_equal(told[2], given[3])


def test_sheep_out_of_sight_are_planned_for_until_they_are_lost_and_that_is_said() -> None:
    pilot, planner = lockstep(Control(horizon=HORIZON, sensor=Sensor(0.01, timeout=1.0)))
    said: list[tuple[float, str]] = []
    for k in range(81):
        decision = pilot.decide(seen(PERIOD * k, sheep=5 if k < 10 else 3))
        said += [(k, event.text) for event in decision.events if 'out of sight' in event.text]
        assert pilot.estimate_values()['sheep_out_of_sight'] == (2 if 10 <= k < 19 else 0)
    assert [(k, words[:46]) for k, words in said] == [
        (10, 'sheep out of sight are carried along by the mo'),
        (19, 'sheep out of sight for 1 s are lost, the plans'),
    ]
    assert said[1][1].endswith(': 3, 4')
    assert [len(state.x) for _, state in planner.solved] == [5, 3, 3, 3, 3]
    later = pilot.decide(seen(PERIOD * 81 + 1.0, sheep=3))
    assert [event.text for event in later.events] == [
        'no observation for longer than sensor.timeout, 1 s: the filter starts afresh'
    ]
    assert not lockstep()[0].estimate_values()


def test_it_is_told_how_far_and_how_spread_the_observed_flock_is() -> None:
    """Which is all that one who herds with robots learns of an arrival."""
    pilot, planner = lockstep(Control(horizon=HORIZON, arrival=flock.Allowance(strays=1)))
    x = np.array([[3.0, 0.0], [3.0, 2.0], [5.0, 0.0], [5.0, 2.0], [90.0, 0.0]])
    pilot.decide(replace(seen(0.0, sheep=5), state=HerdState(x, 0.0 * x, np.eye(3, 2))))
    to_goal = math.hypot(4.0 - planner.goal[0], 1.0 - planner.goal[1])
    assert pilot.estimate_values() == pytest.approx(
        {'distance_m': to_goal, 'spread_m': math.sqrt(2.0)}
    )


def test_sheep_may_come_and_go() -> None:
    field = Field().herding()
    for sheep in (1, 5, 3):
        for _ in range(20):
            field.t += PERIOD
            for _, function in field.pending:
                function()
            field.pending.clear()
            decision = field.pilot.decide(field.t, seen(field.t, sheep=sheep))
            assert command(decision).any()
        assert len(field.planner.solved[-1][1].x) == sheep


def improving(solving: float = 0.05, lead: float = LEAD) -> Field:
    field = Field(solving, lead, control=IMPROVING)
    field.ends_when_dropped = True
    return field.herding()


@pytest.mark.parametrize('solving', [0.0, 0.05, 0.3, 0.7])
def test_plans_are_improved_between_two_windows_which_join_as_without(solving: float) -> None:
    field = improving(solving)
    field.run(20.0)
    assert np.diff(field.starts) == pytest.approx(ACCEPTED)
    assert field.pilot.deadlines_missed == field.pilot.plans_failed == 0
    assert all(command(decision).any() for _, decision in field.decisions[-200:])
    improved = [plan for plan in field.plans if plan.observed > plan.start - 0.99 * LEAD]
    assert len(improved) >= 9  # at least one in each window
    assert len(field.plans) == len(field.planner.solved) + len(improved)
    windows = {round(start, 6) for start in field.starts}
    for plan in improved:
        assert round(plan.accepted_until - ACCEPTED, 6) in windows
    # The first of them did not know yet how long it would take.
    leads = [plan.start - plan.observed for plan in improved[1:]]
    assert leads == pytest.approx([max(PERIOD, math.ceil(solving / PERIOD) * PERIOD)] * len(leads))


def test_observation_that_the_plan_in_play_was_made_from_is_hardly_older_than_feedback() -> None:
    """Also when a window starts, which was planned from one a lead ago."""
    field = improving()
    field.run(3.0)
    ages = []
    for _ in range(200):
        field.tick()
        playing = field.pilot._schedule.playing(field.t)
        assert playing is not None
        ages.append(field.t - playing.observed)
    # Two periods for the feedback, two in which it is the turn of a window.
    assert max(ages) <= FEEDBACK + 4 * PERIOD + 1e-6
    assert command(field.tick())[0, 0] == pytest.approx(0.5e-3)


def test_surprise_is_answered_within_two_control_periods() -> None:
    field = improving()
    for wait in range(25):
        field.gust = 0.0
        field.run(2.0 + PERIOD * wait)
        begun = len(field.plans)
        surprised = field.t + PERIOD
        field.gust = 0.3
        field.run(0.3 + field.solving)
        answers = [plan for plan in field.plans[begun:] if plan.observed > surprised - 1e-6]
        assert answers
        # The second period is for a window that is under way when it happens.
        assert min(plan.start for plan in answers) <= surprised + 2 * PERIOD + 1e-6
    assert np.diff(field.starts) == pytest.approx(ACCEPTED)


def test_late_feedback_is_played_from_where_it_should_be_and_misses_no_deadline() -> None:
    field = improving()
    field.run_until(lambda _: field.pilot._task is None and field.planner.improved)
    field.run_until(lambda _: field.pending)
    field.pending[0] = (field.pending[0][0] + 0.3, field.pending[0][1])
    late = field.run_until(lambda decision: decision.announcement).announcement
    assert late is not None
    assert late.margin == pytest.approx(-0.3, abs=0.11)
    playing = field.pilot._schedule.playing(field.t)
    assert playing is late.plan
    assert field.pilot.deadlines_missed == 0
    # The next ones start later, until it is forgotten.
    leads = []
    for _ in range(40):
        field.run_until(lambda decision: decision.announcement)
        leads.append(field.plans[-1].start - field.plans[-1].observed)
    assert leads[0] >= 0.3
    assert leads[-1] == pytest.approx(PERIOD) or leads[-2] == pytest.approx(PERIOD)


def test_feedback_that_is_late_for_the_next_window_is_dropped() -> None:
    """It was to improve the plan before, up to the start of that window."""
    field = improving()
    field.run(ACCEPTED)
    schedule = field.pilot._schedule

    def improves_before_a_window() -> bool:
        task, last = field.pilot._task, schedule.last
        assert last is not None
        return task is not None and task.is_feedback and task.start < last.start - 1e-6

    field.run_until(lambda _: improves_before_a_window())
    last = schedule.last
    assert last is not None
    field.ends_when_dropped = False
    field.pending[0] = (field.elapsed + (last.start - field.t) + 0.25, field.pending[0][1])
    plans = len(field.plans)
    while field.t < last.start + 0.2:
        assert command(field.tick()).any()
        assert len(field.plans) == plans
    field.tick()
    assert schedule.playing(field.t) is last
    assert len(field.plans) == plans
    assert field.pilot.deadlines_missed == 0


def test_moved_goal_is_answered_by_a_feedback_before_its_window_starts() -> None:
    field = improving(lead=2.0)
    field.run(1.0)
    moved = field.t
    field.pilot.move_goal(np.array(NEW_GOAL))
    answered = field.run_until(lambda decision: command(decision)[0, 1] > 0.0)
    assert field.t <= moved + 5 * PERIOD + 1e-6
    assert command(answered)[0, 1] == pytest.approx(0.5e-3)


def test_failing_feedback_leaves_the_plan_and_is_said_once() -> None:
    field = improving()
    field.run(0.2)

    def fail(*_: object) -> Window:
        raise ArithmeticError('the solver is broken')

    field.planner.improve = fail  # type: ignore[method-assign]
    field.run(10.0)
    assert all(command(decision).any() for _, decision in field.decisions[-100:])
    assert np.diff(field.starts) == pytest.approx(ACCEPTED)
    assert field.pilot.plans_failed > 3
    assert len(field.said('the solver is broken')) == 1
    assert field.pilot.deadlines_missed == 0


def test_feedback_for_the_time_before_a_reset_is_dropped() -> None:
    field = improving(solving=0.25)
    field.run_until(lambda _: field.pilot._task is not None and field.pilot._task.is_feedback)
    field.ends_when_dropped = False
    field.tick(-50.0)
    announced = field.run_until(lambda decision: decision.announcement).announcement
    assert announced is not None
    assert field.planner.restarts == 2
    assert announced.plan.start == pytest.approx(field.starts[-1])
    assert announced.plan.observed < field.t < announced.plan.start


EVENTS = st.one_of(
    st.tuples(st.just('goal'), st.integers(0, 3)),
    st.tuples(st.just('dogs'), st.sampled_from([(0, 1, 2), (0, 1), (2,), (0, 2)])),
    st.tuples(st.just('jitter'), st.floats(0.0, 0.099)),
    st.tuples(st.just('solving'), st.floats(0.0, 0.9)),
    st.tuples(st.just('quiet'), st.integers(1, 40)),
    st.tuples(st.just('gust'), st.floats(0.0, 0.3)),
    st.tuples(st.just('adjust'), st.floats(0.01, 0.05)),
)


@settings(max_examples=50, deadline=None)
@given(st.lists(EVENTS, max_size=40), st.integers(1, 4), st.sampled_from([CONTROL, IMPROVING]))
def test_whatever_happens_there_is_a_plan_in_play_of_bounded_age(
    events: list[tuple[str, object]], every: int, control: Control
) -> None:
    """As long as solves keep their deadlines and time and sheep are there."""
    lead = 1.0
    field = Field(solving=0.2, lead=lead, control=control).herding()
    field.ends_when_dropped = True
    bound = max(ACCEPTED, 2 * lead) + 3 * PERIOD
    for kind, value in events:
        if kind == 'goal':
            field.pilot.move_goal(np.array([1.0, float(value)]))  # type: ignore[arg-type]
        elif kind == 'dogs':
            field.dogs = value  # type: ignore[assignment]
        elif kind == 'solving':
            # A feedback that has to make room for a window may take a period of its lead.
            field.solving = min(value, 0.9 if control is CONTROL else 0.7)  # type: ignore[call-overload]
        elif kind == 'gust':
            field.gust = value  # type: ignore[assignment]
        elif kind == 'adjust':
            field.pilot.adjust(Crowd(), replace(control, max_speed=value))  # type: ignore[arg-type]
        elif kind == 'jitter':
            field.tick(-value)  # type: ignore[operator]
        for _ in range(value if kind == 'quiet' else every):  # type: ignore[call-overload]
            decision = field.tick()
            playing = field.pilot._schedule.playing(field.t)
            assert playing is not None
            assert field.t - playing.start <= bound
            expected = playing.velocities(field.t, 3)
            np.testing.assert_array_equal(decision.command, expected)
            assert expected[list(playing.request.dogs)].any()
    # What was asked for last is what is played in the end.
    field.run(lead + 2 * field.solving + 3 * PERIOD)
    playing = field.pilot._schedule.playing(field.t)
    assert playing is not None
    assert playing.request.goal == field.pilot._goal
    assert playing.request.dogs == field.dogs
    assert field.pilot.deadlines_missed == 0


def in_motion(
    pilot: LockstepPilot, periods: int, follows: Callable[[int], bool]
) -> list[Decision]:
    """Decisions for three dogs, of which the second follows its commands when it says so."""
    decisions: list[Decision] = []
    start = seen(0.0)
    d = start.state.d.copy()
    for k in range(periods):
        state = replace(start.state, d=d)
        decisions.append(pilot.decide(replace(start, stamp=round(1e8 * k), state=state)))
        u = command(decisions[-1]).copy()
        u[1] *= follows(k)
        d = d + PERIOD * u
    return decisions


def test_a_dog_that_does_not_do_as_told_is_left_out_of_the_plans_until_it_does() -> None:
    control = Control(horizon=HORIZON, bodies=Bodies(separation=0.05, margin=0.0, radius=0.02))
    planner = FakePlanner(control)
    planner.speed = 0.04
    pilot = LockstepPilot(planner, 3)
    decisions = in_motion(pilot, 50, lambda k: k < 20)
    (event,) = [each for decision in decisions for each in decision.events]
    assert event.level == 'warning'
    assert 'dog_2 does not do as told' in event.text
    assert pilot.disobedient_dogs == ['dog_2']
    assert not pilot.condition(5.0).good
    assert planner.solved[-1][1].d.shape == (2, 2)
    told = [command(decision)[1] for decision in decisions]
    assert all(u[0] > 0.03 for u in told[10:30])
    assert not np.any(told[40:])  # within two seconds
    assert all(command(decision)[0, 0] > 0.03 for decision in decisions[40:])
    assert pilot.estimate is not None
    assert pilot.estimate.dogs == (0, 2)


def test_a_dog_that_is_free_again_is_tried_and_planned_with() -> None:
    control = Control(horizon=HORIZON, bodies=Bodies(separation=0.05, margin=0.0, radius=0.02))
    planner = FakePlanner(control)
    planner.speed = 0.04
    pilot = LockstepPilot(planner, 3)
    decisions = in_motion(pilot, 180, lambda k: not 20 <= k < 60)
    events = [each for decision in decisions for each in decision.events]
    assert [each.level for each in events] == ['warning', 'info']
    assert 'dog_2 does as told again' in events[1].text
    assert not pilot.disobedient_dogs
    trial = [command(decision)[1] for decision in decisions[40:160]]
    away = [u for u in trial if u[0] < 0.0]  # the flock is in front of them
    assert 0 < len(away) <= 25
    assert np.linalg.norm(away, axis=1).max() == pytest.approx(0.5 * control.max_speed)
    assert planner.solved[-1][1].d.shape == (3, 2)


def test_a_dog_that_stumbles_again_and_again_is_told_of_once_in_half_a_minute() -> None:
    control = Control(horizon=HORIZON, bodies=Bodies(separation=0.05, margin=0.0, radius=0.02))
    planner = FakePlanner(control)
    planner.speed = 0.04
    pilot = LockstepPilot(planner, 3)
    decisions = in_motion(pilot, 600, lambda k: k < 20 or k % 120 < 80)
    told = [
        0.1 * k
        for k, decision in enumerate(decisions)
        for each in decision.events
        if 'does not do as told' in each.text
    ]
    assert len(told) == 2
    assert told[1] - told[0] > 29.0


def test_a_dog_that_is_stuck_again_soon_and_for_good_is_told_of_again() -> None:
    control = Control(horizon=HORIZON, bodies=Bodies(separation=0.05, margin=0.0, radius=0.02))
    planner = FakePlanner(control)
    planner.speed = 0.04
    pilot = LockstepPilot(planner, 3)
    decisions = in_motion(pilot, 420, lambda k: k < 20 or 60 <= k < 190)
    said = [(k, event.level) for k, decision in enumerate(decisions) for event in decision.events]
    assert [level for _, level in said] == ['warning', 'info', 'warning']
    assert said[2][0] - said[0][0] == 300
    assert pilot.disobedient_dogs == ['dog_2']


def test_what_was_said_long_ago_is_not_kept() -> None:
    """Such as which sheep were lost: a tracker may give each sight of one another name."""
    pilot = LockstepPilot(FakePlanner(Control(horizon=HORIZON)), 1)
    kept = []
    for k in range(100):
        pilot._time = 10.0 * k
        pilot._say('info', f'sheep {k} is lost')
        pilot._say('info', 'said again after half a minute')
        kept.append(len(pilot._said))
    assert max(kept) <= 4
    texts = [event.text for event in pilot._events]
    assert set(texts) > {f'sheep {k} is lost' for k in range(100)}
    assert texts.count('said again after half a minute') == 34


def test_commands_under_way_are_predicted() -> None:
    """The herd is planned for as it will be once they have been carried out."""
    control, goal = Control(delay=0.5), np.array([0.5, 0.5])
    world = World(sheep=5, dogs=3, delay=0.5, position_noise=0.0, velocity_noise=0.0, substeps=2,
                  dt=0.05)  # fmt: skip
    crowd = Crowd(noise=0.0)
    simulation = Simulation(crowd, world, goal)
    pilot = LockstepPilot(RecedingHorizon(crowd, control, goal), 3)
    expected, states = [], [simulation.state]
    for k in range(25):
        decision = pilot.decide(Observed.complete(0.1 * k, simulation.observe().state))
        assert pilot.estimate is not None
        expected.append(pilot.estimate.state)
        simulation.advance(command(decision))
        states.append(simulation.state)
    assert np.abs(states[20].dogs - states[10].dogs).max() > 0.02
    for k, state in enumerate(expected[:20]):
        np.testing.assert_allclose(state.d, states[k + 5].d, atol=1e-12)
        np.testing.assert_allclose(state.x, states[k + 5].x, atol=1e-6)
