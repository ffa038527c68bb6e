# SPDX-License-Identifier: Apache-2.0
"""The controller node: from observations of sheep and dogs to commands for the dogs.

The node converts messages, asks the pilot (control/pilot.py) what to do, and publishes its
decision. In lockstep that happens at each complete observation; otherwise at every control period
of the node's clock, while the pilot plans ahead in the background.
"""

from __future__ import annotations

from functools import partial
import sys

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from herding_ros.control.background import run_in_thread
from herding_ros.control.excitation import ExcitingPilot
from herding_ros.control.lockstep_pilot import LockstepPilot
from herding_ros.control.parameters import Control, OutOfStepError
from herding_ros.control.pilot import Announcement, Decision, dog_name
from herding_ros.control.real_time_pilot import RealTimePilot
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.solution import Status
from herding_ros.model.crowd import Crowd
from herding_ros.model.field import Field, field_of
from herding_ros.model.motion import steered_ahead
from herding_ros.model.state import Array
from herding_ros.model.warmup import warm_up
from nav_msgs.msg import Path
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from . import command_line, messages
from .drawing import Draughtsman
from .duplicates import sole_publisher
from .herding_node import HerdingNode
from .inbox import LOCKSTEP_TURN
from .maps import MAP, Maps
from .mismatches import Mismatches, twist_type
from .observations import Observations
from .parameters import declare, declare_control, declare_crowd, in_field
from .publishing import (
    ADJUSTABLE,
    CountingPublisher,
    EVERY_MESSAGE,
    full_node_name,
    is_heard,
    node_of,
    UNWATCHED,
)
from .running import CannotGoOnError, run
from .settings import ControllerSettings

_POSES = 40
"""A path of a window has about so many poses."""

_STATE_PERIOD = 1.0
"""Wall time between two messages on /diagnostics about the node itself [s]."""

_LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Room for what a slow subscriber has not received yet; a late one gets all that is in it."""

_NEWEST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Those who come late get one message: a goal before the last one is not in force."""


class Controller(HerdingNode):
    """Space-mapping receding-horizon control behind the topics of real trackers and robots."""

    def __init__(self) -> None:
        """Declare parameters, load the kernels, then subscribe."""
        super().__init__('controller')
        self._settings = settings = declare(self, ControllerSettings())
        crowd, goal = in_field(declare_crowd(self), settings)
        control = declare_control(self, crowd)
        self._crowd, self._control = crowd, control
        self._control_period = control.horizon.control_period
        self._decided = 0  # time of the last decision [ns]
        planner = RecedingHorizon(crowd, control, goal, settings.seed)
        self._pilot: LockstepPilot | RealTimePilot
        if settings.lockstep:
            kind = ExcitingPilot if settings.excite else LockstepPilot
            self._pilot = kind(planner, settings.dogs)
        else:
            self._pilot = RealTimePilot(planner, settings.dogs, settings, self._seconds)
        self.load_kernels(partial(warm_up, crowd, control.motion))
        self._draughtsman = Draughtsman()
        self._mismatches = Mismatches(self)
        self._create_publishers()
        self._field = field_of(crowd)
        self.follow([('crowd.', crowd), ('', control)], self._adjust)
        self._frames = messages.Frames.of(self, settings.frame)
        self._maps = Maps(
            self, settings.frame, self._frames, self._field, self._take_field, self._prepare,
            self._refused, None if settings.lockstep else run_in_thread,
        )  # fmt: skip
        if settings.needs_map:
            self.get_logger().info(f'waiting for a map on {self.resolve_topic_name(MAP)}')
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._waiting = self.create_timer(0.02, self._subscribe_when_heard, clock=self._wall)

    def _create_publishers(self) -> None:
        create = partial(
            self.create_publisher, publisher_class=CountingPublisher, event_callbacks=UNWATCHED
        )
        publish = partial(create, qos_profile=EVERY_MESSAGE)
        self._plan = sole_publisher(
            self, 'plan', lambda: create(MultiDOFJointTrajectory, 'plan', _LATCHED)
        )
        self._goal = create(PoseStamped, 'herd/goal', _NEWEST)
        names = [dog_name(m) for m in range(self._settings.dogs)]
        self._commands = [
            publish(
                self._type_of_commands(f'{name}/cmd_vel'),
                f'{name}/cmd_vel',
                qos_overriding_options=ADJUSTABLE,
            )
            for name in names
        ]
        self._herd_path = publish(Path, 'herd/path')
        self._dog_paths = [publish(Path, f'{name}/path') for name in names]
        self._markers = publish(MarkerArray, 'herd/markers')
        self._diagnostics = publish(DiagnosticArray, '/diagnostics')

    def _type_of_commands(self, name: str) -> type[Twist] | type[TwistStamped]:
        topic = self.resolve_topic_name(name)
        others = self.get_subscriptions_info_by_topic(topic)
        return twist_type(self, topic, self._settings, others)

    def stop(self) -> None:
        """End a solve that is under way early, since the node ends."""
        self._pilot.stop()

    def _subscribe_when_heard(self) -> None:
        """Subscribe to observations only once the subscribers of the replies are matched."""
        settings = self._settings
        if settings.needs_map and not self._maps.has_map:
            return
        recorder = full_node_name(self, settings.wait_for)
        if settings.lockstep and not all(
            any(
                is_heard(self, [commands], node_of(listener))
                for listener in self.get_subscriptions_info_by_topic(commands.topic_name)
                if node_of(listener) != recorder
            )
            for commands in self._commands
        ):
            return
        everything = [*self._commands, self._plan, self._herd_path, *self._dog_paths]
        everything += [self._goal, self._markers, self._diagnostics]
        if settings.wait_for and not is_heard(self, everything, settings.wait_for):
            return
        self.destroy_timer(self._waiting)
        self._observations = Observations(
            self, settings.dogs, settings.frame, settings.most_sheep, settings.state_timeout,
            self._control, self._refused, self._frames,
        )  # fmt: skip
        if not settings.lockstep:
            self._mismatches.follow(self._observations.inboxes)
        self.create_subscription(PoseStamped, 'goal_pose', self._on_goal, 1, raw=True)
        self._publish_goal(np.array(settings.goal))
        self.create_timer(_STATE_PERIOD, self._publish_state, clock=self._wall)
        if settings.lockstep:
            self.create_timer(0.0, self._keep_in_step, clock=self._wall)
        else:
            self.create_timer(self._control_period, self._keep_time)
        self.get_logger().info(f'ready to herd with {settings.dogs} dogs')

    # What comes in.

    def _keep_in_step(self) -> None:
        """Reply when sheep arrive, which come last; the executor does all else in between."""
        assert isinstance(self._pilot, LockstepPilot)
        for _ in self._observations.arrivals(LOCKSTEP_TURN):
            observed = self._observations.complete()
            if observed is not None:
                try:
                    decision = self._pilot.decide(observed)
                except OutOfStepError as error:
                    raise CannotGoOnError(str(error)) from error
                self._carry_out(decision, observed.stamp)

    def _keep_time(self) -> None:
        """Give the command for the present control period."""
        assert isinstance(self._pilot, RealTimePilot)
        now = self._now()
        self._carry_out(self._pilot.decide(now * 1e-9, self._observations.recent(now)), now)

    def _on_goal(self, data: bytes) -> None:
        try:
            goal = messages.goal_in(data, self._settings.frame, self._frames)
        except ValueError as error:
            self._refused.add_request('goal_pose', error)
            return
        if self._pilot.move_goal(goal):
            self._publish_goal(goal)
            self.get_logger().info(f'the destination is now ({goal[0]:g}, {goal[1]:g})')

    def _adjust(self, crowd: Crowd, control: Control) -> None:
        """Plan with these values, in the field that there is now."""
        self._control = control
        walls = self._field is not field_of(crowd)
        self._pilot.adjust(self._field.around(crowd) if walls else crowd, control)

    def _prepare(self, field: Field) -> None:
        """Load the kernels for walls, if these are the first."""
        if len(field.bars) and not len(self._field.bars):
            crowd = field.around(self._crowd)
            self.load_kernels(partial(warm_up, crowd, self._control.motion))

    def _take_field(self, field: Field) -> None:
        self._field = field
        self.take_again()

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _seconds(self) -> float:
        return self._now() * 1e-9

    # What goes out.

    def _carry_out(self, decision: Decision, ns: int) -> None:
        """Publish a decision, the command first."""
        self._decided = ns
        if decision.command is not None:
            self._publish_command(decision.command, ns)
        if decision.announcement is not None:
            self._publish_plan(decision.announcement)
            self._publish_report(decision.announcement, ns)
        drawn = self._draughtsman.follow(
            decision, self._pilot.estimate, self._field, self._control
        )
        if drawn is not None:
            self._markers.publish(messages.drawing(drawn, ns, self._settings.frame))
        for event in decision.events:
            _LOG[event.level](self.get_logger(), event.text)

    def _publish_command(self, u: Array, ns: int) -> None:
        headings, ahead = self._observations.headings.copy(), steered_ahead(self._control.motion)
        estimate = self._pilot.estimate
        if ahead is not None and estimate is not None:  # as it will be when this takes effect
            headings[list(estimate.dogs)] = estimate.state.d[:, 2]
        for m, publisher in enumerate(self._commands):
            if publisher.msg_type is TwistStamped:
                publisher.publish(messages.command(u[m], headings[m], m + 1, ns, ahead))
            else:
                publisher.publish(messages.twist(u[m], headings[m], ahead))

    def _publish_plan(self, announcement: Announcement) -> None:
        """Publish a plan and the paths that it is expected to lead to."""
        frame, window = self._settings.frame, announcement.plan.window
        members = announcement.plan.request.dogs
        start = round(window.plan.t0 * 1e9)
        per_command = round(window.plan.dt / window.dt)
        dogs, names = window.dogs[:-1:per_command], tuple(dog_name(m) for m in members)
        self._plan.publish(messages.trajectory(window.plan, dogs, names, start, frame))
        every = max(len(window.centre) // _POSES, 1)
        spacing = every * window.dt
        self._herd_path.publish(messages.path(window.centre[::every], spacing, start, frame))
        for m, route in zip(members, window.dogs[::every].swapaxes(0, 1), strict=True):
            self._dog_paths[m].publish(messages.path(route, spacing, start, frame))

    def _publish_goal(self, goal: Array) -> None:
        """Publish the goal in force, stamped with the time from which on the dogs follow it."""
        self._goal.publish(messages.pose(goal, self._decided, self._settings.frame))

    def _publish_report(self, announcement: Announcement, ns: int) -> None:
        """Say how a plan was found; it is a warning when it is late or moves no sheep."""
        plan, margin = announcement.plan, announcement.margin
        report = plan.window.report
        values = {
            'replan': announcement.number,
            'goal_x': plan.request.goal[0],
            'goal_y': plan.request.goal[1],
            **report.values(),
            'deadline_margin_s': margin,
            'deadlines_missed': self._pilot.deadlines_missed,
        }
        good = margin >= 0.0 and report.status is not Status.NO_INFLUENCE
        level = DiagnosticStatus.OK if good else DiagnosticStatus.WARN
        self._diagnostics.publish(
            messages.diagnostics(self.status_name('plan'), ns, level, report.status.value, values)
        )

    def _publish_state(self) -> None:
        """Say what the node is doing, and what has gone wrong so far."""
        now, pilot = self._now(), self._pilot
        condition = pilot.condition(now * 1e-9)
        mismatched = self._mismatches.report_values()
        values = {
            'dogs_silent': ' '.join(pilot.silent_dogs),
            'dogs_disobedient': ' '.join(pilot.disobedient_dogs),
            'plans_made': pilot.plans_made,
            'feedbacks_made': pilot.feedbacks_made,
            'deadlines_missed': pilot.deadlines_missed,
            'plans_failed': pilot.plans_failed,
            'commands_changed': pilot.commands_changed,
            'walls': len(self._field.bars),
            **pilot.estimate_values(),
            **self._refused.report_values(),
            **mismatched,
        }
        good = condition.good and not (pilot.plans_failed or self._refused.counts or mismatched)
        level = DiagnosticStatus.OK if good else DiagnosticStatus.WARN
        self._diagnostics.publish(
            messages.diagnostics(self.status_name('state'), now, level, condition.doing, values)
        )


# rclpy allows one severity for each line of code.
_LOG = {
    'info': lambda logger, text: logger.info(text),
    'warning': lambda logger, text: logger.warning(text),
    'error': lambda logger, text: logger.error(text),
}


def main(args: list[str] | None = None) -> int:
    """Run the node, or print help."""
    command_line.read('controller', args)
    return run(Controller, args)


if __name__ == '__main__':
    sys.exit(main())
