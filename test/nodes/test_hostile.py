# SPDX-License-Identifier: Apache-2.0
"""Thousands of wrong messages at each node: no dog moves, no node dies, nothing grows.

They come at 2 kHz, on every topic that the node listens to, and every single one is counted.
"""

from __future__ import annotations

import array
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import islice
import math
from pathlib import Path
import random
import struct
import time
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped, Vector3
from herding_ros.control.parameters import Control, Horizon, Mapping
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.state import HerdState
from herding_ros.nodes import messages
from herding_ros.nodes.refusals import Refused
from nav_msgs.msg import Odometry
import numpy as np
import psutil
import pytest
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

PERIOD = 0.0005
"""Time between two wrong messages [s]."""

BATCH = 1000
"""After as many it is waited until the node has counted all of them, so that none is lost."""

DEPTH = QoSProfile(depth=2 * BATCH)

MEMORY = 2e6
"""What a process may grow by while it refuses 5,000 messages [bytes].

400 for each, about what such a message takes. What the allocators keep for later differs by some
1 MB.
"""

MEMORY_OF_LARGE = 20e6
"""The same while it refuses 36 clouds of 2.8 MB, of which the middleware keeps a few [bytes]."""

LIMIT = 20.0
"""No condition is waited for any longer [s]."""

MOST_SHEEP = 10

KINDS = {'sheep': PointCloud2, 'odom': Odometry, 'cmd_vel': TwistStamped, 'goal_pose': PoseStamped}


class Wrong(NamedTuple):
    """A message that has to be refused as of this kind."""

    topic: str
    kind: str
    data: bytes


class Forger:
    """Makes wrong messages, no two alike, from good ones."""

    def __init__(self, seed: int = 0) -> None:
        self.random = random.Random(seed)

    def sheep(self, ns: int, n: int = 6, **changes: Any) -> bytes:
        """A good cloud, but for changed attributes, with a field of a name never seen before."""
        x = np.array([[self.random.uniform(-0.3, 0.3) for _ in range(2)] for _ in range(n)])
        data = messages.cloud(x, np.zeros((n, 2)), ns, 'map')
        message = deserialize_message(data, PointCloud2)
        message.fields[3].name = f'{self.random.random()}'
        for name, value in changes.items():
            setattr(message, name, value)
        return serialize_message(message)

    def odometry(self, ns: int, frame: str = 'map', **changes: float) -> bytes:
        message = Odometry(header=header(ns, frame), child_frame_id=f'{self.random.random()}')
        message.pose.pose.orientation.w = 1.0
        for name, value in changes.items():
            pose = message.pose.pose
            setattr(pose.position if name in 'xy' else pose.orientation, name, value)
        return serialize_message(message)

    def command(self, ns: int, frame: str = 'map', **changes: float) -> bytes:
        message = TwistStamped(header=header(ns, frame), twist=Twist(linear=Vector3(**changes)))
        return serialize_message(message)

    def goal(self, frame: str = 'map', **changes: float) -> bytes:
        message = PoseStamped(header=header(0, frame))
        for name, value in changes.items():
            setattr(message.pose.position, name, value)
        return serialize_message(message)

    def number(self) -> float:
        return self.random.choice([math.nan, math.inf, -math.inf])

    def frame(self) -> str:
        return self.random.choice(['odom', '', 'map ', f'{self.random.random()}', 'ü' * 100])

    def mutated(self, read: Callable[[bytes], Any], data: bytes) -> tuple[str, bytes]:
        """A message with bytes changed, cut off or put in, in a way that has to be refused.

        Always by four bytes: what is between is filled up by the middleware.
        """
        while True:
            mutated = bytearray(data)
            for _ in range(self.random.randint(1, 3)):
                at = self.random.randrange(len(mutated) - 3)
                change = self.random.choice([b'', b'\xff\xff\xff\xff', self.random.randbytes(4)])
                mutated[at : at + self.random.choice([0, 4])] = change
            cut = self.random.choice([len(mutated), self.random.randrange(4, len(mutated), 4)])
            try:
                read(bytes(mutated[:cut]))
            except Refused as refused:
                return refused.kind, bytes(mutated[:cut])

    def rubbish(self) -> bytes:
        """Of at least one byte: the middleware delivers nothing after a message of none."""
        beginning = self.random.choice([b'', b'\0\1\0\0', b'\0\0\0\0', b'\0\1\0\0' + bytes(8)])
        rubbish = beginning + b'\xff' * 8 + self.random.randbytes(self.random.randrange(900))
        return rubbish[: self.random.choice([1, 3, 4, 12, 1000, 1000, 1000])]

    def wrong_sheep(self, ns: int, stamps: bool) -> tuple[str, bytes]:
        """A wrong cloud of any kind; with `stamps`, ns is now."""
        good = self.sheep(ns)
        message = deserialize_message(good, PointCloud2)
        of_x = message.fields[1]
        renamed, integer = PointField(name='v'), PointField(name='x', datatype=6, count=1)
        points = message.data
        at = 4 * self.random.choice([1, 2, 4, 5]) + 28 * self.random.randrange(6)

        def with_number(number: float) -> bytes:
            struct.pack_into('<f', points, at, number)
            return self.sheep(ns, data=points)

        kinds: list[tuple[str, Callable[[], bytes]]] = [
            ('not finite', lambda: with_number(self.number())),
            ('too large', lambda: with_number(self.random.choice([1.1e6, -3e38]))),
            ('wrong frame', lambda: self.sheep(ns, header=header(ns, self.frame()))),
            ('wrong fields', lambda: self.sheep(ns, fields=[renamed, *message.fields[2:]])),
            ('wrong fields', lambda: self.sheep(ns, fields=[integer, *message.fields[2:]])),
            ('malformed', lambda: self.sheep(ns, fields=[of_x, *message.fields])),
            ('malformed', lambda: self.sheep(ns, row_step=message.row_step + 1)),
            ('malformed', lambda: self.sheep(ns, point_step=2**32 - 1)),
            ('malformed', lambda: self.sheep(ns, data=points[: self.random.randrange(168)])),
            ('malformed', self.rubbish),
            ('empty', lambda: self.sheep(ns, width=0, row_step=0, data=array.array('B'))),
            ('duplicate ids', lambda: self.sheep(ns, data=points[:28] * 6)),
            ('too many sheep', lambda: self.sheep(ns, width=2**32 - 1, height=2**32 - 1)),
            ('too many sheep', lambda: self.sheep(ns, n=MOST_SHEEP + 1)),
        ]
        if stamps:
            kinds.append(('stamp too old', lambda: self.sheep(ns - self.random.choice(AGES))))
            kinds.append(('stamp in the future', lambda: self.sheep(ns + AGES[0])))
        if self.random.random() < 0.3:
            return self.mutated(lambda data: messages.sheep_in(data, 'map', MOST_SHEEP), good)
        kind, make = self.random.choice(kinds)
        return kind, make()

    def wrong_odometry(self, ns: int, stamps: bool) -> tuple[str, bytes]:
        kinds: list[tuple[str, Callable[[], bytes]]] = [
            ('not finite', lambda: self.odometry(ns, x=self.number())),
            ('not finite', lambda: self.odometry(ns, z=self.number())),
            ('too large', lambda: self.odometry(ns, y=-1e300)),
            ('not a rotation', lambda: self.odometry(ns, w=0.0)),
            ('not a rotation', lambda: self.odometry(ns, z=2.0)),
            ('wrong frame', lambda: self.odometry(ns, self.frame())),
            ('malformed', self.rubbish),
        ]
        if stamps:
            kinds.append(('stamp too old', lambda: self.odometry(ns - self.random.choice(AGES))))
            kinds.append(('stamp in the future', lambda: self.odometry(ns + AGES[0])))
        if self.random.random() < 0.3:
            return self.mutated(lambda data: messages.dog_in(data, 'map'), self.odometry(ns))
        kind, make = self.random.choice(kinds)
        return kind, make()

    def wrong_command(self, ns: int) -> tuple[str, bytes]:
        kinds: list[tuple[str, Callable[[], bytes]]] = [
            ('not finite', lambda: self.command(ns, x=self.number())),
            ('not finite', lambda: self.command(ns, y=0.01, z=self.number())),
            ('too fast', lambda: self.command(ns, x=self.random.choice([0.06, 1e300]))),
            ('wrong frame', lambda: self.command(ns, self.frame(), x=0.01)),
            ('malformed', self.rubbish),
            ('stamp too old', lambda: self.command(1, x=0.01)),
            ('stamp in the future', lambda: self.command(ns + AGES[0], x=0.01)),
        ]
        if self.random.random() < 0.3:
            good = self.command(ns, x=0.01)
            return self.mutated(lambda data: messages.command_in(data, 1, 'map', 0.05), good)
        kind, make = self.random.choice(kinds)
        return kind, make()

    def wrong_goal(self) -> tuple[str, bytes]:
        kinds: list[tuple[str, Callable[[], bytes]]] = [
            ('not finite', lambda: self.goal(x=self.number())),
            ('too large', lambda: self.goal(y=1e300)),
            ('wrong frame', lambda: self.goal(self.frame())),
            ('malformed', self.rubbish),
        ]
        kind, make = self.random.choice(kinds)
        return kind, make()

    def wrong_clock(self) -> bytes:
        """A time that is none, or that nobody lives in."""
        jump = Time(sec=self.random.choice([2**31 - 1, 0, -1, -(2**31)]), nanosec=2**32 - 1)
        # The middleware sends none that is longer than a clock can be.
        return self.random.choice([serialize_message(Clock(clock=jump)), self.rubbish()[:12]])


AGES = [100 * 10**9, 10**12, 10**18]
"""By how much stamps are wrong [ns]."""


def header(ns: int, frame: str) -> Header:
    return Header(stamp=messages.stamp_of(ns), frame_id=frame)


class Storm:
    """Sends wrong messages to a node and looks whether it counts them."""

    def __init__(self, peer: Any, process: Any, status: str) -> None:
        self.peer = peer
        self.process = process
        self.status = status
        self.sent: Counter[str] = Counter()
        self.diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
        self.beat: Callable[[], None] = lambda: None
        """Called every 20 ms."""
        self.publishers: dict[str, Any] = {}
        self._next_beat = 0.0

    def talk(self, *topics: str) -> None:
        """Publish these topics, once they are heard."""
        for topic in topics:
            kind = KINDS[topic.split('/')[-1]]
            publisher = self.peer.node.create_publisher(kind, topic, DEPTH)
            self.publishers[topic] = publisher
        self.wait_until(
            lambda: all(p.get_subscription_count() for p in self.publishers.values()), 60.0
        )

    def blow(self, wrong: Iterator[Wrong]) -> None:
        """Send messages; of all but goals, of which only the newest counts, none may be lost."""
        while batch := list(islice(wrong, BATCH)):
            self.sent.update(f'{one.topic}: {one.kind}' for one in batch)
            begun = time.monotonic()
            for k, one in enumerate(batch, start=1):
                self.publishers[one.topic].publish(one.data)
                self._beat_when_due()
                time.sleep(max(0.0, begun + k * PERIOD - time.monotonic()))
            self.wait_until(self.all_counted)

    def said(self) -> dict[str, str]:
        """The values of the newest status of the node."""
        for message in reversed(self.diagnostics):
            for status in message.status:
                if status.name == self.status:
                    return {pair.key: pair.value for pair in status.values}
        return {}

    def counted(self) -> dict[str, int]:
        """What the node said last about the messages that it has refused."""
        return {k[8:]: int(v) for k, v in self.said().items() if k.startswith('refused ')}

    def all_counted(self) -> bool:
        return exact(self.counted()) == exact(self.sent)

    def wait_until(self, condition: Callable[[], object], limit: float = LIMIT) -> None:
        end = time.monotonic() + limit
        while not condition():
            assert self.process.process.poll() is None, self.process.log[-3000:]
            if time.monotonic() > end:
                missing = exact(self.sent) - exact(self.counted())
                more = exact(self.counted()) - exact(self.sent)
                pytest.fail(f'waited too long; not counted: {missing}, too often: {more}')
            self._beat_when_due()
            self.peer.spin_for(0.005)

    def _beat_when_due(self) -> None:
        now = time.monotonic()
        if now >= self._next_beat:
            self._next_beat = now + 0.02
            self.beat()

    def check_log(self) -> None:
        """Every kind was said, some by cause, and little was said about all those messages."""
        lines = [line for line in self.process.log.splitlines() if 'refused a message' in line]
        said = Counter(line.split('refused a message (')[1].split('): ')[0] for line in lines)
        assert set(said) == set(self.counted())
        by_cause = {key for key in said if key.endswith(('wrong frame', 'wrong fields'))}
        by_cause |= {key for key in said if key.startswith('goal_pose')}
        assert all(said[key] == 1 for key in set(said) - by_cause)
        assert len(self.process.log) < 20_000, self.process.log[-3000:]

    def memory(self) -> float:
        """Bytes of main memory that the process takes."""
        return float(psutil.Process(self.process.process.pid).memory_info().rss)


def exact(counts: dict[str, int]) -> Counter[str]:
    """The counts of what is not lost: of goals and times only the newest is kept."""
    return Counter({k: v for k, v in counts.items() if not k.startswith(('goal_pose', '/clock'))})


QUICK = {
    'horizon__length': 4.0, 'horizon__accepted': 2.0, 'mapping__paths': 20, 'lead': 0.5,
    'most_sheep': MOST_SHEEP,
}  # fmt: skip
DEEP = {
    f'qos_overrides./{topic}.subscription.depth': 2 * BATCH
    for topic in ('sheep', 'dog_1/odom', 'dog_2/odom', 'dog_1/cmd_vel')
}
GOALS = ('not finite', 'too large', 'wrong frame', 'malformed')


def wrong_observations(
    forger: Forger, count: int, now: Callable[[], int], stamps: bool = True
) -> Iterator[Wrong]:
    for _ in range(count):
        topic = forger.random.choice(['sheep', 'sheep', 'dog_1/odom', 'dog_2/odom', 'goal_pose'])
        if topic == 'sheep':
            yield Wrong(topic, *forger.wrong_sheep(now(), stamps))
        elif topic == 'goal_pose':
            yield Wrong(topic, *forger.wrong_goal())
        else:
            yield Wrong(topic, *forger.wrong_odometry(now(), stamps))


FAR_TOO_MANY = messages.cloud(np.zeros((100_000, 2)), np.zeros((100_000, 2)), 0, 'map')


def test_controller_in_real_time(start: Callable[..., Any], peer: Any) -> None:
    # Long enough for a test that is held up by others on the same machine.
    process = start(
        'controller', use_sim_time=True, dogs=2, state_timeout=3.0, **QUICK, **DEEP
    )  # fmt: skip
    storm = Storm(peer, process, 'controller: state')
    commands = [peer.listen(TwistStamped, f'dog_{m}/cmd_vel') for m in (1, 2)]
    clock = peer.node.create_publisher(Clock, '/clock', DEPTH)
    begun = time.monotonic()
    last_good = 0

    def now() -> int:
        return int((50.0 + time.monotonic() - begun) * 1e9)

    def tick() -> None:
        clock.publish(Clock(clock=messages.stamp_of(now())))

    def chaos() -> None:
        """Twice a second; more often than at each control period, and nothing is ever due."""
        if forger.random.random() < 0.04:
            clock.publish(forger.wrong_clock())
        else:
            tick()

    def show() -> None:
        """The herd as it is, with another number of sheep each time."""
        nonlocal last_good
        tick()
        last_good = now()
        for m, (x, y) in enumerate([(-0.6, -0.5), (-0.4, -0.7)], start=1):
            dogs[m].publish(forger.odometry(last_good, x=x, y=y))
        sheep.publish(forger.sheep(last_good, n=forger.random.randint(5, 8)))

    forger = Forger()
    storm.beat = tick
    storm.talk('sheep', 'dog_1/odom', 'dog_2/odom', 'goal_pose')
    dogs = {m: peer.talk_to(Odometry, f'dog_{m}/odom') for m in (1, 2)}
    sheep = peer.talk_to(PointCloud2, 'sheep')

    # Nothing but wrong messages, and a clock gone mad: no dog is told anything.
    storm.beat = chaos
    storm.blow(wrong_observations(forger, BATCH, now, stamps=False))
    storm.wait_until(lambda: '/clock: no time' in storm.counted())
    assert not commands[0]
    assert not commands[1]

    # Good ones among them: the controller does its work.
    storm.beat = show
    storm.blow(wrong_observations(forger, BATCH, now))
    # Until a plan is ready, dogs are told to stand: the clock may have gone back just now.
    storm.wait_until(lambda: all(any(map(speed, heard)) for heard in commands))
    for kind in GOALS:
        storm.wait_until(lambda kind=kind: f'goal_pose: {kind}' in storm.counted())  # type: ignore[misc]
    for heard in commands:
        speeds = [speed(message) for message in heard]
        assert max(speeds) <= 0.05 * (1 + 1e-9)
    memory = storm.memory()
    storm.blow(wrong_observations(forger, BATCH, now))

    # Wrong ones alone again: they do not count as news of the herd, and the dogs stop.
    storm.beat = tick
    storm.blow(wrong_observations(forger, 4 * BATCH, now))
    end = last_good + 3_300_000_000

    def later(heard: list[TwistStamped]) -> list[TwistStamped]:
        return [message for message in heard if messages.nanoseconds(message.header.stamp) > end]

    storm.wait_until(lambda: all(len(later(heard)) > 10 for heard in commands))
    for heard in commands:
        assert not any(speed(message) for message in later(heard))
    assert storm.memory() - memory < MEMORY
    storm.check_log()
    assert process.end() == 0


def speed(command: TwistStamped) -> float:
    return math.hypot(command.twist.linear.x, command.twist.linear.y)


def test_controller_in_lockstep_answers_as_if_nothing_had_been(
    start: Callable[..., Any], peer: Any
) -> None:
    # One plan, played to dogs that only stand.
    as_planned = {**QUICK, 'bodies__ramp': 0.0, 'dog_timeout': 0.0, 'horizon__feedback': 2.0}
    process = start('controller', lockstep=True, dogs=2, seed=7, **as_planned)
    storm = Storm(peer, process, 'controller: state')
    commands = [peer.listen(TwistStamped, f'dog_{m}/cmd_vel') for m in (1, 2)]
    storm.talk('sheep', 'dog_1/odom', 'dog_2/odom', 'goal_pose')
    dogs = {m: peer.talk_to(Odometry, f'dog_{m}/odom') for m in (1, 2)}
    sheep = peer.talk_to(PointCloud2, 'sheep')
    forger = Forger(1)
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.3, 0.3, (6, 2)).astype(np.float32)
    herd = HerdState(x, np.zeros((6, 2)), np.array([[-0.6, -0.5], [-0.4, -0.7]]))
    horizon = Horizon(length=4.0, accepted=2.0, feedback=2.0)
    control = Control(horizon=horizon, mapping=Mapping(paths=20))
    planner = RecedingHorizon(Crowd(), control, np.array([0.5, 0.5]), seed=7)
    planner.solve(herd, 0.0)
    assert planner.plan is not None
    memory = math.inf
    for k in range(20):
        ns = k * 100_000_000
        for i, one in enumerate(wrong_observations(forger, 60, lambda ns=ns: ns, stamps=False)):  # type: ignore[misc]
            storm.publishers[one.topic].publish(one.data)
            if i % 15 == 0:
                storm.publishers['sheep'].publish(FAR_TOO_MANY)
            time.sleep(PERIOD)
        for m in (1, 2):
            dogs[m].publish(messages.odometry(herd.d[m - 1], np.zeros(2), m, ns, 'map'))
        sheep.publish(messages.cloud(herd.x, herd.v, ns, 'map'))
        storm.wait_until(lambda k=k: min(len(heard) for heard in commands) > k)  # type: ignore[misc]
        for m, heard in enumerate(commands):
            assert messages.nanoseconds(heard[k].header.stamp) == ns
            linear = heard[k].twist.linear
            assert np.array_equal([linear.x, linear.y], planner.plan.at(k * 0.1)[m])
        if k == 10:  # the queue of the middleware has held large clouds at each of its places
            memory = storm.memory()
    assert storm.memory() - memory < MEMORY_OF_LARGE
    storm.wait_until(lambda: len(storm.counted()) > 10)
    assert process.end() == 0


def test_sim_in_real_time(start: Callable[..., Any], peer: Any) -> None:
    process = start('sim', sheep=3, dogs=1, real_time_factor=10.0, **DEEP)
    storm = Storm(peer, process, 'sim: herd')
    truth = peer.listen(Odometry, 'truth/dog_1/odom')
    storm.talk('dog_1/cmd_vel', 'goal_pose')
    commander = peer.talk_to(TwistStamped, 'dog_1/cmd_vel')
    forger = Forger(2)

    def now() -> int:
        return messages.nanoseconds(truth[-1].header.stamp)

    def wrong(count: int) -> Iterator[Wrong]:
        for k in range(count):
            if k % 4:
                yield Wrong('dog_1/cmd_vel', *forger.wrong_command(now()))
            else:
                yield Wrong('goal_pose', *forger.wrong_goal())

    storm.wait_until(lambda: truth and now() > 2_000_000_000)
    storm.blow(wrong(BATCH))
    assert {place(message) for message in truth} == {place(truth[0])}

    # Good ones among them are obeyed, and nothing else is.
    storm.beat = lambda: commander.publish(forger.command(0, y=0.03))
    storm.blow(wrong(BATCH))
    storm.wait_until(lambda: place(truth[-1]) != place(truth[0]))
    for kind in GOALS:
        storm.wait_until(lambda kind=kind: f'goal_pose: {kind}' in storm.counted())  # type: ignore[misc]
    memory = storm.memory()

    # When the good ones end, the dog stops, however many wrong ones come. The sim says when it has
    # read the last good one: what is heard of the dog may be older.
    storm.beat = lambda: None
    storm.blow(wrong(BATCH))
    last_good = int(float(storm.said()['time_s']) * 1e9)
    storm.blow(wrong(4 * BATCH))
    velocities = {
        (message.twist.twist.linear.x, message.twist.twist.linear.y) for message in truth
    }
    assert velocities == {(0.0, 0.0), (0.0, 0.03)}
    later = [m for m in truth if messages.nanoseconds(m.header.stamp) > last_good + 5_000_000_000]
    assert len(later) > 10
    assert len({place(message) for message in later}) == 1
    assert storm.memory() - memory < MEMORY
    storm.check_log()
    assert process.end() == 0


def place(dog: Odometry) -> tuple[float, float]:
    return dog.pose.pose.position.x, dog.pose.pose.position.y


def test_recorder_keeps_every_byte(start: Callable[..., Any], peer: Any, tmp_path: Path) -> None:
    process = start('recorder', bag=tmp_path / 'bag', use_sim_time=True)
    storm = Storm(peer, process, 'recorder: bag')
    topics = ('sheep', 'dog_1/odom', 'dog_1/cmd_vel', 'goal_pose')
    storm.talk(*topics)
    clock = peer.node.create_publisher(Clock, '/clock', DEPTH)
    storm.wait_until(lambda: clock.get_subscription_count() >= 2)  # one is rclpy's
    forger = Forger(3)
    sent: dict[str, list[bytes]] = {f'/{topic}': [] for topic in (*topics, 'clock')}
    ticks = iter(range(10**9))

    def send(topic: str, data: bytes) -> None:
        publisher = clock if topic == 'clock' else storm.publishers[topic]
        publisher.publish(data)
        sent[f'/{topic}'].append(data)
        time.sleep(PERIOD / 2)  # making them takes the other half

    def blow(count: int) -> None:
        for k in range(count):
            if k % 10 == 0:
                send('clock', serialize_message(Clock(clock=messages.stamp_of(next(ticks)))))
                send('clock', forger.wrong_clock())
            send('sheep', forger.wrong_sheep(k, True)[1])
            send('dog_1/odom', forger.wrong_odometry(k, True)[1])
            send('dog_1/cmd_vel', forger.wrong_command(k)[1])
            send('goal_pose', forger.wrong_goal()[1])
        total = sum(map(len, sent.values()))
        storm.wait_until(lambda: int(storm.said().get('messages', '0')) >= total)

    send('sheep', FAR_TOO_MANY)
    blow(1000)
    memory = storm.memory()
    blow(2500)
    assert storm.memory() - memory < MEMORY
    assert process.end() == 0
    assert 'lost' not in process.log
    assert len(process.log) < 10_000
    kept: dict[str, list[bytes]] = {topic: [] for topic in sent}
    with AnyReader([tmp_path / 'bag']) as reader:
        for connection, _, data in reader.messages():
            if connection.topic in kept:
                kept[connection.topic].append(bytes(data))
    for topic, of_topic in sent.items():
        assert len(kept[topic]) == len(of_topic)
        for data, as_sent in zip(kept[topic], of_topic, strict=True):
            assert data.startswith(as_sent)
            assert len(data) - len(as_sent) < 4  # the middleware fills up to whole words


@pytest.mark.slow
def test_a_long_run_takes_no_more_memory(start: Callable[..., Any], peer: Any) -> None:
    """15,000 control periods, each with its own turn of the executor, may leave 66 bytes each."""
    process = start('sim', sheep=3, dogs=1, real_time_factor=200.0)
    storm = Storm(peer, process, 'sim: herd')

    def periods() -> float:
        return 10.0 * float(storm.said().get('time_s', '0'))

    storm.wait_until(lambda: periods() > 3000, 60.0)  # more than the middleware keeps
    memory, begun = storm.memory(), periods()
    storm.wait_until(lambda: periods() > begun + 15_000, 60.0)
    assert storm.memory() - memory < MEMORY / 2
