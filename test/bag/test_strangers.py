# SPDX-License-Identifier: Apache-2.0
"""Bags of strangers: whatever is in them costs little time and memory, and ends in one line."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
import os
from pathlib import Path
import shutil
import struct
import subprocess
import sys
from typing import Any

from herding_ros.bag.cli import main
from herding_ros.bag.reader import read_run
from herding_ros.bag.recovery import recover
import numpy as np
import pytest
import zstandard

MOST_MEGABYTES = 200
"""Memory that the programs need at most, that of the libraries included."""

T, N = 20, 4


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory, run_recorder: Any) -> Path:
    """A short run of four sheep and one dog."""
    path = tmp_path_factory.mktemp('run') / 'bag'
    generator = np.random.default_rng(0)
    with run_recorder(path, {'/controller': {'goal': [0.5, -0.25]}}) as recorder:
        for k in range(T):
            ns = k * 100_000_000
            recorder.log_ns, recorder.publish_ns = ns, recorder.publish_ns + 1000
            recorder.sheep('/sheep', ns, generator.normal(size=(N, 2)), np.zeros((N, 2)))
            recorder.odometry('/dog_1/odom', ns, (0, 0))
            recorder.command('/dog_1/cmd_vel', ns, (1, 0))
            recorder.bag.flush()
        recorder.diagnostics('controller: plan', 0, replan=0, solve_ms=1.5)
    return path


def run_fuzz(*arguments: object) -> None:
    program = Path(__file__).with_name('fuzz.py')
    run = subprocess.run(
        [sys.executable, str(program), *map(str, arguments)],
        capture_output=True, text=True, check=False, timeout=1800,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    *wrong, peak = run.stdout.splitlines()
    assert not wrong, run.stdout
    assert int(peak.removesuffix(' MB')) <= MOST_MEGABYTES


def test_no_damage_does_harm(bag: Path, tmp_path: Path) -> None:
    run_fuzz(bag, tmp_path / 'work', 0, 300)


@pytest.mark.slow
@pytest.mark.parametrize('first', range(1000, 4000, 500))
def test_no_damage_of_thousands_does_harm(bag: Path, tmp_path: Path, first: int) -> None:
    run_fuzz(bag, tmp_path / 'work', first, 500)


# Bags that cost much, if they can.


def record(kind: int, content: bytes) -> bytes:
    return struct.pack('<BQ', kind, len(content)) + content


def text(value: bytes) -> bytes:
    return struct.pack('<I', len(value)) + value


def mapping(items: Iterable[tuple[bytes, bytes]]) -> bytes:
    return text(b''.join(text(key) + text(value) for key, value in items))


def topic(number: int, profiles: bytes) -> bytes:
    name = text(b'/%d' % number)
    said = mapping([(b'offered_qos_profiles', profiles)])
    return record(4, struct.pack('<HH', number, 1) + name + text(b'cdr') + said)


def message(size: int = 0) -> bytes:
    return record(5, struct.pack('<HIQQ', 1, 0, 5, 5) + bytes(size))


def packed(data: bytes) -> bytes:
    compressed = zstandard.compress(data)
    head = struct.pack('<QQQI', 0, 0, len(data), 0) + text(b'zstd')
    return record(6, head + struct.pack('<Q', len(compressed)) + compressed)


def aliases(levels: int) -> bytes:
    """Nine times as many values with each level."""
    lines = [b'a0: &a0 [%b]' % b','.join([b'x'] * 9)]
    for k in range(1, levels):
        lines.append(b'a%d: &a%d [%b]' % (k, k, b','.join([b'*a%d' % (k - 1)] * 9)))
    return b'\n'.join(lines)


def described(value: bytes) -> bytes:
    return record(12, text(b'rosbag2') + mapping([(b'serialized_metadata', value)]))


MB = 1_000_000
LARGEST = 15 * 2**20
SCHEMA = record(3, struct.pack('<H', 1) + text(b'a/msg/A') + text(b'ros2msg') + text(b'string s'))


def bombs() -> dict[str, bytes]:
    return {
        'aliases in the metadata': described(aliases(9)) + described(aliases(200)),
        'aliases in QoS': topic(1, aliases(9)) + topic(2, aliases(200)),
        'short records': record(0x80, b'') * (MB // 9),
        'heads of chunks': b''.join(struct.pack('<BQ', 6, MB - k) for k in range(0, MB, 9)),
        'packed zeros': packed(bytes(LARGEST)) * 100,
        'packed short records': packed(record(0x80, b'') * (LARGEST // 9)) * 100,
        'packed short messages': topic(1, b'') + packed(message() * (LARGEST // 31)) * 100,
        'packed large messages': topic(1, b'') + packed(message(LARGEST)) * 100,
        'packed topics': packed(b''.join(topic(k, b'[]') for k in range(65_536))),
        'topics': b''.join(topic(k, b'[]') for k in range(8000)),
        'values in QoS': b''.join(topic(k, b'[' + b'[],' * 20_000 + b']') for k in range(5)),
        'keys': record(12, text(b'x') + mapping((b'%d' % k, b'') for k in range(40_000))),
        'large messages': topic(1, b'') + message(LARGEST) * 2,
        'large chunks': topic(1, b'') + packed(message(LARGEST)[:31] + os.urandom(LARGEST)) * 2,
        'large text': described(b'x' * 3_000_000),
        'list': described(b'- b\n' * (MB // 4)),
    }


def test_no_bag_costs_much_time_or_memory(bag: Path, tmp_path: Path) -> None:
    whole = (bag / 'bag_0.mcap').read_bytes()
    begin = 8 + 9 + int.from_bytes(whole[9:17], 'little')  # behind the magic and the header
    for name, bomb in bombs().items():
        folder = shutil.copytree(bag, tmp_path / name)
        (folder / 'bag_0.mcap').write_bytes(whole[:begin] + SCHEMA + bomb + whole[begin:])
    metadata = (bag / 'metadata.yaml').read_bytes()
    for name, bomb in {'aliases': aliases(200), 'large': b'x' * 5_000_000}.items():
        folder = shutil.copytree(bag, tmp_path / name)
        (folder / 'metadata.yaml').write_bytes(metadata + b'\n' + bomb)
    run_fuzz('cost', *sorted(tmp_path.iterdir()))


# What is no file, or not in the folder.


@pytest.mark.parametrize('name', ['bag_0.mcap', 'metadata.yaml', 'bag_1.mcap'])
@pytest.mark.parametrize('kind', ['pipe', 'device', 'link'])
def test_what_is_no_file_is_told_at_once(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, kind: str
) -> None:
    folder = shutil.copytree(bag, tmp_path / 'bag')
    (folder / name).unlink(missing_ok=True)
    if kind == 'pipe':
        os.mkfifo(folder / name)
    else:
        (folder / name).symlink_to('/dev/zero' if kind == 'device' else bag / name)
    with pytest.raises((FileNotFoundError, ValueError), match='bag') as raised:
        read_run(folder)
    assert '\n' not in str(raised.value)
    code = main([str(folder)])
    said = capsys.readouterr()
    if name == 'metadata.yaml':
        assert code == 0
        assert 'metadata.yaml is new' in said.out
    else:
        assert code == 2
        assert f'{name} must be a file in the bag' in said.err


@pytest.mark.parametrize('kind', ['pipe', 'device'])
def test_bag_that_is_no_folder_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    path = tmp_path / 'bag' if kind == 'pipe' else Path('/dev/zero')
    if kind == 'pipe':
        os.mkfifo(path)
    assert main([str(path)]) == 2
    assert 'is a file; give the folder it is in' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('old', 'new'),
    [
        ('version: 9', 'version: nine'),
        ('nanoseconds: 1900000000', 'nanoseconds: {}'),
        ('message_count: 61', 'message_count: []'),
        ('name: /sheep', 'name: [a]'),
        ('type: sensor_msgs/msg/PointCloud2', 'type: {a: b}'),
        ('offered_qos_profiles: []', 'offered_qos_profiles: 3'),
        ('- bag_0.mcap', '- {bag_0.mcap: x}'),
        ('path: bag_0.mcap', 'path: []'),
        ("compression_mode: ''", 'compression_mode: []'),
    ],
)
def test_values_of_wrong_types_are_told_by_name(
    bag: Path, tmp_path: Path, old: str, new: str
) -> None:
    folder = shutil.copytree(bag, tmp_path / 'bag')
    file = folder / 'metadata.yaml'
    content = file.read_text()
    assert old in content
    file.write_text(content.replace(old, new, 1))
    key = 'relative_file_paths' if old.startswith('-') else old.partition(':')[0]
    with pytest.raises(ValueError, match=f'metadata.yaml does not describe a bag: {key} ') as told:
        read_run(folder)
    assert '\n' not in str(told.value)
    assert recover(folder).new_metadata
    assert file.read_text() == content


@pytest.mark.parametrize('custom_data', ['3', '[1, 2]', '{parameters: [1]}', '{[a]: b}'])
def test_custom_data_of_wrong_types_break_nothing(
    bag: Path, tmp_path: Path, custom_data: str
) -> None:
    folder = shutil.copytree(bag, tmp_path / 'bag')
    file = folder / 'metadata.yaml'
    begin, rest = file.read_text().split('  custom_data:\n')
    file.write_text(f'{begin}  custom_data: {custom_data}\n{rest[rest.index("  ros_distro") :]}')
    with suppress(ValueError):
        read_run(folder)
    assert recover(folder).new_metadata
    assert len(read_run(folder).times) == T
