"""The controller node: from observed sheep and dogs to commands for the dogs.

In lockstep every complete observation is answered, and the solve that is due is done first.
Otherwise the node keeps its own time: commands go out at every control period, and the next
window is planned in the background, from the state predicted for its beginning.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
import sys

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from trajectory_msgs.msg import MultiDOFJointTrajectory

from herding_ros.control.parameters import Control
from herding_ros.control.plan import Plan
from herding_ros.control.receding_horizon import RecedingHorizon, Window
from herding_ros.model.dynamics import rollout
from herding_ros.model.parameters import quantity, TINY
from herding_ros.model.state import Array, HerdState
from herding_ros.model.warmup import warm_up

from . import messages
from .inbox import Inbox
from .parameters import declare, declare_crowd, NodeSettings
from .refusals import Refusals
from .running import (
    ADJUSTABLE,
    CountingPublisher,
    EVERY_MESSAGE,
    is_heard,
    LOCKSTEP_TURN,
    run,
    UNWATCHED,
)

_PATH_SPACING = 0.5
"""Time between two poses of a path [s]."""

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass(frozen=True)
class ControllerSettings(NodeSettings):
    """How the controller behaves as a ROS node."""

    dogs: int = quantity(5, 'number of dogs', low=1)
    seed: int = quantity(0, 'seed of the Monte Carlo paths', low=0)
    lead: float = quantity(
        2.0, 'time before its window at which a plan is begun, not in lockstep', 's', low=0.0
    )
    state_timeout: float = quantity(
        1.0, 'dogs stop when the last observation is older, not in lockstep', 's', low=TINY
    )


@dataclass(frozen=True)
class Observed:
    """The newest complete observation: state and headings (M,) [rad] of the dogs at ns."""

    ns: int
    state: HerdState
    headings: Array


class Controller(Node):
    """Space-mapping receding-horizon control behind the topics of real trackers and robots."""

    def __init__(self) -> None:
        """Declare parameters, make the kernels ready, then listen."""
        super().__init__('controller')
        self._settings = declare(self, ControllerSettings())
        self._crowd = declare_crowd(self)
        self._control = declare(self, Control())
        self._planner = RecedingHorizon(
            self._crowd, self._control, np.array(self._settings.goal), self._settings.seed
        )
        self._refused = Refusals(self.get_logger())
        self._dogs = range(1, self._settings.dogs + 1)
        self._flock: tuple[int, Array, Array] | None = None
        self._dog: dict[int, tuple[int, Array, float]] = {}
        self._goal_moved = False
        self._plans = 0
        # Not in lockstep: the plan that is played, the one that waits, the one being made.
        self._playing: Plan | None = None
        self._next: Plan | None = None
        self._coming: Future[tuple[Window, float]] | None = None
        self._worker = ThreadPoolExecutor(1, 'planner')
        self._time = 0.0
        self._missed = 0

        create = partial(
            self.create_publisher, publisher_class=CountingPublisher, event_callbacks=UNWATCHED
        )
        publish = partial(create, qos_profile=EVERY_MESSAGE)
        kind = TwistStamped if self._settings.stamped else Twist
        self._commands = [
            publish(kind, f'dog_{m}/cmd_vel', qos_overriding_options=ADJUSTABLE)
            for m in self._dogs
        ]
        self._plan = create(MultiDOFJointTrajectory, 'plan', _LATCHED)
        self._herd_path = publish(Path, 'herd/path')
        self._dog_paths = [publish(Path, f'dog_{m}/path') for m in self._dogs]
        self._diagnostics = publish(DiagnosticArray, '/diagnostics')
        self.get_logger().info(f'kernels loaded in {warm_up():.1f} s')
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._waiting = self.create_timer(0.02, self._listen_when_heard, clock=wall)

    def _listen_when_heard(self) -> None:
        """Listen to observations only once nobody misses what they are answered with."""
        if self._settings.lockstep and not all(
            any(
                is_heard(self, [commands], listener.node_name)
                for listener in self.get_subscriptions_info_by_topic(commands.topic_name)
                if listener.node_name != self._settings.wait_for
            )
            for commands in self._commands
        ):
            return
        everything = [*self._commands, self._plan, self._herd_path, *self._dog_paths]
        everything.append(self._diagnostics)
        if self._settings.wait_for and not is_heard(self, everything, self._settings.wait_for):
            return
        self.destroy_timer(self._waiting)
        self._sheep = Inbox(self, PointCloud2, 'sheep', 10, qos_overriding_options=ADJUSTABLE)
        self._odometry = [
            Inbox(self, Odometry, f'dog_{m}/odom', 10, qos_overriding_options=ADJUSTABLE)
            for m in self._dogs
        ]
        self.create_subscription(PoseStamped, 'goal_pose', self._on_goal, 1)
        if self._settings.lockstep:
            wall = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(0.0, self._keep_in_step, clock=wall)
        else:
            self.create_timer(self._control.horizon.control_period, self._keep_time)
        self.get_logger().info(f'ready to herd with {self._settings.dogs} dogs')

    def _take_observations(self) -> None:
        frame = self._settings.frame
        for data, _ in self._sheep.take():
            try:
                self._flock = messages.sheep_in(data, frame)
            except ValueError as error:
                self._refused.add('sheep', error)
        for m, inbox in zip(self._dogs, self._odometry, strict=True):
            for data, _ in inbox.take():
                try:
                    self._dog[m] = messages.dog_in(data, frame)
                except ValueError as error:
                    self._refused.add(f'dog_{m}/odom', error)

    def _on_goal(self, message: PoseStamped) -> None:
        try:
            goal = messages.goal_in(message, self._settings.frame)
        except ValueError as error:
            self._refused.add('goal_pose', error)
            return
        self._planner.move_goal(goal)
        self._goal_moved = True
        self.get_logger().info(f'the destination is now ({goal[0]:g}, {goal[1]:g})')

    def _observed(self) -> Observed | None:
        """Return the newest observation, as old as its oldest part; None while incomplete."""
        self._take_observations()
        if self._flock is None or len(self._dog) < len(self._dogs):
            return None
        ns, x, v = self._flock
        dogs = [self._dog[m] for m in self._dogs]
        state = HerdState(x, v, np.array([position for _, position, _ in dogs]))
        headings = np.array([heading for _, _, heading in dogs])
        return Observed(min(ns, *(ns for ns, _, _ in dogs)), state, headings)

    # Lockstep: solve when due, then answer.

    def _keep_in_step(self) -> None:
        """Answer when sheep come, which come last; the executor sees to all else in between."""
        for _ in self._sheep.arrivals(LOCKSTEP_TURN):
            self._answer_when_complete()

    def _answer_when_complete(self) -> None:
        observed = self._observed()
        if observed is None or self._flock is None:
            return
        ns = self._flock[0]
        if any(dog[0] != ns for dog in self._dog.values()):
            return
        self._flock = None  # each observation is answered once
        self._dog.clear()
        t = ns * 1e-9
        if self._planner.plan is not None and self._planner.plan.index(t) < 0:
            self._planner.restart()  # time was set back: start anew
        if self._planner.due(t) or self._goal_moved:
            self._goal_moved = False
            window = self._planner.solve(observed.state, t)
            self._command(window.plan.at(t), observed.headings, ns)
            self._announce(window, ns, 0.0)  # while the sim moves on
        else:
            assert self._planner.plan is not None
            self._command(self._planner.plan.at(t), observed.headings, ns)

    # Otherwise: play, and plan ahead in the background.

    def _keep_time(self) -> None:
        now = self.get_clock().now().nanoseconds
        t = now * 1e-9
        observed = self._observed()
        if observed is None:
            return
        if t < self._time:
            self._playing = self._next = self._coming = None  # time was set back: start anew
            self._planner.restart()
        self._time = t
        fresh = t - observed.ns * 1e-9 <= self._settings.state_timeout
        if fresh and self._is_time_to_plan(t):
            self._begin_plan(observed, t)
        if self._coming is not None and self._coming.done():
            self._next = self._made_plan(*self._coming.result(), now)
            self._coming = None
        if self._next is not None and t >= self._next.t0 - 1e-9:
            self._playing, self._next = self._next, None
        if self._playing is None:
            return
        u = self._playing.at(t) if fresh else np.zeros((len(self._dogs), 2))
        self._command(u, observed.headings, now)

    def _is_time_to_plan(self, t: float) -> bool:
        if self._coming is not None or self._next is not None:
            return False
        if self._playing is None or self._goal_moved:
            return True
        return t >= self._playing.t0 + self._control.horizon.accepted - self._settings.lead

    def _begin_plan(self, observed: Observed, t: float) -> None:
        """Plan the next window in the background, from the state predicted for its start."""
        start = t + self._settings.lead
        if self._playing is not None and not self._goal_moved:
            start = max(self._playing.t0 + self._control.horizon.accepted, t)
        self._goal_moved = False
        period = self._control.horizon.control_period
        steps = max(round((start - observed.ns * 1e-9) / period), 0)
        state = self._predict(observed, steps)
        self._coming = self._worker.submit(self._solve, state, start)

    def _solve(self, state: HerdState, start: float) -> tuple[Window, float]:
        """Return the window and how long before its start it was ready [s]; in the background."""
        window = self._planner.solve(state, start)
        return window, start - self.get_clock().now().nanoseconds * 1e-9

    def _predict(self, observed: Observed, periods: int) -> HerdState:
        """Return the state some control periods after an observation, without noise."""
        if not periods:
            return observed.state
        horizon = self._control.horizon
        times = observed.ns * 1e-9 + horizon.control_period * np.arange(periods)
        standing = np.zeros((len(self._dogs), 2))
        u = [standing if self._playing is None else self._playing.at(t) for t in times]
        return rollout(self._crowd, observed.state, np.array(u), horizon.dt, horizon.substeps).at(
            -1
        )

    def _made_plan(self, window: Window, margin: float, now: int) -> Plan:
        """Announce a plan that has been made; count it when it is late."""
        if margin < 0.0 and self._playing is not None:
            self._missed += 1
            self.get_logger().warning(
                f'a plan was late by {-margin:.2f} s, the old one was played on; '
                f'raise lead ({self._settings.lead:g} s) or lower mapping.paths'
            )
        self._announce(window, now, margin)
        return window.plan

    # Both.

    def _command(self, u: Array, headings: Array, ns: int) -> None:
        for m, publisher in enumerate(self._commands):
            if self._settings.stamped:
                publisher.publish(messages.command(u[m], headings[m], m + 1, ns))
            else:
                publisher.publish(messages.twist(u[m], headings[m]))

    def _announce(self, window: Window, ns: int, margin: float) -> None:
        """Publish a new plan, what it is expected to do and how it was found."""
        frame, report = self._settings.frame, window.report
        substeps = self._control.horizon.substeps
        start = round(window.plan.t0 * 1e9)
        dogs = window.dogs[:-1:substeps]
        self._plan.publish(messages.trajectory(window.plan, dogs, start, frame))
        every = max(round(_PATH_SPACING / window.dt), 1)
        spacing = every * window.dt
        self._herd_path.publish(messages.path(window.centre[::every], spacing, start, frame))
        for m, publisher in enumerate(self._dog_paths):
            publisher.publish(messages.path(window.dogs[::every, m], spacing, start, frame))
        values = {
            'replan': self._plans,
            **messages.report_values(report),
            'deadline_margin_s': margin,
            'deadlines_missed': self._missed,
            **{f'refused {kind}': count for kind, count in self._refused.counts.items()},
        }
        self._plans += 1
        good = margin >= 0.0 and not self._refused.counts
        level = DiagnosticStatus.OK if good else DiagnosticStatus.WARN
        self._diagnostics.publish(
            messages.diagnostics('controller: plan', ns, level, report.status.value, values)
        )

    def destroy_node(self) -> None:
        """Let the planner finish what it is at, then destroy the node."""
        self._worker.shutdown(cancel_futures=True)
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(Controller, args)


if __name__ == '__main__':
    sys.exit(main())
