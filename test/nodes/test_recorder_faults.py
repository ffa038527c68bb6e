# SPDX-License-Identifier: Apache-2.0
"""The recorder when things go wrong: kills, full disks, wrong targets, signals, strange types.

Each against a process of its own over DDS; bags are read by rosbags.
"""

from __future__ import annotations

from collections.abc import Callable
import itertools
from pathlib import Path
import random
import resource
import signal
import struct
import subprocess
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from herding_ros.bag.inspection import inspect
from mcap.reader import make_reader
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker
import yaml

NUMBERS = '/numbers'
LOSS = 0.1
"""What was published longer ago than this is not lost, as a rule [s]."""

CHUNK = 64 * 1024
"""More than this is never lost [bytes]."""

NUMBER = 52
"""A message of a counter without ballast in the file of a bag, at most [bytes]."""

IN_TIME = 2.0
"""Time in which the recorder ends after a signal [s]."""

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Counter:
    """counter.py, which publishes a thousand numbers a second, and when it did [s]."""

    def __init__(self, process: Any, file: Path) -> None:
        self.process = process
        self._file = file

    @property
    def times(self) -> Any:
        data = self._file.read_bytes() if self._file.exists() else b''
        return np.frombuffer(data[: len(data) // 8 * 8], np.float64)

    @property
    def count(self) -> int:
        return self._file.stat().st_size // 8 if self._file.exists() else 0

    def end(self) -> None:
        self.process.process.terminate()
        self.process.wait()


@pytest.fixture
def count(start: Callable[..., Any], tmp_path: Path) -> Callable[..., Counter]:
    """Return a function that starts to count; ended with the test, if not before."""

    def start_one(ballast: int = 0) -> Counter:
        file = tmp_path / 'times'
        program = Path(__file__).with_name('counter.py')
        return Counter(start('counter', str(file), str(ballast), program=program), file)

    return start_one


def text_in(data: bytes) -> str:
    """The text in the bytes of a std_msgs/String."""
    (length,) = struct.unpack_from('<I', data, 4)
    return data[8 : 8 + length - 1].decode()


def texts_in(folder: Path, topic: str) -> list[tuple[str, int]]:
    """The texts of a topic in a bag, and their log times [ns]."""
    with AnyReader([folder]) as reader:
        assert reader.message_count == sum(1 for _ in reader.messages())
        connections = [c for c in reader.connections if c.topic == topic]
        return [(text_in(data), time) for _, time, data in reader.messages(connections)]


def number_in(message: String) -> int:
    return int(message.data)


def numbers_in(folder: Path) -> list[int]:
    """What is in a bag of a counter."""
    return [int(text) for text, _ in texts_in(folder, NUMBERS)]


def status(diagnostics: list[Any]) -> tuple[Any, dict[str, str]]:
    """The recorder's newest status and its values; an empty one if there is none."""
    for message in reversed(diagnostics):
        for each in message.status:
            return each, {pair.key: pair.value for pair in each.values}
    return DiagnosticStatus(), {}


def recover(folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, '-m', 'herding_ros.bag.cli', str(folder)],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


# Kills.


def kept_waiting(process: Any) -> float:
    """How long the threads of a process were ready and got no processor, in all [s]."""
    files = Path(f'/proc/{process.process.pid}/task').glob('*/schedstat')
    return sum(int(file.read_text().split()[1]) for file in files) * 1e-9


def written(folder: Path) -> int:
    """How many bytes of a bag of one file are on disk, without room that is only reserved."""
    file = folder / f'{folder.name}_0.mcap'
    return len(file.read_bytes().rstrip(b'\0')) if file.exists() else 0


def test_kills_cost_less_than_a_tenth_of_a_second(
    start: Callable[..., Any],
    count: Callable[..., Counter],
    wait_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    generator = random.Random(0)
    counter = count()
    losses = []
    folders = [tmp_path / f'bag_{k}' for k in range(5)]  # two processors can bear them at once
    recorders = [start('recorder', bag=folder, topics=f'["{NUMBERS}"]') for folder in folders]
    wait_until(lambda: all(written(f) > 50_000 for f in folders))
    kills: list[tuple[float, float]] = []
    for recorder in recorders:
        time.sleep(generator.uniform(0.0, 0.4))
        waited = kept_waiting(recorder)
        time.sleep(0.5)
        # What these processes, and others, take from each other is no fault.
        waited = kept_waiting(recorder) - waited
        kills.append((time.monotonic(), waited))
        recorder.process.kill()
        recorder.wait()
    for folder, (at, waited) in zip(folders, kills, strict=True):
        done = recover(folder)
        assert done.returncode == 0, done.stderr
        numbers = numbers_in(folder)
        # While it is being matched, a subscription may get some messages and miss others.
        settled = [number for number in numbers if number > numbers[0] + 200]
        assert settled == list(range(settled[0], settled[0] + len(settled)))
        assert len(settled) > 300
        with (folder / f'{folder.name}_0.mcap').open('rb') as stream:
            by_mcap = make_reader(stream, validate_crcs=True)
            summary = by_mcap.get_summary()
            assert summary is not None
            assert summary.chunk_indexes
            assert sum(1 for _ in by_mcap.iter_messages([NUMBERS])) == len(numbers)
        wait_until(lambda last=numbers[-1]: counter.count > last + 1)
        lost = counter.times[numbers[-1] + 1 :]
        losses.append((at - lost[0], waited, np.count_nonzero(lost < at)))
    print('lost:', *(f'{1e3 * lost:.0f} ms ({number}),' for lost, _, number in losses))
    assert all(NUMBER * number <= CHUNK for _, _, number in losses), losses
    assert sum(lost < LOSS + waited for lost, waited, _ in losses) >= 4, losses


def test_kill_costs_no_more_of_a_slow_topic(
    start: Callable[..., Any], peer: Any, tmp_path: Path
) -> None:
    recorder = start('recorder', bag=tmp_path / 'bag', topics='["/slow"]')
    publisher = peer.talk_to(String, '/slow')
    for k in range(4):
        peer.spin_for(0.3)
        publisher.publish(String(data=f'{k}'))
    peer.spin_for(2 * LOSS)
    recorder.process.kill()
    recorder.wait()
    assert recover(tmp_path / 'bag').returncode == 0
    assert [text for text, _ in texts_in(tmp_path / 'bag', '/slow')] == ['0', '1', '2', '3']


def test_kill_of_a_bag_of_several_files(
    start: Callable[..., Any],
    count: Callable[..., Counter],
    wait_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    recorder = start(
        'recorder', bag=tmp_path / 'bag', topics=f'["{NUMBERS}"]', max_bag_size=50_000
    )
    counter = count()
    wait_until(lambda: (tmp_path / 'bag' / 'bag_3.mcap').exists())
    assert recover(tmp_path / 'bag').returncode == 2  # it is being recorded
    recorder.process.kill()
    recorder.wait()
    at = time.monotonic()
    whole = numbers_in(tmp_path / 'bag')  # without recovery
    assert whole == list(range(whole[0], whole[0] + len(whole)))
    done = recover(tmp_path / 'bag')
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(': whole, ') >= 3
    numbers = numbers_in(tmp_path / 'bag')
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert numbers[: len(whole)] == whole
    assert len(numbers) > len(whole)
    assert counter.times[numbers[-1]] > at - 1.0


# Disks that refuse.


def check_stopped(
    peer: Any, process: Any, counter: Counter, heard: list[Any], diagnostics: list[Any], bag: Path
) -> dict[str, str]:
    """Wait until the recorder says that it has stopped; it and all others are to go on."""
    peer.spin_until(lambda: status(diagnostics)[0].message.startswith('stopped: '))
    assert status(diagnostics)[0].level == DiagnosticStatus.ERROR
    told, values = status(diagnostics)
    assert told.name == 'recorder: bag'
    assert told.message.startswith('stopped: ')
    assert process.log.count('stopped recording into') == 1
    told_before, seen = len(diagnostics), counter.count
    peer.spin_until(lambda: len(diagnostics) >= told_before + 2)
    assert status(diagnostics)[0].message == told.message
    assert status(diagnostics)[1]['messages'] == values['messages']
    for service in ('pause', 'resume'):
        answer = peer.call(Trigger, f'recorder/{service}', Trigger.Request())
        assert not answer.success
        assert answer.message == told.message
    # The others have noticed nothing.
    peer.spin_until(lambda: heard and number_in(heard[-1]) > seen + 1000)
    heard_numbers = [number_in(message) for message in heard]
    assert heard_numbers == list(range(heard_numbers[0], heard_numbers[-1] + 1))
    assert process.process.poll() is None
    return values


def test_full_disk_is_told_and_leaves_a_complete_bag(
    start: Callable[..., Any],
    peer: Any,
    count: Callable[..., Counter],
    tmp_path: Path,
    small_disk: Path,
) -> None:
    bag = small_disk / 'bag'
    process = start('recorder', bag=bag)
    diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
    heard = peer.listen(String, NUMBERS, 100_000)
    counter = count(1000)
    values = check_stopped(peer, process, counter, heard, diagnostics, bag)
    assert status(diagnostics)[0].message == 'stopped: No space left on device'
    assert f'the {values["messages"]} messages until now are a complete bag' in process.log
    # As it is, and while the recorder is still there.
    numbers = numbers_in(bag)
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert len(numbers) > 1500
    assert values['bag'] == str(bag)
    with AnyReader([bag]) as reader:
        assert reader.message_count == int(values['messages'])
    before = {file: file.read_bytes() for file in bag.iterdir()}
    process.ends_in_time(signal.SIGTERM, code=1)
    assert {file: file.read_bytes() for file in bag.iterdir()} == before


def test_disk_that_fails_in_the_middle_leaves_a_bag_to_recover(
    start: Callable[..., Any], peer: Any, count: Callable[..., Counter], tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    process = start('recorder', bag=bag)
    diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
    heard = peer.listen(String, NUMBERS, 100_000)
    counter = count()
    peer.spin_until(lambda: int(status(diagnostics)[1].get('messages', 0)) > 1000)
    written = int(status(diagnostics)[1]['messages'])
    # All these are to be on disk. However long that takes where processors are busy.
    peer.spin_until(lambda: inspect(bag / 'bag_0.mcap').information.message_count >= written)
    largest_file(process, 10_000)  # less than it has already
    check_stopped(peer, process, counter, heard, diagnostics, bag)
    assert f'the bag is not complete: recover it by `ros2 run herding_ros recover {bag}`' in (
        process.log
    )
    process.ends_in_time(signal.SIGINT, code=1)
    assert recover(bag).returncode == 0
    numbers = numbers_in(bag)
    # While it is being matched, a subscription may get some messages and miss others.
    settled = [number for number in numbers if number > numbers[0] + 200]
    assert settled == list(range(settled[0], settled[0] + len(settled)))
    with AnyReader([bag]) as reader:
        assert reader.message_count >= written


def largest_file(process: Any, size: int) -> None:
    """Let no file of a process become larger: as if the disk were full."""
    limit = resource.RLIMIT_FSIZE
    _, hard = resource.prlimit(process.process.pid, limit)
    resource.prlimit(process.process.pid, limit, (size, hard))


def test_full_disk_at_the_start_is_refused(start: Callable[..., Any], small_disk: Path) -> None:
    (small_disk / 'filling').write_bytes(bytes(3_500_000))
    process = start('recorder', bag=small_disk / 'bag')
    assert process.wait() == 2
    assert f'cannot write the bag {small_disk}/bag: No space left on device' in process.log
    assert 'Traceback' not in process.log
    assert [file.name for file in small_disk.iterdir()] == ['filling']


@pytest.mark.parametrize(
    ('target', 'reason'),
    [('/dev/null/bag', 'Not a directory')],
)
def test_target_that_cannot_be_written_is_refused(
    start: Callable[..., Any], target: str, reason: str
) -> None:
    process = start('recorder', bag=target)
    assert process.wait() == 2
    assert f'cannot create the bag {target}: {reason}' in process.log
    assert 'Traceback' not in process.log


@pytest.mark.parametrize(
    ('name', 'value'),
    [('max_bag_size', -1), ('max_bag_duration', 'abc')],
)
def test_parameter_that_is_not_allowed_is_refused(
    start: Callable[..., Any], tmp_path: Path, name: str, value: Any
) -> None:
    process = start('recorder', **{'bag': tmp_path / 'bag', name: value})
    assert process.wait() == 2
    assert 'cannot start: ' in process.log
    assert name in process.log
    assert str(value) in process.log
    assert 'Traceback' not in process.log
    assert not (tmp_path / 'bag').exists()


# Bags of several files.


def test_files_by_size(
    start: Callable[..., Any], peer: Any, count: Callable[..., Counter], tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    process = start('recorder', bag=bag, max_bag_size=50_000)
    latched = peer.node.create_publisher(String, '/latched', LATCHED)
    latched.publish(String(data='early'))
    counter = count()
    peer.spin_until(lambda: peer.node.count_subscribers(NUMBERS))
    seen = counter.count
    peer.spin_until(lambda: counter.count > seen + 2000)
    counter.end()
    process.ends_in_time(signal.SIGINT)
    numbers = numbers_in(bag)
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    # It may be that the last one was published when the process was ended, and not noted.
    assert numbers[-1] - counter.count in (-1, 0)
    assert len(numbers) > 1500
    content = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    names = content['relative_file_paths']
    assert names == [f'bag_{k}.mcap' for k in range(len(names))]
    assert len(names) >= 3
    together = []
    for name, information in zip(names, content['files'], strict=True):
        assert 0 < (bag / name).stat().st_size < 110_000  # with what completes it
        with (bag / name).open('rb') as stream:
            part = [
                int(text_in(message.data))
                for _, _, message in make_reader(stream).iter_messages([NUMBERS])
            ]
        assert information['message_count'] >= len(part) > 0
        together += part
    assert together == numbers
    topics = {
        topic['topic_metadata']['name']: topic['message_count']
        for topic in content['topics_with_message_count']
    }
    assert topics[NUMBERS] == len(numbers)
    assert topics['/latched'] == 1


# Pause.


def test_pause_leaves_out_what_is_published_meanwhile(
    start: Callable[..., Any], peer: Any, tmp_path: Path
) -> None:
    process = start('recorder', bag=tmp_path / 'bag', topics=f'["{NUMBERS}", "/late"]')
    diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
    publisher = peer.talk_to(String, NUMBERS)
    numbers = itertools.count()

    def publish(count: int, recorded: int = 0) -> None:
        """Publish and wait until all has arrived; `recorded`: messages in the bag then."""
        for number in itertools.islice(numbers, count):
            publisher.publish(String(data=f'{number}'))
        if recorded:
            peer.spin_until(lambda: status(diagnostics)[1].get('messages') == f'{recorded}')
        else:
            assert publisher.wait_for_all_acked()

    def ask(service: str) -> None:
        answer = peer.call(Trigger, f'recorder/{service}', Trigger.Request())
        assert answer.success
        assert answer.message == {'pause': 'paused', 'resume': 'recording'}[service]

    publish(100, recorded=100)
    ask('pause')
    publish(50)
    ask('pause')  # once more
    peer.spin_until(lambda: status(diagnostics)[0].message == 'paused')
    assert status(diagnostics)[0].level == DiagnosticStatus.OK
    late = peer.talk_to(String, '/late')  # topics are followed
    late.publish(String(data='paused'))
    publish(50)
    ask('resume')
    ask('resume')
    late.publish(String(data='recorded'))
    publish(100, recorded=201)
    assert status(diagnostics)[0].message == 'recording'
    assert int(status(diagnostics)[1]['bytes']) > 200 * 10
    ask('pause')
    publish(50)
    process.ends_in_time(signal.SIGINT)
    assert numbers_in(tmp_path / 'bag') == [*range(100), *range(200, 300)]
    assert [text for text, _ in texts_in(tmp_path / 'bag', '/late')] == ['recorded']


def test_clock_is_followed_during_a_pause(
    start: Callable[..., Any], peer: Any, tmp_path: Path
) -> None:
    process = start('recorder', bag=tmp_path / 'bag', use_sim_time=True, topics='["/state"]')
    clock = peer.talk_to(Clock, '/clock', listeners=2)  # one is rclpy's
    state = peer.talk_to(String, '/state')

    def tick(second: int) -> None:
        message = Clock()
        message.clock.sec = second
        clock.publish(message)
        peer.spin_for(0.1)  # for rounds of the recorder between any two
        state.publish(String(data=f'{second}'))
        peer.spin_for(0.1)

    def ask(service: str) -> None:
        assert peer.call(Trigger, f'recorder/{service}', Trigger.Request()).success

    ask('pause')
    tick(3)  # the first one
    tick(4)
    ask('resume')
    state.publish(String(data='resumed'))
    tick(5)
    ask('pause')
    tick(6)
    tick(7)
    ask('resume')
    tick(8)
    process.ends_in_time(signal.SIGINT)
    assert texts_in(tmp_path / 'bag', '/state') == [
        ('resumed', 4 * 10**9), ('5', 5 * 10**9), ('8', 8 * 10**9),
    ]  # fmt: skip


# Signals.


def test_end_while_paused(
    start: Callable[..., Any], peer: Any, count: Callable[..., Counter], tmp_path: Path
) -> None:
    process = start('recorder', bag=tmp_path / 'bag')
    diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
    counter = count()
    peer.spin_until(lambda: int(status(diagnostics)[1].get('messages', 0)) > 100)
    peer.call(Trigger, 'recorder/pause', Trigger.Request())
    paused = counter.count
    peer.spin_for(0.2)
    process.process.send_signal(signal.SIGTERM)
    process.ends_in_time(signal.SIGTERM)  # twice in a row
    numbers = numbers_in(tmp_path / 'bag')
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert 0 < len(numbers) <= paused


def test_storm_of_signals_at_any_time(start: Callable[..., Any], tmp_path: Path) -> None:
    """From the moment the program has taken over the signals until it is gone."""
    generator = random.Random(0)
    for trial in range(3):
        process = start('recorder', afresh=True, bag=tmp_path / f'{trial}')
        pid = process.process.pid
        while not takes_signals(pid):
            time.sleep(0.005)
        time.sleep(generator.uniform(0.0, 0.8))
        begin = time.monotonic()
        while process.process.poll() is None:
            process.process.send_signal(generator.choice([signal.SIGINT, signal.SIGTERM]))
            time.sleep(0.003)
        assert time.monotonic() - begin < IN_TIME
        assert process.wait() == 0, process.log
        assert 'Traceback' not in process.log
        with AnyReader([tmp_path / f'{trial}']):
            pass


def takes_signals(pid: int) -> bool:
    """Whether a process catches SIGTERM, by its status in /proc."""
    for line in Path(f'/proc/{pid}/status').read_text().splitlines():
        if line.startswith('SigCgt:'):
            return bool(int(line.split()[1], 16) & 1 << (signal.SIGTERM - 1))
    return False


# Strange types.


BROKEN_PACKAGES = {
    'visualization_msgs': 'raise RuntimeError("broken on import")',
    'trajectory_msgs': 'class JointTrajectory: pass',  # that ROS knows nothing of
}


def test_topics_of_broken_packages_are_left_out(
    start: Callable[..., Any],
    peer: Any,
    count: Callable[..., Counter],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for package, source in BROKEN_PACKAGES.items():
        folder = tmp_path / 'broken' / package / 'msg'
        folder.mkdir(parents=True)
        (folder.parent / '__init__.py').touch()
        (folder / '__init__.py').write_text(source)
    monkeypatch.setenv('PYTHONPATH', str(tmp_path / 'broken'), prepend=':')
    peer.node.create_publisher(Marker, '/marker', 10)
    peer.node.create_publisher(JointTrajectory, '/joints', 10)
    process = start('recorder', afresh=True, bag=tmp_path / 'bag')
    process.wait_for('/marker is not recorded: broken on import')
    process.wait_for('/joints is not recorded')
    diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
    count()
    peer.spin_until(lambda: int(status(diagnostics)[1].get('messages', 0)) > 500)
    process.ends_in_time(signal.SIGINT)
    assert process.log.count('is not recorded') == 2
    assert len(numbers_in(tmp_path / 'bag')) > 100
    with AnyReader([tmp_path / 'bag']) as reader:
        assert not {'/marker', '/joints'} & set(reader.topics)
