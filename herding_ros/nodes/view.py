# SPDX-License-Identifier: Apache-2.0
"""The view node: a herd, its plans and its controls in the browser; or a recorded run.

It is a node as any other: it subscribes, asks for services, and publishes a destination when
somebody clicks on one. Sim and controller know nothing of it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math
import os
from pathlib import Path
from queue import Empty, SimpleQueue
import sys
import time
from typing import Any
import webbrowser

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from herding_ros.bag.reader import read_run
from herding_ros.control.parameters import Control
from herding_ros.model.crowd import Crowd
from herding_ros.model.field import Field, read_field
from herding_ros.model.flock import Arrival
from herding_ros.model.state import Array
from herding_ros.view.frame import Curve
from herding_ros.view.page import Page
from herding_ros.view.panel import LivePanel, Tunable, Wishes
from herding_ros.view.playback import PERIOD, Playback
import numpy as np
from rcl_interfaces.msg import ParameterEvent, ParameterType
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_parameter_events, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from . import command_line, messages
from .herd_seen import HerdSeen
from .herding_node import HerdingNode
from .parameter_query import ParameterQueries
from .parameters import declare
from .publishing import CountingPublisher, EVERY_MESSAGE, full_name
from .running import run
from .settings import SimSettings, ViewSettings

_LOOK_PERIOD = 0.5
"""Wall time between two looks at the graph, and between two drawings of the curves [s]."""

_PATIENCE = 3.0
"""Wall time in which a controller takes a destination, or a node a value [s]."""

_SILENCE = 2.0
"""Wall time without sheep after which the page says so [s]."""

_STATUS_LASTS = 5.0
"""Wall time after which a status is of the past: nodes send one a second [s]."""

_SOME = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Nobody waits for a page to have read a status."""

_NODES = ('sim', 'controller')

_SIM, _CONTROLLER, _PLAN = 'sim: herd', 'controller: state', 'controller: plan'
"""Statuses that are shown; those of all herds, and of drivers, come by the same topic."""

_NICE = 5
"""A picture gives way to decisions on a busy machine."""


class PageNode(HerdingNode):
    """A node with a page."""

    page: Page

    def __init__(self) -> None:
        """Declare the parameters."""
        super().__init__('view', parameter_overrides=[Parameter('use_sim_time', value=False)])
        self.settings = declare(self, ViewSettings())
        self.wall = Clock(clock_type=ClockType.STEADY_TIME)

    def announce(self) -> None:
        """Say where the page is, and open it if there is a screen."""
        self.get_logger().info(f'the page is at {self.page.url}')
        if self.settings.browser and {'DISPLAY', 'WAYLAND_DISPLAY'} & set(os.environ):
            webbrowser.open(self.page.url)

    def destroy_node(self) -> None:
        """Close the page, too."""
        self.page.close()
        super().destroy_node()


class Player(PageNode):
    """A recorded run."""

    def __init__(self, bag: Path) -> None:
        """Read it; ValueError if that is not possible."""
        super().__init__()
        self.get_logger().info(f'reading {bag}')
        try:
            recorded = read_run(bag)
        except OSError as error:
            raise ValueError(str(error)) from error
        title = bag.absolute().parent.name
        playback = Playback(recorded, self.settings.host, self.settings.port, title)
        self.page = playback.page
        self.create_timer(PERIOD, playback.advance, clock=self.wall)
        self.announce()


class View(PageNode):
    """A herd as it is now."""

    def __init__(self) -> None:
        """Subscribe, and serve the page."""
        super().__init__()
        settings = self.settings
        self._herd = HerdSeen(self, settings.frame, self._refused)
        self._solve = Curve('solve time [ms]')
        self._margin = Curve('deadline margin [s]')
        curves = (self._herd.distance, self._herd.spread, self._herd.home)
        title = f'herd {self.get_namespace()}'.rstrip(' /')
        self.page = Page(settings.host, settings.port, title, (*curves, self._solve, self._margin))
        self._asked: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._panel = LivePanel(
            self.page,
            Wishes(
                move_goal=self._later(self._move_goal),
                pause=self._later(self._pause),
                reset=self._later(self._reset),
                set_value=self._later(self._want),
            ),
        )
        nothing: tuple[str, dict[str, str], float] = ('', {}, -math.inf)
        self._statuses = {self._status_of(name): nothing for name in (_SIM, _CONTROLLER)}
        self._named = {full_name(self.get_namespace(), node): node for node in _NODES}
        self._queries = ParameterQueries(self, self._named.__contains__)
        self._values: dict[str, dict[str, Any]] = {}
        self._wanted: dict[str, float] = {}
        self._pending: dict[Future, tuple[Client, str, float]] = {}
        """Requests without a reply: to whom, for what, and since when [s]."""
        self._goal_wanted: tuple[Array, float] | None = None
        self._last_sheep = time.monotonic()
        self._frames = self._browsers = 0
        self._goals = self.create_publisher(PoseStamped, 'goal_pose', 1)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, '/diagnostics', EVERY_MESSAGE, publisher_class=CountingPublisher
        )
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, _SOME)
        self.create_subscription(
            ParameterEvent, '/parameter_events', self._on_event, qos_profile_parameter_events
        )
        self._pauses = self.create_client(SetBool, 'sim/pause')
        self._resets = self.create_client(Trigger, 'sim/reset')
        self._setters = {
            node: self.create_client(SetParameters, f'{node}/set_parameters') for node in _NODES
        }
        self.create_timer(PERIOD, self._draw, clock=self.wall)
        self.create_timer(_LOOK_PERIOD, self._look_around, clock=self.wall)
        self.announce()

    def _later(self, act: Callable[..., None]) -> Callable[..., None]:
        """Return what lets the node's own thread act."""
        return lambda *given: self._asked.put(partial(act, *given))

    # What comes in.

    def _draw(self) -> None:
        """Do what was asked for, and show what is new."""
        while True:
            try:
                self._asked.get_nowait()()
            except Empty:
                break
        self._set_wanted()
        ns, known = self._herd.ns, self._browsers
        is_new, self._browsers = self._herd.take(), self.page.browsers
        if self._herd.ns != ns:
            self._last_sheep = time.monotonic()
        frame = self._herd.frame if is_new or self._browsers > known else None
        if frame is not None and self._browsers:
            self.page.show(frame)
            self._frames += 1

    def _look_around(self) -> None:
        """Look who is there, and write what is shown in words and curves."""
        self._herd.look_around()
        self._ask_for_parameters()
        self._panel.show_time_control(self._pauses.service_is_ready())
        self._check_goal()
        self._check_replies()
        self._panel.write(self._in_words())
        self.page.draw_curves()
        self._publish_status()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if status.name in self._statuses:
                self._statuses[status.name] = status.message, values, time.monotonic()
            elif status.name == self._status_of(_PLAN):
                for curve, key in ((self._solve, 'solve_ms'), (self._margin, 'deadline_margin_s')):
                    curve.add(self._herd.time, _number_in(values.get(key, '')))

    def _status_of(self, name: str) -> str:
        return f'{self.get_namespace()}/{name}'.lstrip('/')

    def _newest_status(self, name: str) -> tuple[str, dict[str, str]]:
        """Return message and values; nothing of a node that is silent, since it has gone."""
        message, values, came = self._statuses[self._status_of(name)]
        return (message, values) if time.monotonic() < came + _STATUS_LASTS else ('', {})

    def _in_words(self) -> str:
        herd = self._herd
        silent = time.monotonic() - self._last_sheep
        doing, values = self._newest_status(_SIM)
        stands = doing in ('paused', 'finished')
        if not herd.ns and herd.frame is None:
            domain = os.environ.get('ROS_DOMAIN_ID', '0')
            return f'waiting for sheep on {herd.topics}, ROS_DOMAIN_ID {domain}'
        lines = [f'**t {herd.time:.1f} s**']
        for name, curve in (('to go', herd.distance), ('spread', herd.spread)):
            if curve.values:
                lines[0] += f' · {name} {curve.values[-1]:.3f} m'
        if silent > _SILENCE and not stands:
            lines.append(f'no sheep for {silent:.0f} s')
        if doing:
            lines.append(f'sim: {values.get("outcome") or doing}')
        controlling, counts = self._newest_status(_CONTROLLER)
        if controlling:
            missed = counts.get('deadlines_missed', '0')
            lines.append(f'controller: {controlling}; deadlines missed: {missed}')
            if silent_dogs := counts.get('dogs_silent'):
                lines.append(f'silent: {silent_dogs}')
        return '  \n'.join(lines)

    # Parameters of other nodes.

    def _ask_for_parameters(self) -> None:
        for name, values in self._queries.answers().items():
            self._values[self._named[name]] = values
            self._take_parameters()

    def _take_parameters(self) -> None:
        sim = self._values.get('sim', {})
        self._herd.arrival = _arrival_in(sim, self.get_logger())
        self._herd.field = _field_named(sim.get('field', ''), self.get_logger())
        offered: dict[str, Tunable] = {}
        for values in self._values.values():
            for name, tunable in _tunables(values).items():
                offered.setdefault(name, tunable)
                self._panel.show_value(name, tunable.value)
        if sim.get('lockstep'):  # as fast as possible
            offered.pop('real_time_factor', None)
        self._panel.offer(offered)

    def _on_event(self, event: ParameterEvent) -> None:
        """Show a value that somebody has changed."""
        values = self._values.get(self._named.get(event.node, ''), {})
        for changed in event.changed_parameters:
            name, value = changed.name, changed.value
            is_number = value.type == ParameterType.PARAMETER_DOUBLE
            if name in values and is_number and math.isfinite(value.double_value):
                values[name] = value.double_value
                if name not in self._wanted:
                    self._panel.show_value(name, values[name])

    # What is asked for.

    def _want(self, name: str, value: float) -> None:
        self._wanted[name] = value  # of a slider that is being moved the newest counts

    def _set_wanted(self) -> None:
        for name in self._wanted.keys() - {what for _, what, _ in self._pending.values()}:
            value = self._wanted.pop(name)
            for node, values in self._values.items():
                if name in values:
                    self._set(node, name, value)

    def _set(self, node: str, name: str, value: float) -> None:
        client = self._setters[node]
        if not client.service_is_ready():
            self._panel.refuse(f'{node} does not answer: {name} stays as it is')
            return
        parameter = Parameter(name, value=value).to_parameter_msg()

        def take(reply: SetParameters.Response) -> None:
            (result,) = reply.results or [None]
            if result is not None and result.successful:
                self._panel.accept()
                return
            reason = result.reason if result is not None else 'it gave no reason'
            self._panel.refuse(f'{node} refused {name} = {value:g}: {reason}')
            self._panel.show_value(name, self._values[node][name])

        self._call(client, SetParameters.Request(parameters=[parameter]), name, take)

    def _move_goal(self, goal: Array) -> None:
        self._goals.publish(messages.pose(goal, self._herd.ns, self.settings.frame))
        self._goal_wanted = goal, time.monotonic()

    def _call(self, client: Client, request: Any, what: str, take: Callable[[Any], None]) -> None:
        """Ask a node, and let `take` have its reply, for which we wait `_PATIENCE`."""
        future = client.call_async(request)
        self._pending[future] = client, what, time.monotonic()

        def end(_: Any) -> None:
            if self._pending.pop(future, None):
                take(future.result())

        future.add_done_callback(end)

    def _check_replies(self) -> None:
        """Say so when a node does not answer, and ask it again only when somebody wishes."""
        for future, (client, what, asked) in list(self._pending.items()):
            if time.monotonic() > asked + _PATIENCE:
                del self._pending[future]
                client.remove_pending_request(future)
                self._panel.refuse(f'no answer: {what} may be as it was')

    def _check_goal(self) -> None:
        """Say so when nobody has taken a destination."""
        if self._goal_wanted is None:
            return
        goal, asked = self._goal_wanted
        if self._herd.goal is not None and np.allclose(self._herd.goal, goal):
            self._goal_wanted = None
            self._panel.accept()
        elif time.monotonic() > asked + _PATIENCE:
            self._goal_wanted = None
            self._panel.refuse(
                f'no controller took the destination ({goal[0]:g}, {goal[1]:g}): one must run, '
                'and its log says why it refuses'
            )

    def _pause(self, stop: bool) -> None:
        self._ask(self._pauses, SetBool.Request(data=stop), 'pause')

    def _reset(self) -> None:
        self._ask(self._resets, Trigger.Request(), 'reset')

    def _ask(self, client: Client, request: Any, what: str) -> None:
        if not client.service_is_ready():
            self._panel.refuse(f'there is no sim to {what}')
            return

        def take(reply: Any) -> None:
            if reply.success:
                self._panel.accept()
            else:
                self._panel.refuse(f'sim: {reply.message}')

        self._call(client, request, 'the sim', take)

    def _publish_status(self) -> None:
        values = {
            'url': self.page.url,
            'browsers': self.page.browsers,
            'frames': self._frames,
            **self._refused.report_values(),
        }
        level = DiagnosticStatus.WARN if self._refused.counts else DiagnosticStatus.OK
        self._diagnostics.publish(
            messages.diagnostics(
                self.status_name('page'), self._herd.ns, level, f'at {self.page.url}', values
            )
        )


def _tunables(values: dict[str, Any]) -> dict[str, Tunable]:
    """Return those of a node's parameters that one number changes while it runs."""
    groups = (('crowd.', Crowd()), ('', Control()), ('', SimSettings()))
    entries = (entry for prefix, group in groups for entry in group.walk(prefix))
    return {
        entry.name: Tunable(
            value,
            entry.field.metadata['unit'],
            entry.field.metadata['doc'],
            min(entry.field.metadata['low'] or 0.0, 0.0),
            _highest(entry.name, value),
        )
        for entry in entries
        if entry.field.metadata['live'] and isinstance(value := values.get(entry.name), float)
    }


def _number_in(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _arrival_in(sim: dict[str, Any], logger: Any) -> Arrival:
    """Return when the sim's flock has arrived, as usual where that is not said."""
    usual = Arrival()
    known = {name: sim[name] for name in usual.flat('arrival.') if name in sim}
    try:
        return usual.with_values(known, 'arrival.')
    except ValueError as error:  # of another program that is called sim
        logger.warning(f'arrival.* are taken as usual: {error}')
        return usual


def _field_named(name: Any, logger: Any) -> Field:
    """Return the field of the sim, empty where there is none, or none that can be read here."""
    try:
        return read_field(name)[0] if name else Field()
    except (OSError, TypeError, ValueError) as error:
        logger.warning(f'the walls are not drawn: {error}')
        return Field()


def _highest(name: str, value: float) -> float:
    """Return how far a slider goes: a limit of speed, which a robot can keep, is not raised."""
    if name == 'max_speed':
        return value
    return max(4.0 * value, 10.0 if name == 'real_time_factor' else 0.0) or 1.0


def main(args: list[str] | None = None) -> int:
    """Run the node, or print help."""
    options = command_line.read('view', args)
    os.nice(_NICE)
    return run(partial(Player, options.bag) if options.bag else View, args)


if __name__ == '__main__':
    sys.exit(main())
