# SPDX-License-Identifier: Apache-2.0
"""The newest messages of a herd and its plans, as what a page shows.

Nobody waits for it: what comes often is taken as best effort, and only the newest.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import math
import re
import time
from typing import Any

from geometry_msgs.msg import PoseStamped
from herding_ros.bag.recorded_run import in_play, Route
from herding_ros.checks import Refused
from herding_ros.markers import NOTHING, Surroundings, surroundings_in
from herding_ros.model.field import Field
from herding_ros.model.flock import Arrival, distance, share_within, spread, without_strays
from herding_ros.model.state import Array
from herding_ros.view.frame import Curve, Frame, Trails
from nav_msgs.msg import Odometry, Path
import numpy as np
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from . import messages
from .inbox import Inbox
from .publishing import full_name
from .refusals import Refusals

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Only the newest counts; a publisher sends it once, and does not wait."""

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""What was published before is there at once."""

_MOST_SHEEP = 1_000_000

_PLANS = 20
"""Plans that are kept; more are never announced ahead."""

_PATIENCE = 5.0
"""Wall time in which a dog may be silent [s]."""


class HerdSeen:
    """Sheep and dogs, the true ones where somebody publishes them, else the observed."""

    def __init__(self, node: Node, frame: str, refused: Refusals) -> None:
        """Subscribe to what is always there; `look_around` does to the herd."""
        self.distance = Curve('distance [m]')
        self.spread = Curve('spread [m]')
        self.home = Curve('share of sheep at the destination')
        self.arrival = Arrival()
        self.field = Field()
        self.ns = 0
        """Stamp of the newest sheep [ns]."""
        self.goal: Array | None = None
        """The destination in force (2,) [m]; None where nobody says."""
        self._node = node
        self._frame = frame
        self._refused = refused
        self._sheep: Inbox | None = None
        self._dogs: dict[int, Inbox] = {}
        self._plan = Inbox(node, MultiDOFJointTrajectory, 'plan', _LATCHED)
        self._path = Inbox(node, Path, 'herd/path', NEWEST)
        self._goal = Inbox(node, PoseStamped, 'herd/goal', _LATCHED)
        self._drawing = Inbox(node, MarkerArray, 'herd/markers', NEWEST)
        self._surroundings = NOTHING
        self._forget()

    def _forget(self) -> None:
        self._x: Array | None = None
        self._places: dict[int, tuple[Array, float]] = {}
        self._heard: dict[int, float] = {}  # when a dog last was [s]
        self._sheep_came = -math.inf
        self._first_spread = math.nan
        self._plans: deque[Route] = deque(maxlen=_PLANS)
        self._expected: deque[Route] = deque(maxlen=_PLANS)
        self._trails = Trails()

    @property
    def topics(self) -> str:
        """Where sheep are looked for, in words."""
        names = (full_name(self._node.get_namespace(), name) for name in ('truth/sheep', 'sheep'))
        return ' or '.join(names)

    def look_around(self) -> None:
        """Subscribe to sheep and dogs that have appeared in the graph."""
        there = {name for name, _ in self._node.get_topic_names_and_types()}
        root = full_name(self._node.get_namespace(), '')
        # A topic is there also for those who listen, as we do.
        source = 'truth/' if self._node.count_publishers(f'{root}truth/sheep') else ''
        sheep = f'{root}{source}sheep'
        if self._sheep is None or self._sheep.subscription.topic_name != sheep:
            for inbox in (self._sheep, *self._dogs.values()):
                if inbox is not None:
                    self._node.destroy_subscription(inbox.subscription)
            self._dogs = {}
            self._forget()
            self._sheep = Inbox(self._node, PointCloud2, sheep, NEWEST)
        pattern = re.compile(f'{re.escape(root + source)}dog_([1-9][0-9]{{0,5}})/odom')
        for name in there:
            match = pattern.fullmatch(name)
            if match and int(match[1]) not in self._dogs:
                self._dogs[int(match[1])] = Inbox(self._node, Odometry, name, NEWEST)

    def take(self) -> bool:
        """Take what has come in; return whether there is anything new to be seen."""
        sheep = self._newest(self._sheep, self._sheep_in)
        for m, inbox in self._dogs.items():
            if dog := self._newest(inbox, self._dog_in):
                _, place, heading, velocity = dog
                if velocity.any() and np.isfinite(velocity).all():
                    # It looks where it goes, since many dogs have no front: heading 0.
                    heading = math.atan2(velocity[1], velocity[0])
                elif m in self._places:
                    heading = self._places[m][1]
                self._places[m] = place, heading
                self._heard[m] = time.monotonic()
        if sheep is not None:
            self._add_sheep(sheep)
        goal = self._newest(self._goal, lambda data: messages.goal_in(data, self._frame))
        plan = self._newest(self._plan, self._plan_in)
        path = self._newest(self._path, self._path_in)
        if drawn := self._newest(self._drawing, self._drawing_in):
            self._surroundings = drawn
        if goal is not None:
            self.goal = goal
        if plan is not None:
            self._plans.append(plan)
        if path is not None:
            self._expected.append(path)
        return not sheep is goal is plan is path is None

    def _newest(self, inbox: Inbox | None, read: Callable[[bytes], Any]) -> Any:
        """Return the newest message that can be read, None without any."""
        found = None
        if inbox is None:
            return found
        for data, _ in inbox.take():
            try:
                found = read(data)
            except ValueError as error:
                self._refused.add(inbox.subscription.topic_name, error)
        return found

    def _sheep_in(self, data: bytes) -> messages.Sheep:
        return messages.sheep_in(data, self._frame, _MOST_SHEEP, needs_velocities=False)

    def _dog_in(self, data: bytes) -> tuple[int, Array, float, Array]:
        return messages.dog_in(data, self._frame)

    def _plan_in(self, data: bytes) -> Route:
        return messages.plan_in(data, self._frame)

    def _path_in(self, data: bytes) -> Route:
        return messages.path_in(data, self._frame)

    def _drawing_in(self, data: bytes) -> Surroundings:
        try:
            message = deserialize_message(data, MarkerArray)
        except rclpy_implementation.RMWError as error:
            raise Refused('malformed', str(error)) from error
        return surroundings_in(message, self._frame)

    def _add_sheep(self, sheep: messages.Sheep) -> None:
        if sheep.ns < self.ns:  # a reset, or another herd
            self._forget()
        self.ns, self._x = sheep.ns, sheep.x
        self._forget_dogs()
        flock = without_strays(sheep.x, self.arrival.strays)
        if math.isnan(self._first_spread):
            self._first_spread = float(spread(flock))
        self._trails.add(self.time, sheep.x, self._d)
        self.spread.add(self.time, float(spread(flock)))
        if self.goal is not None:
            self.distance.add(self.time, float(distance(flock, self.goal)))
            radius = self.arrival.radius + self.arrival.spread * self._first_spread
            self.home.add(self.time, float(share_within(sheep.x, self.goal, radius)))

    def _forget_dogs(self) -> None:
        """Forget those that are silent while sheep come, as of a former run with more of them."""
        now = time.monotonic()
        if now > self._sheep_came + _PATIENCE:  # all stood still
            self._heard = dict.fromkeys(self._heard, now)
        self._sheep_came = now
        for m in [m for m, heard in self._heard.items() if heard < now - _PATIENCE]:
            del self._heard[m], self._places[m]

    @property
    def time(self) -> float:
        """Time of the newest sheep [s]."""
        return self.ns * 1e-9

    @property
    def _d(self) -> Array:
        return np.array([place for place, _ in self._places.values()]).reshape(-1, 2)

    @property
    def frame(self) -> Frame | None:
        """What there is to be seen; None before there were sheep."""
        if self._x is None:
            return None
        self._places = dict(sorted(self._places.items()))
        plan = in_play(self._plans, self.time)
        expected = in_play(self._expected, self.time)
        trails = self._trails
        return Frame(
            time=self.time,
            x=self._x,
            d=self._d,
            headings=np.array([heading for _, heading in self._places.values()]),
            numbers=tuple(self._places),
            goal=self.goal,
            plans=np.zeros((0, 0, 2)) if plan is None else plan.ahead(self.time),
            expected=np.zeros((0, 2)) if expected is None else expected.ahead(self.time),
            dog_trails=trails.dogs,
            centre_trail=trails.centre,
            field=self.field,
            surroundings=self._surroundings,
        )
