"""The controller node: from observed sheep and dogs to commands for the dogs.

In lockstep every complete observation is answered, and the solve that is due is done first.
Otherwise the node keeps its own time: commands go out at every control period, and the next
window is planned in the background, from the state predicted for its beginning. A plan that is
late leaves the second half of the old one to be played; after that the dogs stand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
import math
import sys
import threading

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Path
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile
from trajectory_msgs.msg import MultiDOFJointTrajectory

from herding_ros.control.estimator import Estimator
from herding_ros.control.parameters import Control
from herding_ros.control.receding_horizon import RecedingHorizon, Window
from herding_ros.control.solution import NoTimeFor
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import rollout
from herding_ros.model.parameters import quantity, TINY
from herding_ros.model.state import Array, HerdState
from herding_ros.model.warmup import warm_up

from . import messages
from .background import StepTimes, Work
from .observations import Observations, Observed
from .parameters import declare, HerdingNode
from .rivals import sole_publisher
from .running import (
    ADJUSTABLE,
    CountingPublisher,
    EVERY_MESSAGE,
    is_heard,
    LOCKSTEP_TURN,
    run,
    UNWATCHED,
)
from .settings import declare_crowd, LIVE_NOISE, NodeSettings

LIVE = ('weights.', *LIVE_NOISE, 'horizon.length', 'horizon.accepted', 'max_speed')
"""Parameters that may change while the controller runs; they count from the next plan on."""

_PATH_SPACING = 0.5
"""Time between two poses of a path [s]."""

_SPARE = 0.1
"""Part of the lead that a solve leaves: /clock may be heard late, and a plan be taken late."""

_STATE_PERIOD = 1.0
"""Wall time between two messages on /diagnostics about the node itself [s]."""

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass(frozen=True)
class ControllerSettings(NodeSettings):
    """How the controller behaves as a ROS node."""

    dogs: int = quantity(5, 'number of dogs', low=1)
    most_sheep: int = quantity(
        100_000, 'a message with more sheep than this is refused', low=1, high=1_000_000
    )
    seed: int = quantity(0, 'seed of the Monte Carlo paths', low=0)
    lead: float = quantity(
        2.0, 'time before its window at which a plan is begun, not in lockstep', 's', low=0.0
    )
    state_timeout: float = quantity(
        1.0,
        'not in lockstep, observations older than this do not count: without sheep the dogs '
        'stop, without its odometry a dog is left out of the plans',
        's',
        low=TINY,
    )


@dataclass(frozen=True)
class Playing:
    """A window and the dogs that it was planned for, by their indices from 0."""

    window: Window
    dogs: tuple[int, ...]

    def velocities(self, t: float, dogs: int) -> Array:
        """Velocities (dogs, 2) [m/s] of all dogs at t [s]; those without a plan stand."""
        u = np.zeros((dogs, 2))
        u[list(self.dogs)] = self.window.plan.at(t)
        return u


class Controller(HerdingNode):
    """Space-mapping receding-horizon control behind the topics of real trackers and robots."""

    def __init__(self) -> None:
        """Declare parameters, make the kernels ready, then listen."""
        super().__init__('controller')
        self._settings = declare(self, ControllerSettings())
        self._crowd = declare_crowd(self, live=LIVE)
        self._control = declare(self, Control(), live=LIVE)
        self._goal = np.array(self._settings.goal)
        self._planner = RecedingHorizon(
            self._crowd, self._control, self._goal, self._settings.seed
        )
        horizon = self._control.horizon
        self._estimator = Estimator(
            self._crowd, self._control.sensor, horizon.control_period, horizon.substeps
        )
        self._stopping = threading.Event()
        lead = self._settings.lead
        self._step_times = StepTimes(guess=0.25 * lead, most=lead)
        self._coming: Work[Playing] | None = None  # the plan that is being made
        self._late: Work[Playing] | None = None  # the last one that was not there in time
        self._next: Playing | None = None  # the one that waits for its window
        self._start_anew()
        self._plans = self._missed = self._failed = 0
        self.load_kernels(warm_up)

        create = partial(
            self.create_publisher, publisher_class=CountingPublisher, event_callbacks=UNWATCHED
        )
        publish = partial(create, qos_profile=EVERY_MESSAGE)
        self._plan = sole_publisher(
            self, 'plan', lambda: create(MultiDOFJointTrajectory, 'plan', _LATCHED)
        )
        kind = TwistStamped if self._settings.stamped else Twist
        self._names = [f'dog_{m + 1}' for m in range(self._settings.dogs)]
        self._commands = [
            publish(kind, f'{name}/cmd_vel', qos_overriding_options=ADJUSTABLE)
            for name in self._names
        ]
        self._herd_path = publish(Path, 'herd/path')
        self._dog_paths = [publish(Path, f'{name}/path') for name in self._names]
        self._diagnostics = publish(DiagnosticArray, '/diagnostics')
        self.follow([('crowd.', self._crowd), ('', self._control)], self._take_parameters)
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._waiting = self.create_timer(0.02, self._listen_when_heard, clock=self._wall)

    def _start_anew(self) -> None:
        """Forget the past, as at the start or when time was set back."""
        self._time = -math.inf
        self._playing: Playing | None = None
        self._watching_since = math.inf
        self._in_sight: tuple[int, ...] = ()
        self._estimate: Observed | None = None
        self._estimator.reset()
        self._told: Array = np.zeros((self._settings.dogs, 2))  # what the dogs were told last
        self._anew = True
        self._plan_at_once()

    def _plan_at_once(self) -> None:
        """Let nobody wait for a plan whose reasons no longer hold."""
        self._urgent = True
        self._next = None
        if self._coming is not None:
            self._coming.drop()

    def _take_parameters(self, crowd: Crowd, control: Control) -> None:
        self._crowd, self._control = crowd, control

    def stop(self) -> None:
        """Let a solve that is under way end early, since the node ends."""
        self._stopping.set()

    def _listen_when_heard(self) -> None:
        """Listen to observations only once nobody misses what they are answered with."""
        settings = self._settings
        if settings.lockstep and not all(
            any(
                is_heard(self, [commands], listener.node_name)
                for listener in self.get_subscriptions_info_by_topic(commands.topic_name)
                if listener.node_name != settings.wait_for
            )
            for commands in self._commands
        ):
            return
        everything = [*self._commands, self._plan, self._herd_path, *self._dog_paths]
        everything.append(self._diagnostics)
        if settings.wait_for and not is_heard(self, everything, settings.wait_for):
            return
        self.destroy_timer(self._waiting)
        self._observations = Observations(
            self, settings.dogs, settings.frame, settings.most_sheep, settings.state_timeout,
            self._refused,
        )  # fmt: skip
        self.create_subscription(PoseStamped, 'goal_pose', self._on_goal, 1, raw=True)
        self.create_timer(_STATE_PERIOD, self._publish_state, clock=self._wall)
        if settings.lockstep:
            self.create_timer(0.0, self._keep_in_step, clock=self._wall)
        else:
            self.create_timer(self._control.horizon.control_period, self._keep_time)
        self.get_logger().info(f'ready to herd with {settings.dogs} dogs')

    def _on_goal(self, data: bytes) -> None:
        try:
            self._goal = messages.goal_in(data, self._settings.frame)
        except ValueError as error:
            self._refused.add('goal_pose', error)
            return
        self._plan_at_once()
        self.get_logger().info(f'the destination is now ({self._goal[0]:g}, {self._goal[1]:g})')

    def _prepare_planner(self) -> None:
        """Tell the planner, while it is idle, what has changed since its last plan."""
        planner = self._planner
        if (self._crowd, self._control) != (planner.crowd, planner.control):
            planner.adjust(self._crowd, self._control)
        self._estimator.crowd = self._crowd
        planner.move_goal(self._goal)
        if self._anew:
            planner.restart()
        self._anew = self._urgent = False

    # Lockstep: solve when due, then answer.

    def _keep_in_step(self) -> None:
        """Answer when sheep come, which come last; the executor sees to all else in between."""
        for _ in self._observations.arrivals(LOCKSTEP_TURN):
            self._answer_when_complete()

    def _answer_when_complete(self) -> None:
        self._observations.take()
        observed = self._observations.answerable()
        if observed is None:
            return
        t = observed.ns * 1e-9
        if t < self._time:
            self._start_anew()
        self._time, self._in_sight = t, observed.dogs
        state = self._estimated(observed).state
        solved = self._playing is None or self._urgent or self._planner.due(t)
        if solved:
            self._prepare_planner()
            window = self._planner.solve(state, t, lambda _: self._stopping.is_set())
            self._playing = Playing(window, observed.dogs)
        self._command(self._velocities(t), observed.ns)
        if solved and self._playing is not None:
            self._announce(self._playing, observed.ns, 0.0)  # while the sim moves on

    # Otherwise: play, and plan ahead in the background.

    def _keep_time(self) -> None:
        now = self.get_clock().now().nanoseconds
        t = now * 1e-9
        if t < self._time:
            self._observations.forget()
            self._start_anew()
        self._time = t
        self._observations.take(now)
        observed = self._observations.in_sight(now)
        if observed is not None:
            estimate = self._estimated(observed)
            if self._is_everyone_there(estimate, t):
                self._notice_dogs(estimate.dogs)
                if self._is_time_to_plan(t):
                    self._begin_plan(estimate, t)
        self._take_plan(now)
        if self._next is not None and t >= self._next.window.plan.t0 - 1e-9:
            self._playing, self._next = self._next, None
        if self._playing is not None:
            lost = observed is None
            self._command(np.zeros_like(self._told) if lost else self._velocities(t), now)

    def _is_everyone_there(self, observed: Observed, t: float) -> bool:
        """Whether all dogs are in sight, or have had the time to show themselves."""
        self._watching_since = min(self._watching_since, t)
        waited = t - self._watching_since
        return len(observed.dogs) == len(self._names) or waited > self._settings.state_timeout

    def _notice_dogs(self, dogs: tuple[int, ...]) -> None:
        """Plan at once when a dog has fallen silent or is back."""
        if dogs == self._in_sight:
            return
        returned = len(dogs) > len(self._in_sight) > 0
        self._in_sight = dogs
        self._plan_at_once()
        if silent := ', '.join(self._silent()):
            self.get_logger().warning(f'nothing is heard from {silent}: planning without')
        elif returned:
            self.get_logger().info('all dogs are heard again')

    def _silent(self) -> list[str]:
        return [name for m, name in enumerate(self._names) if m not in self._in_sight]

    def _is_time_to_plan(self, t: float) -> bool:
        if self._coming is not None or self._next is not None:
            return False
        if self._playing is None or self._urgent:
            return True
        return t >= self._window_end(self._playing) - self._settings.lead

    def _window_end(self, playing: Playing) -> float:
        """Time at which the accepted part of a plan is over and the next one begins [s]."""
        return playing.window.plan.t0 + self._planner.control.horizon.accepted

    def _begin_plan(self, observed: Observed, t: float) -> None:
        """Plan the next window in the background, from the state predicted for its start."""
        period = self._control.horizon.control_period
        start = t + period * math.ceil(self._settings.lead / period)
        if self._playing is not None and not self._urgent:
            # The windows join, unless too little is left of the lead for a plan to be there.
            end = self._window_end(self._playing)
            start = end if t + 0.5 * self._settings.lead <= end else start
        state = self._predict(observed, round((start - observed.ns * 1e-9) / period))
        self._prepare_planner()
        planner = self._planner

        def plan(no_time_for: NoTimeFor) -> Playing:
            window = planner.solve(
                state, start, lambda step: self._stopping.is_set() or no_time_for(step)
            )
            return Playing(window, observed.dogs)

        spare = max(_SPARE * self._settings.lead, period)
        self._coming = Work(plan, start, self._now, self._step_times, spare)

    def _now(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _predict(self, observed: Observed, periods: int) -> HerdState:
        """Return the state some control periods after an observation, without noise."""
        if periods <= 0:
            return observed.state
        horizon = self._control.horizon
        times = observed.ns * 1e-9 + horizon.control_period * np.arange(periods)
        u = np.array([self._velocities(t)[list(observed.dogs)] for t in times])
        return rollout(self._crowd, observed.state, u, horizon.dt, horizon.substeps).at(-1)

    def _take_plan(self, now: int) -> None:
        """Take the plan that has been made; count it once when it is late."""
        coming = self._coming
        if coming is None:
            return
        if coming.margin < 0.0 and not coming.dropped and coming is not self._late:
            self._late = coming
            self._missed += 1
            self.get_logger().warning(
                f'a plan is late, the old one is played on; raise lead '
                f'({self._settings.lead:g} s) or mapping.standard_error, or lower mapping.paths'
            )
        if not coming.done:
            return
        self._coming = None
        if coming.error is not None:
            self._count_failure(coming.error)
        elif coming.result is not None and not coming.dropped:
            self._next = coming.result
            self._announce(coming.result, now, coming.margin)

    def _count_failure(self, error: Exception) -> None:
        if not self._failed:
            self.get_logger().error(
                f'a plan could not be made: {error!r}; further ones are counted'
            )
        self._failed += 1

    # Both.

    def _estimated(self, observed: Observed) -> Observed:
        """Return what is believed after an observation; each counts once."""
        last = self._estimate
        if last is None or (observed.ns, observed.dogs) != (last.ns, last.dogs):
            t = observed.ns * 1e-9
            state = self._estimator.update(
                t, observed.ids, observed.state, self._told, observed.dogs
            )
            self._estimate = replace(observed, state=state)
            return self._estimate
        return last

    def _velocities(self, t: float) -> Array:
        """What the plan that is played tells all dogs (M, 2) [m/s] at t [s]."""
        return (
            np.zeros_like(self._told)
            if self._playing is None
            else self._playing.velocities(t, len(self._told))
        )

    def _command(self, u: Array, ns: int) -> None:
        """Tell the dogs their velocities u (M, 2) [m/s]."""
        self._told = u
        headings = self._observations.headings
        for m, publisher in enumerate(self._commands):
            if self._settings.stamped:
                publisher.publish(messages.command(u[m], headings[m], m + 1, ns))
            else:
                publisher.publish(messages.twist(u[m], headings[m]))

    def _announce(self, playing: Playing, ns: int, margin: float) -> None:
        """Publish a new plan, what it is expected to do and how it was found."""
        frame, window = self._settings.frame, playing.window
        substeps = self._control.horizon.substeps
        start = round(window.plan.t0 * 1e9)
        names = tuple(self._names[m] for m in playing.dogs)
        dogs = window.dogs[:-1:substeps]
        self._plan.publish(messages.trajectory(window.plan, dogs, names, start, frame))
        every = max(round(_PATH_SPACING / window.dt), 1)
        spacing = every * window.dt
        self._herd_path.publish(messages.path(window.centre[::every], spacing, start, frame))
        for m, route in zip(playing.dogs, window.dogs[::every].swapaxes(0, 1), strict=True):
            self._dog_paths[m].publish(messages.path(route, spacing, start, frame))
        values = {
            'replan': self._plans,
            'goal_x': self._planner.goal[0],
            'goal_y': self._planner.goal[1],
            **messages.report_values(window.report),
            'deadline_margin_s': margin,
            'deadlines_missed': self._missed,
        }
        self._plans += 1
        level = DiagnosticStatus.OK if margin >= 0.0 else DiagnosticStatus.WARN
        status = window.report.status.value
        self._diagnostics.publish(
            messages.diagnostics('controller: plan', ns, level, status, values)
        )

    def _publish_state(self) -> None:
        """Say what the node is doing, and what has gone wrong so far."""
        now = self.get_clock().now().nanoseconds
        doing, good = self._doing(now)
        values = {
            'dogs_silent': ' '.join(self._silent()),
            'deadlines_missed': self._missed,
            'plans_failed': self._failed,
            **self._refused.report_values(),
        }
        good = good and not (self._failed or self._refused.counts)
        level = DiagnosticStatus.OK if good else DiagnosticStatus.WARN
        self._diagnostics.publish(
            messages.diagnostics('controller: state', now, level, doing, values)
        )

    def _doing(self, now: int) -> tuple[str, bool]:
        """Say in words what is played, and whether that is as it should be."""
        if self._settings.lockstep:
            return 'answering in lockstep', True
        if self._observations.in_sight(now) is None:
            return 'standing: no sheep or no dogs in sight', False
        if self._playing is None:
            return 'standing: the first plan is not there yet', True
        if now * 1e-9 >= self._playing.window.plan.end:
            return 'standing: the plan is over and the next is not there yet', False
        if now * 1e-9 >= self._window_end(self._playing):
            return 'playing the second half: the next plan is late', False
        return 'playing a plan', not self._silent()


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(Controller, args)


if __name__ == '__main__':
    sys.exit(main())
