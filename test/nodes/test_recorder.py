# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process of its own, against publishers in this one: real DDS between them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, ExitStack
import json
from pathlib import Path
import random
import re
import signal
import subprocess
import sys
import time
from types import SimpleNamespace
from typing import Any

from builtin_interfaces.msg import Time
from herding_ros import __version__
from herding_ros.bag.recovery import recover
from herding_ros.nodes.graph import LOOK_ROUNDS
from herding_ros.nodes.middleware import start_ros
from herding_ros.nodes.recorded_topics import NewTopic, RecordedTopics
from herding_ros.nodes.recorder import Recorder
from mcap.reader import make_reader
import pytest
import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Int32, String

LIMIT = 30.0
"""No condition is waited for any longer [s]."""

RELIABLE = QoSProfile(depth=1000)
LATCHED = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


def wait_until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end, 'waited too long'
        time.sleep(0.01)


def text_message(text: str) -> bytes:
    """A std_msgs/String as it is on the wire, where lengths are multiples of four."""
    data = text.encode() + b'.' * (-(len(text) + 1) % 4) + b'\0'
    return b'\0\1\0\0' + len(data).to_bytes(4, 'little') + data


def some_messages(topic: str, count: int) -> list[bytes]:
    generator = random.Random(topic)
    return [text_message(f'{topic} {k} {"x" * generator.randrange(300)}') for k in range(count)]


class Recording:
    """A recorder process and its bag."""

    def __init__(self, folder: Path, *parameters: str) -> None:
        self.path = folder / 'bag'
        self.log = folder / 'log.txt'
        arguments = [f'-p{parameter}' for parameter in (f'bag:={self.path}', *parameters)]
        with self.log.open('wb') as log:
            self.process = subprocess.Popen(
                [sys.executable, '-m', 'herding_ros.nodes.recorder', '--ros-args']
                + [word for each in arguments for word in (each[:2], each[2:])],
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def wait_for_file(self, content: bytes) -> None:
        file = self.path / 'bag_0.mcap'
        wait_until(lambda: file.is_file() and content in file.read_bytes())

    def wait_for_log(self, text: str) -> None:
        wait_until(lambda: text in self.log.read_text())

    def end(self, number: int = signal.SIGINT) -> int:
        self.process.send_signal(number)
        return self.process.wait(LIMIT)

    def messages(self) -> dict[str, list[bytes]]:
        """What the bag holds, of each topic."""
        read: dict[str, list[bytes]] = {}
        with AnyReader([self.path]) as reader:
            for connection in reader.connections:
                read[connection.topic] = []
            for connection, _, data in reader.messages():
                read[connection.topic].append(bytes(data))
        return read

    def custom_data(self) -> dict[str, str]:
        with AnyReader([self.path]) as reader:
            custom: dict[str, str] = reader.readers[0].storage.metadata.custom
            return custom


@contextmanager
def other_node(domain: int, name: str = 'other') -> Iterator[Node]:
    """A node with a participant of its own."""
    context = Context()
    start_ros(context=context, domain_id=domain)
    node = Node(name, context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


@pytest.fixture
def node(domain: int) -> Iterator[Node]:
    with other_node(domain, 'tester') as node:
        yield node


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Callable[..., Recording]]:
    """Start a recorder with the given parameters."""
    started: list[Recording] = []

    def start(*parameters: str) -> Recording:
        started.append(Recording(tmp_path, *parameters))
        return started[-1]

    yield start
    for recording in started:
        recording.process.kill()
        recording.process.wait()


def is_heard(publishers: list[Publisher], by: int = 1) -> bool:
    return all(publisher.get_subscription_count() >= by for publisher in publishers)


def is_delivered(publishers: Iterable[Publisher]) -> bool:
    """Whether all reliable messages have arrived, as acknowledged."""
    return all(publisher.wait_for_all_acked(Duration(seconds=0.1)) for publisher in publishers)


def test_every_byte_of_every_topic_is_recorded(
    node: Node, record: Callable[..., Recording]
) -> None:
    kinds = {'latched': LATCHED, 'reliable': RELIABLE, 'best_effort': BEST_EFFORT}
    publishers = {
        f'/{kind}_{k}': node.create_publisher(String, f'/{kind}_{k}', qos)
        for kind, qos in kinds.items()
        for k in range(8 if kind == 'reliable' else 6)
    }
    sent = {topic: some_messages(topic, 200) for topic in [*publishers, '/late']}
    for topic, publisher in publishers.items():  # before the recorder is there
        for message in sent[topic][:50] if 'latched' in topic else []:
            publisher.publish(message)
    recording = record()
    wait_until(lambda: is_heard(list(publishers.values())))
    publishers['/late'] = node.create_publisher(String, '/late', RELIABLE)
    wait_until(lambda: is_heard([publishers['/late']]))
    for k in range(200):
        for topic, publisher in publishers.items():
            if k >= 50 or 'latched' not in topic:
                publisher.publish(sent[topic][k])
        time.sleep(0.001)
    wait_until(lambda: is_delivered(publishers.values()))
    assert recording.end() == 0

    read = recording.messages()
    assert {topic: len(read[topic]) for topic in sent} == {topic: 200 for topic in sent}
    assert {topic: read[topic] for topic in sent} == sent
    assert '/rosout' in read
    assert '/parameter_events' in read
    with (recording.path / 'bag_0.mcap').open('rb') as stream:
        by_mcap: dict[str, list[bytes]] = {topic: [] for topic in sent}
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            if channel.topic in sent:
                assert schema is not None
                assert schema.name == 'std_msgs/msg/String'
                assert 'string data' in schema.data.decode()
                assert channel.metadata['topic_type_hash'].startswith('RIHS01_df668c7404')
                # Published and received on one machine, within the patience of this test.
                assert 0 <= message.log_time - message.publish_time < LIMIT * 1e9
                by_mcap[channel.topic].append(message.data)
    assert by_mcap == sent
    total = sum(map(len, read.values()))
    assert f'recorded {total} messages of {len(read)} topics' in recording.log.read_text()


def test_publisher_that_offers_less_is_recorded_too(
    node: Node, record: Callable[..., Recording]
) -> None:
    first = node.create_publisher(String, '/topic', LATCHED)
    recording = record()
    wait_until(lambda: is_heard([first]))
    sent = []

    def publish_for(seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            sent.append(text_message(f'{len(sent)}'))
            first.publish(sent[-1])
            time.sleep(0.002)

    publish_for(0.2)
    second = node.create_publisher(String, '/topic', BEST_EFFORT)
    while not is_heard([second]):
        publish_for(0.01)
    second.publish(text_message('second'))
    publish_for(1.5)  # until after the subscription that was replaced has ended
    assert recording.end() == 0
    read = recording.messages()['/topic']
    assert read.count(text_message('second')) == 1
    assert [data for data in read if data != text_message('second')] == sent  # once, in order
    assert 'offers less' in recording.log.read_text()


def test_only_chosen_topics_are_recorded(node: Node, record: Callable[..., Recording]) -> None:
    publishers = [node.create_publisher(String, topic, LATCHED) for topic in ('/a', '/b', '/c')]
    for publisher in publishers:
        publisher.publish(text_message('x'))
    recording = record('topics:=["/a", "/c"]')
    wait_until(lambda: is_heard([publishers[0], publishers[2]]))
    assert recording.end() == 0
    assert recording.messages() == {'/a': [text_message('x')], '/c': [text_message('x')]}


def test_profiles_are_those_of_the_publishers_and_a_topic_of_two_types_harms_no_other(
    node: Node, record: Callable[..., Recording], domain: int
) -> None:
    node.create_publisher(String, '/confused', RELIABLE)
    with other_node(domain) as other:
        other.create_publisher(Int32, '/confused', RELIABLE)
        wait_until(lambda: len(node.get_publishers_info_by_topic('/confused')) == 2)
        recording = record()
        recording.wait_for_log('/confused has several types')
    publishers = [
        node.create_publisher(String, '/latched', LATCHED),
        node.create_publisher(String, '/best_effort', BEST_EFFORT),
        node.create_publisher(String, '/best_effort', RELIABLE),
    ]
    wait_until(lambda: is_heard(publishers))
    assert recording.end() == 0
    assert recording.log.read_text().count('/confused') == 1
    with AnyReader([recording.path]) as reader:
        profiles = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert [p.durability for p in profiles['/latched']] == [QosDurability.TRANSIENT_LOCAL]
    assert {p.reliability for p in profiles['/best_effort']} <= {
        QosReliability.RELIABLE,
        QosReliability.BEST_EFFORT,
    }


def test_parameters_and_version_are_kept(node: Node, record: Callable[..., Recording]) -> None:
    node.declare_parameter('number', 1.5)
    node.declare_parameter('numbers', [1.0, 2.0])
    node.declare_parameter('group.text', "it's: ü")
    node.declare_parameter('bytes', [b'\1', b'\2'])
    node.declare_parameter('without_value', rclpy.Parameter.Type.STRING)
    mute = Node('mute', namespace='/far', context=node.context)  # never spun: answers nothing
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    recording = record()

    def is_answered() -> bool:
        executor.spin_once(timeout_sec=0.01)
        file = recording.path / 'bag_0.mcap'
        return file.is_file() and b'"/tester": {' in file.read_bytes()

    wait_until(is_answered)
    mute.destroy_node()
    assert recording.end() == 0
    custom_data = recording.custom_data()
    assert custom_data['herding_ros_version'] == __version__
    parameters = json.loads(custom_data['parameters'])
    assert set(parameters) <= {'/tester', '/recorder'}
    assert (
        parameters['/tester'].items()
        >= {
            'number': 1.5,
            'numbers': [1.0, 2.0],
            'group.text': "it's: ü",
            'bytes': [[1], [2]],
            'use_sim_time': False,
        }.items()
    )
    assert 'without_value' not in parameters['/tester']


@pytest.mark.parametrize('is_killed', [False, True])
def test_node_that_comes_again_is_asked_again(
    domain: int, record: Callable[..., Recording], is_killed: bool
) -> None:
    """One that was killed stays in the graph for a while, and so its name is never gone."""
    recording = record()
    file = recording.path / 'bag_0.mcap'
    with ExitStack() as lives:
        for number in (b'1.5', b'2.5'):
            node = lives.enter_context(other_node(domain))
            node.declare_parameter('number', float(number))
            executor = SingleThreadedExecutor(context=node.context)
            executor.add_node(node)

            def is_kept(
                executor: SingleThreadedExecutor = executor, value: bytes = number
            ) -> bool:
                executor.spin_once(timeout_sec=0.01)
                return file.is_file() and b'"number": ' + value in file.read_bytes()

            wait_until(is_kept)
            if not is_killed:
                lives.close()
        assert recording.end() == 0
    assert json.loads(recording.custom_data()['parameters'])['/other']['number'] == 2.5


def test_log_times_are_the_simulations(node: Node, record: Callable[..., Recording]) -> None:
    early = node.create_publisher(String, '/early', LATCHED)
    early.publish(text_message('early'))
    clock = node.create_publisher(Clock, '/clock', RELIABLE)
    state = node.create_publisher(String, '/state', RELIABLE)
    limits = ['max_bag_duration:=8']
    recording = record('use_sim_time:=true', 'topics:=["/early", "/state"]', *limits)
    wait_until(lambda: is_heard([early, state]) and is_heard([clock], by=2))  # one is rclpy's
    recording.wait_for_file(text_message('early'))  # without waiting for a clock
    ticks = [*range(5, 25), *range(0, 10)]  # a reset after 20
    for tick in ticks:
        clock.publish(serialize_message(Clock(clock=Time(sec=tick))))
        state.publish(text_message(f'{tick}'))
        if tick % 3:  # some come in while the recorder is taking, some all at once
            time.sleep(0.01)
    assert recording.end() == 0
    times: dict[str, list[int]] = {'/early': [], '/state': [], '/clock': []}
    order = []
    for k in range(4):  # files of eight seconds of the simulation and the next message
        with (recording.path / f'bag_{k}.mcap').open('rb') as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                times[channel.topic].append(message.log_time)
                order.append(message.log_time)
    assert not (recording.path / 'bag_4.mcap').exists()
    # Time in a bag never goes back, or a player would mix what was before and after the reset.
    expected = [tick * 10**9 for tick in (*range(5, 25), *range(24, 34))]
    assert times == {'/early': [5 * 10**9], '/state': expected, '/clock': expected}
    assert order == sorted(order)


def test_without_any_clock_a_kill_costs_nothing(
    node: Node, record: Callable[..., Recording]
) -> None:
    publisher = node.create_publisher(String, '/topic', RELIABLE)
    before = time.time_ns()
    recording = record('use_sim_time:=true')
    wait_until(lambda: is_heard([publisher]))
    publisher.publish(text_message('x'))
    recording.wait_for_file(text_message('x'))
    recording.wait_for_log('use_sim_time is true, but nothing has come on /clock')
    recording.wait_for_file(b'recording, use_sim_time is true')  # in its diagnostics
    recording.end(signal.SIGKILL)
    recover(recording.path)
    assert recording.messages()['/topic'] == [text_message('x')]
    with AnyReader([recording.path]) as reader:
        assert before < reader.start_time < time.time_ns()
    *_, (status, _) = statuses(recording)
    assert status.level == 1


def test_single_message_of_a_short_publisher_is_recorded(
    node: Node, record: Callable[..., Recording], domain: int
) -> None:
    """As of `ros2 topic pub --once`: the recorder is there before it, where anybody else is."""
    kinds = {'latched': LATCHED, 'reliable': RELIABLE}
    for kind, qos in kinds.items():
        node.create_subscription(String, f'/{kind}', lambda _: None, qos)
    node.create_subscription(String, '/silent', lambda _: None, RELIABLE)
    recording = record()
    wait_until(lambda: all(len(heard_by(node, f'/{kind}')) == 2 for kind in [*kinds, 'silent']))
    with other_node(domain) as other:
        for kind, qos in kinds.items():
            publisher = other.create_publisher(String, f'/{kind}', qos)
            wait_until(lambda publisher=publisher: is_heard([publisher], by=2))
            publisher.publish(text_message(kind))
            wait_until(lambda publisher=publisher: is_delivered([publisher]))
            other.destroy_publisher(publisher)
    for kind in kinds:
        recording.wait_for_file(text_message(kind))
    assert recording.end() == 0
    read = recording.messages()
    assert {kind: read[f'/{kind}'] for kind in kinds} == {k: [text_message(k)] for k in kinds}
    assert '/silent' not in read


def heard_by(node: Node, topic: str) -> list[str]:
    return [info.node_name for info in node.get_subscriptions_info_by_topic(topic)]


def test_subscribers_of_another_type_change_nothing(
    node: Node, record: Callable[..., Recording], domain: int
) -> None:
    with other_node(domain) as other:
        for topic in ('/before', '/after'):  # the type of the publisher counts
            other.create_subscription(Int32, topic, lambda _: None, 1)
        before = node.create_publisher(String, '/before', RELIABLE)
        recording = record()
        wait_until(lambda: is_heard([before]) and 'recorder' in heard_by(node, '/after'))
        after = node.create_publisher(String, '/after', RELIABLE)
        third = node.create_publisher(String, '/third', RELIABLE)
        wait_until(lambda: is_heard([after, third]))
        other.create_subscription(Int32, '/third', lambda _: None, 1)
        wait_until(lambda: len(heard_by(node, '/third')) == 2)
        for publisher in (before, after, third):
            publisher.publish(text_message('x'))
        wait_until(lambda: is_delivered([before, after, third]))
        assert recording.end() == 0
    read = recording.messages()
    assert [read[topic] for topic in ('/before', '/after', '/third')] == [[text_message('x')]] * 3


def test_subscription_holds_all_that_comes_while_the_disk_makes_it_wait(domain: int) -> None:
    with other_node(domain, 'listener') as listener, other_node(domain, 'talker') as talker:
        added: list[NewTopic] = []
        topics = RecordedTopics(listener, '/topic'.__eq__, added.append)
        publisher = talker.create_publisher(String, '/topic', RELIABLE)

        def is_followed() -> bool:
            topics.discover()
            return is_heard([publisher])

        wait_until(is_followed)
        for k in range(6000):
            publisher.publish(text_message(f'{k}'))
            if k % 500 == 0:
                wait_until(lambda: is_delivered([publisher]))
        wait_until(lambda: is_delivered([publisher]))
        received = [message.data for message in topics.take_last()]
        assert received == [text_message(f'{k}') for k in range(6000)]
        assert [topic.name for topic in added] == ['/topic']


def test_publishers_are_looked_at_when_there_are_more_or_fewer_and_seldom_otherwise(
    domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One query for each of hundreds of topics, ten times a second, takes half a core."""
    with other_node(domain, 'listener') as listener, other_node(domain, 'talker') as talker:
        topics = RecordedTopics(listener, lambda name: name.startswith('/topic'), lambda _: None)
        publishers = [talker.create_publisher(String, f'/topic_{k}', RELIABLE) for k in range(20)]

        def are_followed() -> bool:
            topics.discover()
            return is_heard(publishers) and len(topics) == len(publishers)

        wait_until(are_followed)
        topics.discover()
        asked: list[str] = []
        for name in ('get_publishers_info_by_topic', 'get_subscriptions_info_by_topic'):
            ask = getattr(listener, name)
            monkeypatch.setattr(
                listener, name, lambda topic, ask=ask: asked.append(topic) or ask(topic)
            )
        for _ in range(2 * LOOK_ROUNDS):
            topics.discover()
        assert len(asked) <= 2 * len(publishers)
        assert set(asked) == {publisher.topic_name for publisher in publishers}
        # Another in its place, between two rounds, which offers less: they are as many as before.
        talker.destroy_publisher(publishers[7])
        publishers[7] = talker.create_publisher(String, '/topic_7', BEST_EFFORT)
        wait_until(
            lambda: [
                each.qos_profile.reliability
                for each in listener.get_publishers_info_by_topic('/topic_7')
            ] == [ReliabilityPolicy.BEST_EFFORT]
        )  # fmt: skip
        for _ in range(LOOK_ROUNDS):
            topics.discover()
        wait_until(lambda: is_heard(publishers))


@pytest.fixture
def recorder(domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Recorder]:
    """A recorder with a bag, in this process, that nobody spins."""
    monkeypatch.chdir(tmp_path)
    start_ros(domain_id=domain)
    one = Recorder()
    one.create_bag()
    yield one
    one.bag.close()
    one.destroy_node()
    rclpy.shutdown()


def test_nodes_that_come_and_go_leave_no_clients(recorder: Recorder, domain: int) -> None:
    def clients() -> int:
        recorder._search_graph()
        return len(list(recorder.clients))

    before = clients()
    with other_node(domain, 'passer_by'):
        wait_until(lambda: clients() == before + 3)
    wait_until(lambda: clients() == before)


def test_nodes_that_come_and_go_leave_few_parameters(
    recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Metadata that grow without end can be read no more."""
    for k in range(500):
        there = {'/sim', f'/passer_by_{k}'}
        answers = {name: {'use_sim_time': False} for name in there}
        queries = SimpleNamespace(names=there, answers=answers.copy)
        monkeypatch.setattr(recorder, '_queries', queries)
        recorder._search_graph()
    kept = set(recorder._parameters_of)
    assert {'/sim', '/passer_by_0', '/passer_by_499'} < kept
    assert len(kept) < 200


def test_ten_thousand_messages_a_second(node: Node, record: Callable[..., Recording]) -> None:
    publishers = {f'/t{k}': node.create_publisher(String, f'/t{k}', RELIABLE) for k in range(20)}
    recording = record()
    wait_until(lambda: is_heard(list(publishers.values())))
    sent = {topic: some_messages(topic, 700) for topic in publishers}
    start = time.perf_counter()
    for k in range(700):
        for topic, publisher in publishers.items():
            publisher.publish(sent[topic][k])
        time.sleep(max(0.0, start + 0.002 * (k + 1) - time.perf_counter()))
    wait_until(lambda: is_delivered(publishers.values()))
    assert recording.end() == 0
    read = recording.messages()
    assert {topic: read[topic] for topic in sent} == sent
    assert 'lost' not in recording.log.read_text()


def test_lost_messages_are_counted(node: Node, record: Callable[..., Recording]) -> None:
    publisher = node.create_publisher(String, '/flood', BEST_EFFORT)
    recording = record()
    wait_until(lambda: is_heard([publisher]))
    sent = some_messages('/flood', 10_000)
    for _ in range(10):  # best effort begins once the recorder has matched as well
        publisher.publish(text_message('before'))
        time.sleep(0.05)
    recording.process.send_signal(signal.SIGSTOP)  # the middleware overflows meanwhile
    for k, message in enumerate(sent):
        publisher.publish(message)
        if k % 100 == 0:
            time.sleep(0.001)
    recording.process.send_signal(signal.SIGCONT)
    for _ in range(20):  # without a successor a gap is not seen
        publisher.publish(text_message('after'))
        time.sleep(0.05)
    recording.wait_for_log('were lost')
    assert recording.end() == 0
    read = recording.messages()
    lost = len(sent) + 20 - sum(data != text_message('before') for data in read['/flood'])
    assert lost > 0
    told = re.findall('([0-9]+) messages of /flood were lost', recording.log.read_text())
    assert sum(map(int, told)) == lost
    *_, (status, values) = statuses(recording)
    assert status.level == 2
    assert 0 < int(values['lost']) <= lost
    assert recording.custom_data()['messages_lost'] == f'{lost}'


def statuses(recording: Recording) -> Iterator[tuple[Any, dict[str, str]]]:
    """The statuses of the recorder in its bag, and their values."""
    with AnyReader([recording.path]) as reader:
        connections = [c for c in reader.connections if c.topic == '/diagnostics']
        for connection, _, data in reader.messages(connections):
            message: Any = reader.deserialize(data, connection.msgtype)
            for status in message.status:
                assert status.name == 'recorder: bag'
                yield status, {pair.key: pair.value for pair in status.values}


def test_existing_bag_is_refused(tmp_path: Path, record: Callable[..., Recording]) -> None:
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'precious').write_text('precious')
    recording = record()
    assert recording.process.wait(LIMIT) == 2
    assert 'exists already' in recording.log.read_text()
    assert 'Traceback' not in recording.log.read_text()
    assert [file.name for file in (tmp_path / 'bag').iterdir()] == ['precious']


def test_end_before_anything_is_discovered(record: Callable[..., Recording]) -> None:
    recording = record()
    recording.wait_for_log('recording into')
    begin = time.monotonic()
    recording.process.send_signal(signal.SIGTERM)
    assert recording.end(signal.SIGTERM) == 0  # twice
    assert time.monotonic() - begin < 2.0
    recording.messages()
    assert 'Traceback' not in recording.log.read_text()
