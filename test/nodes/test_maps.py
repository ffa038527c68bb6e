# SPDX-License-Identifier: Apache-2.0
"""Maps and obstacles that come while the controller runs."""

from __future__ import annotations

import array
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point32, PolygonStamped, TwistStamped
from herding_ros.control.background import Run
from herding_ros.control.parameters import Control, Horizon, Mapping
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.field import Field, NO_FIELD
from herding_ros.model.state import HerdState
from herding_ros.nodes import maps, messages
from herding_ros.nodes.maps import MAP, Maps, OBSTACLE
from herding_ros.nodes.occupancy import MOST_PIECES, walls_of
from herding_ros.nodes.refusals import Refusals
from nav_msgs.msg import OccupancyGrid, Odometry
import numpy as np
from numpy.typing import ArrayLike
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SQUARE = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
TRIANGLE = ((3.0, 3.0), (4.0, 3.0), (3.0, 4.0))


def a_map(cells: ArrayLike, frame: str = 'map', resolution: float = 0.1) -> OccupancyGrid:
    """With its origin at (0.3, -0.5)."""
    cells = np.asarray(cells, np.int8)
    message = OccupancyGrid()
    message.header.frame_id = frame
    message.info.resolution = resolution
    message.info.height, message.info.width = cells.shape
    message.info.origin.position.x, message.info.origin.position.y = 0.3, -0.5
    message.info.origin.orientation.w = 1.0
    message.data = array.array('b', cells.tobytes())
    return message


def an_obstacle(*corners: tuple[float, float], frame: str = 'map') -> PolygonStamped:
    message = PolygonStamped()
    message.header.frame_id = frame
    message.polygon.points = [Point32(x=x, y=y) for x, y in corners]
    return message


class Log:
    """Takes what a node logs."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.info = self.warning = self.lines.append


class Live:
    """`Maps` without a node."""

    def __init__(
        self,
        field: Field = NO_FIELD,
        run: Run | None = None,
        frames: messages.Frames | None = None,
    ) -> None:
        self.log = Log()
        self.fields: list[Field] = []
        self.prepared: list[Field] = []
        self.timers: list[Callable[[], None]] = []
        self._callbacks: dict[str, Callable[[bytes], None]] = {}
        done: list[Callable[[], None]] = []
        self._done = done
        node: Any = SimpleNamespace(
            create_subscription=self._subscribe,
            get_logger=lambda: self.log,
            create_timer=lambda period, call, clock: self.timers.append(call) or call,
            destroy_timer=lambda timer: self.timers.remove(timer),
            executor=SimpleNamespace(
                create_task=lambda function, *given: done.append(lambda: function(*given))
            ),
        )
        log: Any = self.log
        self.refused = Refusals(log)
        self.maps = Maps(
            node, 'map', frames, field, self.fields.append, self.prepared.append, self.refused, run
        )

    def _subscribe(self, kind: Any, topic: str, callback: Any, *_: Any, **__: Any) -> None:
        self._callbacks[topic] = callback

    def show(self, topic: str, message: Any) -> None:
        self._callbacks[topic](serialize_message(message))

    def look_again(self) -> None:
        for timer in list(self.timers):
            timer()

    def spin(self) -> None:
        while self._done:
            self._done.pop(0)()


def test_a_map_takes_the_place_of_the_last_one_and_obstacles_add_up() -> None:
    start = Field(fences=(((9.0, 9.0), (9.0, 8.0)),), goal=((5.0, 5.0),))
    live = Live(start)
    live.show(MAP, a_map([[100, 0], [0, 0]]))
    live.show(OBSTACLE, an_obstacle(*SQUARE))
    live.show(OBSTACLE, an_obstacle(*TRIANGLE))
    assert [len(field.obstacles) for field in live.fields] == [1, 2, 3]
    assert live.fields[-1].obstacles[1:] == (SQUARE, TRIANGLE)
    assert live.prepared == live.fields
    live.show(MAP, a_map([[0, 0], [0, 100]]))
    assert len(live.fields[-1].obstacles) == 3
    assert live.fields[-1].obstacles[0] != live.fields[0].obstacles[0]
    live.show(OBSTACLE, an_obstacle())
    live.show(MAP, a_map([[0, -1], [0, 0]]))
    assert live.fields[-1] == start
    assert all(field.goal == start.goal and field.fences for field in live.fields)


def test_what_changes_nothing_is_not_taken() -> None:
    live = Live()
    for _ in range(3):
        live.show(MAP, a_map([[100, 0], [0, 0]]))
        live.show(OBSTACLE, an_obstacle(*SQUARE))
    assert len(live.fields) == 2
    assert len(live.log.lines) == 2


def test_the_same_map_again_takes_no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many mappers publish theirs every second."""
    worked: list[Any] = []
    monkeypatch.setattr(maps, 'walls_of', lambda grid: worked.append(grid) or walls_of(grid))
    live = Live()
    for cells in ([[100, 0], [0, 0]], [[100, 0], [0, 0]], [[0, 0], [0, 100]]):
        live.show(MAP, a_map(cells))
    assert len(worked) == len(live.fields) == 2


def test_what_is_refused_leaves_the_walls_as_they_were() -> None:
    goal = ((0.4, 0.2), (0.8, 0.2), (0.8, 0.8))
    live = Live(Field(goal=goal))
    live.show(MAP, a_map([[100, 0], [0, 0]]))
    assert live.maps.has_map
    specks = np.zeros((1600, 1600))
    specks[::200, ::200] = 100
    wrong = [
        (MAP, a_map([[100]], frame='odom'), 'wrong frame'),
        (MAP, a_map(specks), 'too many walls'),
        (MAP, a_map(np.full((20, 20), 100)), 'not allowed'),  # the goal is in it
        (OBSTACLE, an_obstacle(*SQUARE), 'not allowed'),  # the same
        (OBSTACLE, an_obstacle(*SQUARE[:2]), 'not allowed'),
        (OBSTACLE, an_obstacle(SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]), 'not allowed'),
        (OBSTACLE, an_obstacle(*SQUARE, frame='odom'), 'wrong frame'),
    ]
    for count, (topic, message, kind) in enumerate(wrong, start=1):
        live.show(topic, message)
        assert sum(live.refused.counts.values()) == count
        assert f'{topic}: {kind}' in live.refused.counts
    assert len(live.fields) == 1
    live.show(OBSTACLE, an_obstacle(*TRIANGLE))
    assert live.fields[-1].obstacles == (*live.fields[0].obstacles, TRIANGLE)


def test_there_are_no_more_obstacles_than_can_be_planned_with() -> None:
    live = Live()
    for k in range(100):
        live.show(OBSTACLE, an_obstacle(*[(x + 2.0 * k, y) for x, y in SQUARE]))
    assert len(live.fields) == MOST_PIECES // 4
    assert 'removes all obstacles' in ' '.join(live.log.lines)
    live.show(OBSTACLE, an_obstacle())
    assert live.fields[-1] == NO_FIELD


def test_while_one_is_worked_on_the_newest_map_waits() -> None:
    """So what comes often cannot pile up, and the node goes on."""
    work: list[Callable[[], None]] = []
    live = Live(run=work.append)
    for cells in ([[100, 0, 0]], [[0, 100, 0]], [[0, 0, 100]]):
        live.show(MAP, a_map(cells))
    live.show(OBSTACLE, an_obstacle(*TRIANGLE))
    assert not live.maps.has_map
    for _ in range(3):
        work.pop(0)()
        live.spin()
    assert not work
    assert live.maps.has_map
    first, last, both = live.fields
    assert first.obstacles[0][0][0] < last.obstacles[0][0][0] - 0.15
    assert both.obstacles == (*last.obstacles, TRIANGLE)


def test_a_failure_is_said_and_later_ones_are_taken_in() -> None:
    live = Live()

    def fail(field: Field) -> None:
        raise RuntimeError('no compiler')

    live.maps._prepare = fail
    live.show(OBSTACLE, an_obstacle(*SQUARE))
    assert "could not be taken in: RuntimeError('no compiler')" in live.log.lines[0]
    live.maps._prepare = live.prepared.append
    live.show(OBSTACLE, an_obstacle(*TRIANGLE))
    assert [field.obstacles for field in live.fields] == [(TRIANGLE,)]


def test_a_map_that_is_made_coarser_is_said() -> None:
    live = Live()
    live.show(MAP, a_map(100 * (np.random.default_rng(0).random((60, 60)) < 0.5)))
    assert live.fields
    assert 'narrow gates may be closed' in live.log.lines[0]


WALL = np.zeros((10, 3))
WALL[2:8, 1] = 100
"""Across the way to the goal, 0.6 m long."""

QUICK = {'horizon__length': 4.0, 'horizon__accepted': 2.0, 'mapping__paths': 20}
CONTROL = Control(horizon=Horizon(length=4.0, accepted=2.0), mapping=Mapping(paths=20))


@pytest.fixture
def herd() -> HerdState:
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.2, 0.2, (6, 2)).astype(np.float32)
    return HerdState(x, np.zeros((6, 2)), np.array([[-0.6, -0.5], [-0.4, -0.7]]))


class Pasture:
    """A herd that stands still."""

    def __init__(self, peer: Any, herd: HerdState) -> None:
        self.herd = herd
        self.sheep = peer.talk_to(PointCloud2, 'sheep')
        self.odometry = [peer.talk_to(Odometry, f'dog_{m}/odom') for m in (1, 2)]

    def show(self, ns: int) -> None:
        for m, publisher in enumerate(self.odometry):
            publisher.publish(messages.odometry(self.herd.d[m], np.zeros(2), m + 1, ns, 'map'))
        self.sheep.publish(messages.cloud(self.herd.x, self.herd.v, ns, 'map'))


def velocity(command: TwistStamped) -> list[float]:
    return [command.twist.linear.x, command.twist.linear.y]


def test_the_controller_plans_around_the_walls_of_a_map(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    """With needs_map not before there is one; a refused one changes nothing."""
    process = start(
        'controller', lockstep=True, dogs=2, seed=7, goal='[1.0, 0.0]', needs_map=True,
        bodies__ramp=0.0, **QUICK,
    )  # fmt: skip
    heard = [peer.listen(TwistStamped, f'dog_{m}/cmd_vel') for m in (1, 2)]
    maps = peer.talk_to(OccupancyGrid, MAP, qos=LATCHED)
    process.wait_for('waiting for a map on /map')
    maps.publish(a_map(WALL))
    process.wait_for('walls from map: ')
    pasture = Pasture(peer, herd)
    field = walls_of(messages.grid_in(serialize_message(a_map(WALL)), 'map')).added_to(NO_FIELD)
    planner = RecedingHorizon(field.around(Crowd()), CONTROL, np.array([1.0, 0.0]), seed=7)
    free = RecedingHorizon(Crowd(), CONTROL, np.array([1.0, 0.0]), seed=7)

    def reply(ns: int) -> np.ndarray:
        before = len(heard[0])
        pasture.show(ns)
        peer.spin_until(lambda: min(map(len, heard)) > before)
        return np.array([velocity(each[-1]) for each in heard])

    expected = planner.solve(herd, 0.0).plan
    assert np.array_equal(reply(0), expected.at(0.0))
    assert np.array_equal(reply(100_000_000), expected.at(0.1))
    assert np.abs(expected.u - free.solve(herd, 0.0).plan.u).max() > 0.01
    maps.publish(a_map(WALL, frame='odom'))
    process.wait_for("map must be in frame 'map', got 'odom'")
    planner.learn(herd, 2.0)
    assert np.array_equal(reply(2_000_000_000), planner.solve(herd, 2.0).plan.at(2.0))
    maps.publish(a_map(np.zeros((2, 2))))
    process.wait_for('walls from map: 0 pieces')
    planner.adjust(NO_FIELD.around(Crowd()), CONTROL)
    planner.learn(herd, 4.0)
    assert np.array_equal(reply(4_000_000_000), planner.solve(herd, 4.0).plan.at(4.0))


def test_by_its_own_clock_the_controller_goes_on_while_it_takes_in_an_obstacle(
    start: Callable[..., Any], peer: Any, herd: HerdState
) -> None:
    process = start('controller', dogs=2, lead=0.5, dog_timeout=0.0, **QUICK)
    heard = peer.listen(TwistStamped, 'dog_1/cmd_vel')
    states = peer.listen(DiagnosticArray, '/diagnostics')
    pasture = Pasture(peer, herd)
    obstacles = peer.talk_to(PolygonStamped, OBSTACLE, qos=LATCHED)
    peer.node.create_timer(
        0.05, lambda: pasture.show(int(peer.node.get_clock().now().nanoseconds))
    )
    peer.spin_until(lambda: heard)
    obstacles.publish(an_obstacle((0.4, -0.4), (0.6, -0.4), (0.6, 0.4), (0.4, 0.4)))

    def walls() -> set[str]:
        pairs = [pair for each in states for status in each.status for pair in status.values]
        return {pair.value for pair in pairs if pair.key == 'walls'}

    peer.spin_until(lambda: '4' in walls(), limit=20.0)
    assert 'walls from field/obstacle: 4 pieces in all' in process.log
    before = len(heard)
    peer.spin_until(lambda: len(heard) > before + 15)
    assert 'could not be made' not in process.log
