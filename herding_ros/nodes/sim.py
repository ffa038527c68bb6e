"""The sim node: moves the herd and publishes what sensors would see of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from herding_ros.model.crowd import Crowd
from herding_ros.model.flock import distance, spread
from herding_ros.model.parameters import quantity, TINY
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array
from herding_ros.model.warmup import warm_up_rollout

from . import messages
from .inbox import Inbox
from .parameters import declare, HerdingNode
from .refusals import Refused
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

LIVE = ('real_time_factor', *LIVE_NOISE)
"""Parameters that may change while the sim runs."""

CATCH_UP = 1.0
"""In real time a sim that was held up makes up for so much; what is more is skipped [s]."""

_PERIODS_PER_MARKER = 5

_NEWCOMER_PERIOD = 1.0
"""Time between two looks for controllers that have not heard the state [s]."""


@dataclass(frozen=True)
class SimSettings(NodeSettings):
    """How the sim behaves as a ROS node."""

    real_time_factor: float = quantity(
        1.0, 'simulated seconds per second when not in lockstep', low=1e-3, high=1e3
    )
    command_timeout: float = quantity(
        0.5, 'a dog stops when its last command is older than this', 's', low=TINY
    )
    stop_on_arrival: bool = quantity(False, 'stand still once the flock is home and together')
    time_limit: float = quantity(0.0, 'stand still after this time; 0: never', 's', low=0.0)


class Sim(HerdingNode):
    """A herd behind the topics of real sheep trackers and robots."""

    def __init__(self) -> None:
        """Declare parameters and wait until somebody listens."""
        super().__init__('sim')
        self._settings = declare(self, SimSettings(), live=LIVE)
        self._crowd = declare_crowd(self, live=LIVE)
        self._world = declare(self, World())
        self.load_kernels(warm_up_rollout)
        self._goal = np.array(self._settings.goal)
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._paused = False
        self._finished = False

        publish = partial(
            self.create_publisher,
            qos_profile=EVERY_MESSAGE,
            qos_overriding_options=ADJUSTABLE,
            publisher_class=CountingPublisher,
            event_callbacks=UNWATCHED,
        )
        dogs = range(1, self._world.dogs + 1)
        self._true_sheep = sole_publisher(
            self, 'truth/sheep', lambda: publish(PointCloud2, 'truth/sheep')
        )
        self._sheep = publish(PointCloud2, 'sheep')
        self._dogs = [publish(Odometry, f'dog_{m}/odom') for m in dogs]
        self._true_dogs = [publish(Odometry, f'truth/dog_{m}/odom') for m in dogs]
        self._tick = publish(ClockMessage, '/clock')
        self._markers = publish(MarkerArray, 'markers')
        self._diagnostics = publish(DiagnosticArray, '/diagnostics')
        kind = TwistStamped if self._settings.stamped else Twist
        self._commands = [
            Inbox(self, kind, f'dog_{m}/cmd_vel', 10, qos_overriding_options=ADJUSTABLE)
            for m in dogs
        ]
        self.create_subscription(PoseStamped, 'goal_pose', self._on_goal, 1, raw=True)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(SetBool, '~/pause', self._on_pause)
        self._ticking: Timer | None = None
        self._skipped = 0
        self._restart()
        self.follow([('crowd.', self._crowd), ('', self._settings)], self._take_parameters)
        self._waiting = self.create_timer(0.02, self._start_when_heard, clock=self._wall)

    def _restart(self) -> None:
        self._simulation = Simulation(self._crowd, self._world, self._goal)
        self._finished = False
        self._forget_commands()

    def _take_parameters(self, crowd: Crowd, settings: SimSettings) -> None:
        self._crowd = self._simulation.crowd = crowd
        self._settings = settings
        if self._ticking is not None:
            self._keep_pace()

    def _forget_commands(self) -> None:
        """Stand until commands come; in lockstep, until all that answer the state are there."""
        self._velocities: list[Array | None] = [None] * self._world.dogs
        self._received_ns = [0] * self._world.dogs

    def _start_when_heard(self) -> None:
        if (self._settings.lockstep or self._settings.wait_for) and not self._is_answered():
            return
        everything = [
            *(self._sheep, *self._dogs, self._true_sheep, *self._true_dogs),
            *(self._tick, self._markers, self._diagnostics),
        ]
        if self._settings.wait_for and not is_heard(self, everything, self._settings.wait_for):
            return
        self.destroy_timer(self._waiting)
        self.get_logger().info(
            f'herding {self._world.sheep} sheep with {self._world.dogs} dogs, '
            + ('in lockstep' if self._settings.lockstep
               else f'{self._settings.real_time_factor:g} x real time')
        )  # fmt: skip
        self._publish_state()
        self.create_timer(0.5, self._publish_diagnostics, clock=self._wall)
        if self._settings.lockstep:
            self._known, self._last_look = self._commanders(), 0
            self.create_timer(_NEWCOMER_PERIOD, self._show_newcomers, clock=self._wall)
            self.create_timer(0.0, self._keep_in_step, clock=self._wall)
        else:
            self._keep_pace()

    def _is_answered(self) -> bool:
        """Whether each dog's commands come from a node that hears sheep and dogs."""
        sensors = [self._sheep, *self._dogs]
        return all(
            commands.get_publisher_count() > 0
            and any(
                is_heard(self, sensors, commander.node_name)
                for commander in self.get_publishers_info_by_topic(commands.topic_name)
            )
            for commands in (inbox.subscription for inbox in self._commands)
        )

    def _commanders(self) -> set[bytes]:
        return {
            bytes(info.endpoint_gid)
            for inbox in self._commands
            for info in self.get_publishers_info_by_topic(inbox.subscription.topic_name)
        }

    def _show_newcomers(self) -> None:
        """Repeat the state for a controller in place of a dead one, until somebody answers."""
        commanders, periods = self._commanders(), self._simulation.periods
        if periods != self._last_look:
            self._known, self._last_look = commanders, periods
        elif commanders - self._known:
            self._publish_state()

    def _take_commands(self) -> None:
        for m, inbox in enumerate(self._commands, start=1):
            for data, _ in inbox.take():
                try:
                    self._velocities[m - 1] = self._velocity_in(data, m)
                    self._received_ns[m - 1] = self._simulation.nanoseconds
                except ValueError as error:
                    self._refused.add(f'dog_{m}/cmd_vel', error)

    def _velocity_in(self, data: bytes, m: int) -> Array:
        most, now = self._world.max_speed, self._simulation.nanoseconds
        if not self._settings.stamped:
            return messages.twist_in(data, most)
        ns, velocity = messages.command_in(data, m, self._settings.frame, most)
        if self._settings.lockstep:
            if ns != now:
                raise Refused('wrong stamp', 'its stamp is not that of the published state')
        elif ns:  # whoever has no clock stamps 0
            timeout = self._settings.command_timeout
            messages.check_stamp(ns, now, timeout, timeout)
        return velocity

    def _keep_in_step(self) -> None:
        """Move on as commands come, the last dog's last; the executor sees to all else between."""
        for _ in self._commands[-1].arrivals(LOCKSTEP_TURN):
            self._advance_in_lockstep()

    def _advance_in_lockstep(self) -> None:
        """Move on once every dog has the command that answers the published state."""
        if not self._settings.lockstep:
            return
        self._take_commands()
        given = [u for u in self._velocities if u is not None]
        if len(given) == self._world.dogs and not self._paused and not self._finished:
            self._forget_commands()
            self._advance(np.array(given))

    def _keep_pace(self) -> None:
        """Advance in real time from now on, at the present factor."""
        if self._ticking is not None:
            self.destroy_timer(self._ticking)
        self._period = self._world.control_period / self._settings.real_time_factor
        # Half-way between two ticks, so that each finds one period due.
        self._due = time.monotonic() + 0.5 * self._period
        self._ticking = self.create_timer(
            self._period, self._advance_in_real_time, clock=self._wall
        )

    def _advance_in_real_time(self) -> None:
        """Make the periods that are due: one, or more when the last tick came late."""
        now = time.monotonic()
        self._skip_before(now - CATCH_UP)
        while self._due <= now and time.monotonic() < now + LOCKSTEP_TURN:
            self._due += self._period
            self._take_commands()
            if not self._paused and not self._finished:
                self._advance_with_newest()

    def _skip_before(self, limit: float) -> None:
        """Give up the periods that were due before a time of the wall clock."""
        periods = int((limit - self._due) / self._period)
        if periods <= 0:
            return
        self._due += periods * self._period
        self._skipped += periods
        self.get_logger().warning(
            f'{periods} control periods came too late and are skipped; '
            f'lower real_time_factor ({self._settings.real_time_factor:g})',
            throttle_duration_sec=10.0,
        )

    def _advance_with_newest(self) -> None:
        """Move on with the newest commands; a dog whose last is too old stands."""
        oldest = self._simulation.nanoseconds - round(self._settings.command_timeout * 1e9)
        self._advance(
            np.array(
                [
                    np.zeros(2) if u is None or received <= oldest else u
                    for u, received in zip(self._velocities, self._received_ns, strict=True)
                ]
            )
        )

    def _advance(self, u: Array) -> None:
        self._simulation.advance(u)
        seconds = self._simulation.nanoseconds * 1e-9
        limit = self._settings.time_limit
        if self._settings.stop_on_arrival and self._simulation.arrived:
            self._finish(f'the flock arrived after {seconds:.1f} s')
        elif limit and seconds > limit - 0.5 * self._world.control_period:
            self._finish(f'the flock did not arrive within {limit:g} s')
        self._publish_state()
        if self._finished:
            self._publish_diagnostics()

    def _finish(self, why: str) -> None:
        self._finished = True
        self.get_logger().info(why)

    def _publish_state(self) -> None:
        simulation, frame = self._simulation, self._settings.frame
        ns, true, u = simulation.nanoseconds, simulation.state, simulation.dog_velocities
        seen = simulation.observe()
        self._tick.publish(ClockMessage(clock=messages.stamp_of(ns)))
        for m, publisher in enumerate(self._dogs):
            publisher.publish(
                messages.odometry(seen.state.d[m], seen.dog_velocities[m], m + 1, ns, frame)
            )
        self._sheep.publish(messages.cloud(seen.state.x, seen.state.v, ns, frame))
        self._true_sheep.publish(messages.cloud(true.x, true.v, ns, frame))
        for m, publisher in enumerate(self._true_dogs):
            publisher.publish(messages.odometry(true.d[m], u[m], m + 1, ns, frame))
        if simulation.periods % _PERIODS_PER_MARKER == 0:
            self._markers.publish(messages.markers(true.x, true.d, self._goal, ns, frame))

    def _publish_diagnostics(self) -> None:
        simulation = self._simulation
        x = simulation.state.x
        waiting = [m + 1 for m, u in enumerate(self._velocities) if u is None]
        if self._finished:
            summary = 'finished'
        elif self._paused:
            summary = 'paused'
        else:
            summary = f'waiting for dogs {waiting}' if self._settings.lockstep else 'running'
        values: dict[str, object] = {
            'time_s': simulation.nanoseconds * 1e-9,
            'distance_m': float(distance(x, self._goal)),
            'spread_m': float(spread(x)),
            'arrived': simulation.arrived,
            'finished': self._finished,
            'periods_skipped': self._skipped,
            **self._refused.report_values(),
        }
        level = (
            DiagnosticStatus.WARN if self._refused.counts or self._skipped else DiagnosticStatus.OK
        )
        self._diagnostics.publish(
            messages.diagnostics('sim: herd', simulation.nanoseconds, level, summary, values)
        )

    def _on_goal(self, data: bytes) -> None:
        try:
            self._goal = messages.goal_in(data, self._settings.frame)
        except ValueError as error:
            self._refused.add('goal_pose', error)
            return
        self._simulation.goal = self._goal
        self._finished = False
        self._advance_in_lockstep()

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._restart()
        self._publish_state()
        response.success = True
        response.message = 'the herd is where it was at the start, and time is 0'
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused = request.data
        response.success = True
        response.message = 'paused' if self._paused else 'running'
        self._advance_in_lockstep()
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(Sim, args)


if __name__ == '__main__':
    sys.exit(main())
