# SPDX-License-Identifier: Apache-2.0
"""The sim node: moves the herd and publishes what sensors would observe."""

from __future__ import annotations

from functools import partial
from pathlib import Path
import sys

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from herding_ros.model.crowd import Crowd
from herding_ros.model.field import field_of
from herding_ros.model.flock import distance, spread
from herding_ros.model.simulation import World
from herding_ros.model.state import Array
from herding_ros.model.warmup import warm_up_rollout
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from . import command_line, messages
from .dog_commands import DogCommands
from .duplicates import ANOTHER_CLOCK, sole_publisher
from .herding_node import HerdingNode
from .mismatches import Mismatches
from .pacing import Lockstep, Pace, RealTime
from .parameters import declare, declare_crowd, declare_scaled, in_field
from .publishing import (
    ADJUSTABLE,
    CLOCK,
    CountingPublisher,
    EVERY_MESSAGE,
    is_heard,
    UNWATCHED,
)
from .running import run
from .settings import SimSettings
from .simulated_run import SimulatedRun
from .start import read_start

_PERIODS_PER_MARKER = 5

_DIAGNOSTICS_PERIOD = 0.5
"""Wall time between two messages on /diagnostics [s]."""

_TIME_TO_BE_ASKED = 2.0
"""Wall time after a run in which a recorder may still ask for parameters [s]."""


class Sim(HerdingNode):
    """A herd behind the topics of real sheep trackers and robots."""

    def __init__(self) -> None:
        """Declare parameters, load the kernels, then wait for subscribers."""
        # It makes the time, and has no use for it; one file may tell all nodes to use it.
        super().__init__('sim', parameter_overrides=[Parameter('use_sim_time', value=False)])
        self._settings = settings = declare(self, SimSettings())
        crowd, goal = in_field(declare_crowd(self), settings)
        world = declare_scaled(self, World(), crowd)
        self.load_kernels(partial(warm_up_rollout, crowd, world.motion))
        start = None
        if settings.start_from:
            start = read_start(Path(settings.start_from).expanduser(), settings.start_at)
        self._run = SimulatedRun(
            crowd, world, goal, settings.stop_on_arrival, settings.time_limit, start
        )  # fmt: skip
        self._pace: Pace | None = None
        self._ending: Timer | None = None
        self._create_publishers(world.dogs)
        self._commands = DogCommands(
            self, settings, world.dogs, world.max_speed, world.motion, settings.command_timeout,
            self._refused,
        )  # fmt: skip
        self._mismatches = Mismatches(self)
        if not settings.lockstep:
            self._mismatches.follow(self._commands.inboxes)
        self.create_subscription(PoseStamped, 'goal_pose', self._on_goal, 1, raw=True)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.follow([('crowd.', crowd), ('', settings)], self._take_parameters)
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._waiting = self.create_timer(0.02, self._start_when_heard, clock=self._wall)

    def _create_publishers(self, dogs: int) -> None:
        publish = partial(
            self.create_publisher,
            qos_profile=EVERY_MESSAGE,
            qos_overriding_options=ADJUSTABLE,
            publisher_class=CountingPublisher,
            event_callbacks=UNWATCHED,
        )
        numbers = range(1, dogs + 1)
        self._true_sheep = sole_publisher(
            self, 'truth/sheep', lambda: publish(PointCloud2, 'truth/sheep')
        )
        self._tick = sole_publisher(
            self, CLOCK, lambda: publish(ClockMessage, CLOCK), ANOTHER_CLOCK
        )
        self._sheep = publish(PointCloud2, 'sheep')
        self._dogs = [publish(Odometry, f'dog_{m}/odom') for m in numbers]
        self._true_dogs = [publish(Odometry, f'truth/dog_{m}/odom') for m in numbers]
        # All at once, for viewers that draw clouds.
        self._dog_cloud = publish(PointCloud2, 'dogs')
        self._true_dog_cloud = publish(PointCloud2, 'truth/dogs')
        self._markers = publish(MarkerArray, 'markers')
        self._diagnostics = publish(DiagnosticArray, '/diagnostics')

    def _start_when_heard(self) -> None:
        """Publish the first state once its subscribers are matched."""
        settings, sensors = self._settings, [self._sheep, *self._dogs]
        everything = [*sensors, self._true_sheep, *self._true_dogs]
        everything += [self._dog_cloud, self._true_dog_cloud]
        everything += [self._tick, self._markers, self._diagnostics]
        needs_commands = settings.lockstep or settings.wait_for
        if needs_commands and not self._commands.come_from_listeners(sensors):
            return
        if settings.wait_for and not is_heard(self, everything, settings.wait_for):
            return
        self.destroy_timer(self._waiting)
        world, factor = self._run.world, settings.real_time_factor
        pace = 'in lockstep' if settings.lockstep else f'{factor:g} x real time'
        self.get_logger().info(f'herding {world.sheep} sheep with {world.dogs} dogs, {pace}')
        self._publish_state()
        self.create_timer(_DIAGNOSTICS_PERIOD, self._publish_diagnostics, clock=self._wall)
        parts = (self, self._run, self._commands, self._advance)
        if settings.lockstep:
            self._pace = Lockstep(*parts, self._publish_state)
        else:
            self._pace = RealTime(*parts, factor)

    # What comes in.

    def _take_parameters(self, crowd: Crowd, settings: SimSettings) -> None:
        self._settings = settings
        self._run.change_crowd(crowd)
        if isinstance(self._pace, RealTime):
            self._pace.set_factor(settings.real_time_factor)
        self._notice_change()

    def _on_goal(self, data: bytes) -> None:
        try:
            goal = messages.goal_in(data, self._settings.frame)
        except ValueError as error:
            self._refused.add_request('goal_pose', error)
            return
        self._run.move_goal(goal)
        self._notice_change()

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._run.paused = request.data
        response.success = True
        response.message = 'paused' if request.data else 'running'
        self._notice_change()
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._run.restart()
        self._commands.forget()
        self._publish_state()
        response.success = True
        response.message = 'the herd is where it was at the start, and time is 0'
        return response

    def _notice_change(self) -> None:
        if self._pace is not None:
            self._pace.notice_change()

    # What goes out.

    def _advance(self, u: Array) -> None:
        """Move on under commands u (M, 2) [m/s] in the body frames of the dogs."""
        headings = self._run.simulation.headings
        self._run.advance(
            np.array([messages.turned(*each) for each in zip(u, -headings, strict=True)])
        )
        if self._run.finished:
            log = self.get_logger()
            if self._run.failed:
                log.error(f'{self._run.outcome}; change crowd.* or call ~/reset')
            else:
                log.info(self._run.outcome)
        if not self._run.failed:
            self._publish_state()
        if self._run.finished:
            self._publish_diagnostics()
            if self._settings.end_when_finished:
                if self._ending is not None:  # of a finish before, after which it went on
                    self.destroy_timer(self._ending)
                self._ending = self.create_timer(_TIME_TO_BE_ASKED, self._end, clock=self._wall)

    def _end(self) -> None:
        assert self._ending is not None
        self._ending.cancel()
        if self._run.finished:  # still: a moved goal continues the run
            self.ended.set_result(None)

    def _publish_state(self) -> None:
        simulation, frame = self._run.simulation, self._settings.frame
        ns, true, u = simulation.nanoseconds, simulation.state, simulation.dog_velocities
        seen = simulation.observe()
        self._tick.publish(ClockMessage(clock=messages.stamp_of(ns)))
        self._publish_dogs(self._dogs, self._dog_cloud, seen.state.d, seen.dog_velocities)
        self._sheep.publish(messages.cloud(seen.state.x, seen.state.v, ns, frame))
        self._true_sheep.publish(messages.cloud(true.x, true.v, ns, frame))
        self._publish_dogs(self._true_dogs, self._true_dog_cloud, true.d, u)
        if simulation.periods % _PERIODS_PER_MARKER == 0:
            goal = self._run.goal
            self._markers.publish(
                messages.marker_array(
                    true.x,
                    true.dogs,
                    goal,
                    self._run.world.arrival.radius,
                    ns,
                    frame,
                    field_of(simulation.crowd).outline,
                )
            )

    def _publish_dogs(
        self, publishers: list[Publisher], cloud: Publisher, d: Array, u: Array
    ) -> None:
        """Publish odometry of dogs in states d (M, S) with velocities u (M, 2) [m/s]."""
        simulation, frame = self._run.simulation, self._settings.frame
        ns = simulation.nanoseconds
        places, headings, velocities = simulation.world.motion.odometry(d, u)
        dogs = zip(publishers, places, headings, velocities, strict=True)
        for m, (publisher, place, heading, velocity) in enumerate(dogs, start=1):
            publisher.publish(messages.odometry(place, velocity, m, ns, frame, heading))
        cloud.publish(messages.cloud(places, velocities, ns, frame, first=1))

    def _publish_diagnostics(self) -> None:
        simulation, goal = self._run.simulation, self._run.goal
        skipped = 0 if self._pace is None else self._pace.skipped
        mismatched = self._mismatches.report_values()
        values: dict[str, object] = {
            'time_s': simulation.nanoseconds * 1e-9,
            'distance_m': float(distance(simulation.flock, goal)),
            'spread_m': float(spread(simulation.flock)),
            'arrived': simulation.arrived,
            'finished': self._run.finished,
            'outcome': self._run.outcome,
            'periods_skipped': skipped,
            'closest_dogs_m': simulation.closest_dogs,
            'touches': simulation.touches,
            'stops_at_walls': simulation.stops,
            **self._refused.report_values(),
            **mismatched,
        }
        bumps = simulation.touches + simulation.stops
        good = not (self._refused.counts or mismatched or skipped or bumps)
        level = DiagnosticStatus.OK if good else DiagnosticStatus.WARN
        level = DiagnosticStatus.ERROR if self._run.failed else level
        self._diagnostics.publish(
            messages.diagnostics(
                self.status_name('herd'), simulation.nanoseconds, level, self._doing, values
            )
        )

    @property
    def _doing(self) -> str:
        if self._run.finished:
            return 'finished'
        if self._run.paused:
            return 'paused'
        return (
            f'waiting for dogs {self._commands.missing}' if self._settings.lockstep else 'running'
        )


def main(args: list[str] | None = None) -> int:
    """Run the node, or print help."""
    command_line.read('sim', args)
    return run(Sim, args)


if __name__ == '__main__':
    sys.exit(main())
