# SPDX-License-Identifier: Apache-2.0
"""Walls that come by messages while the controller runs: maps and obstacles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from geometry_msgs.msg import PolygonStamped
from herding_ros.checks import Refused
from herding_ros.control.background import Run
from herding_ros.model.field import Field, Point
from nav_msgs.msg import OccupancyGrid
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.timer import Timer
import shapely

from . import messages
from .occupancy import Grid, MOST_PIECES, NO_WALLS, Walls, walls_of
from .refusals import Refusals

MAP, OBSTACLE = 'map', 'field/obstacle'

_DEPTHS = {MAP: 1, OBSTACLE: 100}
"""Of all messages that are kept for us the newest map counts, and each obstacle."""

_MOST_WAITING = 100
"""Obstacles that wait to be taken in."""

_MOST_SAID = 100
"""Frames without a transform that are logged: a stranger may make up any number."""

_RETRY_PERIOD = 1.0
"""Wall time after which it is looked again for a transform [s]."""


@dataclass(frozen=True)
class _Seen:
    """What messages have said so far; a change of it is made by a function."""

    map: Walls = NO_WALLS
    obstacles: tuple[tuple[Point, ...], ...] = ()

    def in_field(self, field: Field) -> Field:
        """Return the field with all this in it."""
        return Walls(obstacles=self.obstacles).added_to(self.map.added_to(field))


_Change = Callable[[_Seen], _Seen]


class Maps:
    """The newest map and all obstacles, added to the field that a node was started with.

    A map takes the place of the one before; an obstacle is added to the others, and one without
    corners removes all. What is refused leaves the walls as they were.
    """

    def __init__(
        self,
        node: Node,
        frame: str,
        frames: messages.Frames | None,
        field: Field,
        take: Callable[[Field], None],
        prepare: Callable[[Field], None],
        refused: Refusals,
        run: Run | None,
    ) -> None:
        """Subscribe.

        take(field) is called in the node's thread for each new field, prepare(field) before. That
        and the work on a map are done by `run`; None: at once.
        """
        self.has_map = False
        self._node = node
        self._frame, self._frames = frame, frames
        self._field = field
        self._take = take
        self._prepare = prepare
        self._refused = refused
        self._run = run
        self._seen = _Seen()
        self._last_map: tuple[Grid, Walls] | None = None
        self._waiting: list[tuple[str, _Change]] = []
        self._without_transform: list[tuple[str, bytes]] = []
        self._said: set[str] = set()
        self._again: Timer | None = None
        self._busy = False
        for kind, topic in ((OccupancyGrid, MAP), (PolygonStamped, OBSTACLE)):
            # A map is published once, as a rule long before the controller starts.
            qos = QoSProfile(depth=_DEPTHS[topic], durability=DurabilityPolicy.TRANSIENT_LOCAL)
            node.create_subscription(kind, topic, partial(self._receive, topic), qos, raw=True)

    def _receive(self, topic: str, data: bytes) -> None:
        """Take in a message; one whose transform is not there yet is tried again."""
        try:
            change = self._change(topic, data)
        except messages.NoTransformError as error:
            self._try_later(topic, data, error)
        except ValueError as error:
            self._refused.add_request(topic, error)
        else:
            if topic == MAP:  # of those before none counts any more
                self._waiting = [each for each in self._waiting if each[0] != MAP]
                late = self._without_transform
                self._without_transform = [each for each in late if each[0] != MAP]
            self._waiting.append((topic, change))
            self._go_on()

    def _change(self, topic: str, data: bytes) -> _Change:
        """Return what a message asks for."""
        if topic == MAP:
            grid = messages.grid_in(data, self._frame, self._frames)
            return lambda seen: replace(seen, map=self._walls_of(grid))
        corners = messages.outline_in(data, self._frame, self._frames)
        if len(self._waiting) >= _MOST_WAITING:
            raise Refused('too many walls', 'obstacles come faster than they are taken in')
        return partial(_with_obstacle, corners=corners)

    def _walls_of(self, grid: Grid) -> Walls:
        """Return the walls in a map; many mappers publish the same one again and again."""
        if self._last_map is None or not self._last_map[0].equals(grid):
            self._last_map = grid, walls_of(grid)
        return self._last_map[1]

    def _try_later(self, topic: str, data: bytes, error: messages.NoTransformError) -> None:
        late = [each for each in self._without_transform if not each[0] == topic == MAP]
        if len(late) >= _MOST_WAITING:
            self._refused.add_request(topic, error)
            return
        self._without_transform = [*late, (topic, data)]
        if error.cause not in self._said and len(self._said) < _MOST_SAID:
            self._said.add(error.cause)
            self._node.get_logger().warning(f'{topic} waits for its transform: {error}')
        if self._again is None:
            wall = Clock(clock_type=ClockType.STEADY_TIME)
            self._again = self._node.create_timer(_RETRY_PERIOD, self._try_again, clock=wall)

    def _try_again(self) -> None:
        late, self._without_transform = self._without_transform, []
        for each in late:
            self._receive(*each)
        if not self._without_transform and self._again is not None:
            self._node.destroy_timer(self._again)
            self._again = None

    def _go_on(self) -> None:
        """Begin the next change, one at a time."""
        if self._busy or not self._waiting:
            return
        self._busy = True
        topic, change = self._waiting.pop(0)
        if self._run is None:
            self._finish(topic, *self._made(change))
            return

        def work() -> None:
            made = self._made(change)
            if self._node.executor is not None:
                self._node.executor.create_task(self._finish, topic, *made)

        self._run(work)

    def _made(self, change: _Change) -> tuple[_Seen, Field | None, ValueError | None]:
        """Return what is seen after a change, and the field unless that is the same or refused."""
        try:
            seen = change(self._seen)
            if seen == self._seen:
                return seen, None, None
            field = seen.in_field(self._field)
            self._prepare(field)
        except ValueError as error:
            return self._seen, None, error
        except Exception as error:  # of a library: it must not end the work on all later ones
            return self._seen, None, ValueError(f'it could not be taken in: {error!r}')
        return seen, field, None

    def _finish(
        self, topic: str, seen: _Seen, field: Field | None, error: ValueError | None
    ) -> None:
        self._busy, self._seen = False, seen
        self.has_map = self.has_map or (topic == MAP and error is None)
        if error is not None:
            self._refused.add_request(topic, error)
        elif field is not None:
            self._tell(topic, seen, field)
            self._take(field)
        self._go_on()

    def _tell(self, topic: str, seen: _Seen, field: Field) -> None:
        log = self._node.get_logger()
        if topic == MAP and seen.map.coarsened > 1:
            log.warning(
                f'the map is taken in blocks of {seen.map.coarsened} x {seen.map.coarsened} '
                f'cells, to have at most {MOST_PIECES} straight pieces of wall: narrow gates may '
                'be closed; publish one without specks and small things'
            )
        log.info(f'walls from {topic}: {len(field.bars)} pieces in all')


def _with_obstacle(seen: _Seen, corners: tuple[Point, ...]) -> _Seen:
    """Return what is seen with another obstacle, or without any if it has no corners."""
    if not corners:
        return replace(seen, obstacles=())
    if corners in seen.obstacles:
        return seen
    if len(corners) < 3 or not shapely.is_valid(shapely.Polygon(corners)):
        raise Refused(
            'not allowed',
            'an obstacle must have at least 3 corners and an outline that does not cross itself, '
            f'got {len(corners)} corners; one without corners removes all obstacles',
        )
    pieces = sum(map(len, (*seen.obstacles, corners)))
    if pieces > MOST_PIECES:
        raise Refused(
            'too many walls',
            f'obstacles must have at most {MOST_PIECES} corners in all, got {pieces}; one without '
            'corners removes all obstacles',
        )
    return replace(seen, obstacles=(*seen.obstacles, corners))
