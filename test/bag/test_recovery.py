# SPDX-License-Identifier: Apache-2.0
"""Bags that were cut off, damaged or made to do harm, and what `recover` makes of them.

What was recovered is judged by others: mcap's own reader with its index, and rosbags.
"""

from __future__ import annotations

import fcntl
import io
import json
import os
from pathlib import Path
import random
import re
import resource
import shutil
import struct
import subprocess
import sys
from typing import Any

from herding_ros.bag import recovery
from herding_ros.bag.cli import main
from herding_ros.bag.inspection import inspect, MOST_BYTES
from herding_ros.bag.reader import read_run
from herding_ros.bag.recovery import recover
from herding_ros.bag.writer import BagWriter
import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk, ChunkIndex, Message
from mcap.stream_reader import breakup_chunk, StreamReader
from mcap.writer import CompressionType, MCAP0_MAGIC, Writer
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
import yaml
import zstandard

HASH = 'RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18'
START = 1_700_000_000_000_000_000
STOCK = {'enable_crcs': False, 'chunk_size': 700, 'compression': CompressionType.NONE}
FOREVER = {'sec': 9223372036, 'nsec': 854775807}
PROFILE: dict[str, Any] = {
    'history': 'keep_last',
    'depth': 7,
    'reliability': 'best_effort',
    'durability': 'transient_local',
    'deadline': {**FOREVER},
    'lifespan': {**FOREVER},
    'liveliness': 'automatic',
    'liveliness_lease_duration': {**FOREVER},
    'avoid_ros_namespace_conventions': False,
}

Messages = list[tuple[str, int, bytes]]
"""Topic, log time [ns] and data of each message."""

READ: dict[tuple[tuple[str, bytes], ...], Messages] = {}
"""What rosbags has found in a bag, by the names and bytes of its files."""


def text_message(text: str) -> bytes:
    data = text.encode() + b'\0'
    return b'\0\1\0\0' + len(data).to_bytes(4, 'little') + data


def some_messages(count: int, size: int = 30) -> Messages:
    generator = random.Random(count)
    return [
        (f'/t{k % 3}', START + 1_000_000 * k,
         text_message(f'{k} {generator.randbytes(generator.randrange(size)).hex()}'))
        for k in range(count)
    ]  # fmt: skip


def write_bag(path: Path, messages: Messages, flush_every: int = 10, **limits: int) -> BagWriter:
    """A bag of ours that has not been closed; a topic without messages is in it as well."""
    bag = BagWriter(path, {'who': 'we'}, **limits)
    for topic in ('/t0', '/t1', '/t2', '/empty'):
        bag.add_topic(topic, 'std_msgs/msg/String', 'string data\n', [PROFILE], HASH)
    for k, (topic, time, data) in enumerate(messages):
        bag.write(topic, data, time, time - 250)
        if k % flush_every == flush_every - 1:
            bag.flush()
    return bag


def write_file(path: Path, messages: Messages, **options: Any) -> None:
    """A file as a stock `ros2 bag record -s mcap` writes it: without checksums of chunks."""
    with path.open('wb') as stream:
        writer = Writer(stream, **{**STOCK, **options})
        writer.start(profile='ros2', library='libmcap 1.3.1')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data\n')
        profiles = yaml.safe_dump([PROFILE])
        metadata = {'offered_qos_profiles': profiles, 'topic_type_hash': HASH}
        channels = {
            topic: writer.register_channel(topic, 'cdr', schema, metadata)
            for topic in ('/t0', '/t1', '/t2', '/empty')
        }
        for topic, time, data in messages:
            writer.add_message(channels[topic], time, data, time - 250)
        writer.finish()


def read_by_mcap(folder: Path) -> Messages:
    """All messages of all files, by their indexes."""
    messages: Messages = []
    for file in sorted(folder.glob('*.mcap')):
        with file.open('rb') as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            assert summary is not None
            assert summary.statistics is not None
            found = [
                (channel.topic, message.log_time, message.data)
                for _, channel, message in reader.iter_messages()
            ]
            assert summary.statistics.message_count == len(found)
            assert bool(summary.chunk_indexes) == bool(found)
            messages += found
    return messages


def read_by_rosbags(folder: Path) -> Messages:
    """All messages; those of the same bytes are read once, for rosbags reads YAML in Python."""
    content = tuple(
        (file.name, file.read_bytes())
        for file in sorted(folder.iterdir())
        if file.suffix != '.broken'
    )
    if content not in READ:
        READ[content] = _read_by_rosbags(folder)
    return READ[content]


def _read_by_rosbags(folder: Path) -> Messages:
    with AnyReader([folder]) as reader:
        messages = [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]
        assert reader.message_count == len(messages)
        for connection in reader.connections:
            count = sum(topic == connection.topic for topic, _, _ in messages)
            assert connection.msgcount == count
    return messages


def read(folder: Path) -> Messages:
    """What is in a bag, whoever reads it."""
    messages = read_by_rosbags(folder)
    assert read_by_mcap(folder) == messages
    return messages


def chunk_ends(file: Path) -> list[tuple[int, int]]:
    """Where each chunk of a whole file ends, and how many messages are in it and before."""
    with file.open('rb') as stream:
        records = list(StreamReader(stream, emit_chunks=True).records)
    ends, total = [], 0
    chunks = [record for record in records if isinstance(record, Chunk)]
    indexes = [record for record in records if isinstance(record, ChunkIndex)]
    for each, index in zip(chunks, indexes, strict=True):
        total += sum(isinstance(record, Message) for record in breakup_chunk(each))
        ends.append((index.chunk_start_offset + index.chunk_length, total))
    return ends


def killed(bag: BagWriter, path: Path) -> Path:
    """A copy of an open bag as a kill would leave it."""
    shutil.copytree(bag.path, path)
    bag.close()
    # The files keep the name of the bag they were written as.
    return path


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


# Bags without an end.


def test_bag_of_a_killed_recorder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    messages = some_messages(1005)
    bag = killed(write_bag(tmp_path / 'bag', messages), tmp_path / 'killed')
    before = (bag / 'bag_0.mcap').read_bytes()
    assert main([str(bag)]) == 0
    assert read(bag) == messages[:1000]
    assert (bag / 'bag_0.mcap.broken').read_bytes() == before
    assert sorted(bytes_of(bag)) == ['bag_0.mcap', 'bag_0.mcap.broken', 'metadata.yaml']
    out = capsys.readouterr().out
    assert 'bag_0.mcap: 1000 messages recovered' in out
    assert 'without an index' in out
    assert 'lost' not in out
    assert 'bag_0.mcap.broken' in out
    assert f'{bag} is whole: 1000 messages of 4 topics' in out


def test_metadata_is_what_close_would_have_written(tmp_path: Path) -> None:
    messages = some_messages(1000)
    bag = write_bag(tmp_path / 'bag', messages)
    dead = killed(bag, tmp_path / 'killed')
    recover(dead)
    expected = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())
    assert yaml.safe_load((dead / 'metadata.yaml').read_text()) == expected
    assert expected['rosbag2_bagfile_information']['custom_data'] == {'who': 'we'}
    # And so is the map in the file, from which `ros2 bag reindex` would restore it.
    with (dead / 'bag_0.mcap').open('rb') as stream:
        *_, record = make_reader(stream).iter_metadata()
    assert record.name == 'rosbag2'
    in_file = yaml.safe_load(record.metadata['serialized_metadata'])
    assert in_file == expected['rosbag2_bagfile_information']


def test_topics_keep_what_is_known_of_them(tmp_path: Path) -> None:
    dead = killed(write_bag(tmp_path / 'bag', some_messages(20)), tmp_path / 'killed')
    recover(dead)
    with (dead / 'bag_0.mcap').open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        assert yaml.safe_load(channel.metadata['offered_qos_profiles']) == [PROFILE]
        assert channel.metadata['topic_type_hash'] == HASH
        assert channel.message_encoding == 'cdr'
        schema = summary.schemas[channel.schema_id]
        assert (schema.name, schema.encoding) == ('std_msgs/msg/String', 'ros2msg')
        assert schema.data == b'string data\n'
    with (dead / 'bag_0.mcap').open('rb') as stream:
        for _, _, message in make_reader(stream).iter_messages():
            assert message.publish_time == message.log_time - 250


@pytest.fixture(autouse=True)
def no_waiting_for_disks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, 'fsync', lambda number: None)


@pytest.fixture(scope='module')
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Messages]:
    """A whole bag of two chunks in little more than 2 kB, and its messages."""
    messages = [('/t0', START + k, text_message(f'{k}')) for k in range(6)]
    path = tmp_path_factory.mktemp('small') / 'bag'
    with BagWriter(path) as bag:
        bag.add_topic('/t0', 'std_msgs/msg/String', 'string data\n', [], HASH)
        for k, (topic, time, data) in enumerate(messages):
            bag.write(topic, data, time, time - 250)
            if k == 2:
                bag.flush()
    return path, messages


def test_cut_at_any_byte(tmp_path: Path, small: tuple[Path, Messages]) -> None:
    bag, messages = small
    whole = (bag / 'bag_0.mcap').read_bytes()
    (first, three), (second, six) = chunk_ends(bag / 'bag_0.mcap')
    assert (three, six) == (3, 6)
    ends = [end + k for end in (first, second, len(whole) - 37, len(whole)) for k in (-1, 0, 1)]
    for length in sorted({*range(12), *range(12, len(whole), 7), *ends} - {len(whole) + 1}):
        cut = tmp_path / f'{length}'
        cut.mkdir()
        (cut / 'bag_0.mcap').write_bytes(whole[:length] + bytes(1000 * (length % 3 == 0)))
        (result,) = recover(cut).files
        expected = messages[: 6 if length >= second else 3 if length >= first else 0]
        assert read_by_mcap(cut) == expected, length
        for lost in re.findall('the ([0-9]+) bytes', ' '.join(result.faults)):
            assert int(lost) <= second - first  # and not what was reserved
        if length % 5 == 0:
            assert read_by_rosbags(cut) == expected, length
        shutil.rmtree(cut)


def test_any_bit_of_the_end_may_flip(tmp_path: Path, small: tuple[Path, Messages]) -> None:
    """All bits of the footer and the magic, one of each byte of the index and the summary."""
    bag, messages = small
    whole = (bag / 'bag_0.mcap').read_bytes()
    *_, (end, _) = chunk_ends(bag / 'bag_0.mcap')
    data_end = whole.rindex(struct.pack('<BQ', 15, 4))
    bits = random.Random(0)
    flips = [(place, bits.randrange(8)) for place in range(end, len(whole) - 37, 5)]
    flips += [(place, bit) for place in range(len(whole) - 37, len(whole)) for bit in range(8)]
    for place, bit in flips:
        data = bytearray(whole)
        data[place] ^= 1 << bit
        folder = shutil.copytree(bag, tmp_path / 'flipped')
        (folder / 'bag_0.mcap').write_bytes(data)
        recovery = recover(folder)
        assert read_by_mcap(folder) == messages, (place, bit)
        if place % 3 == 0 or place >= len(whole) - 37:
            assert read_by_rosbags(folder) == messages, (place, bit)
        # The text of the metadata record is the only part without a checksum.
        assert not recovery.was_whole or b'rosbag2' in whole[place - 2000 : place], (place, bit)
        assert not recovery.was_whole or place < data_end, (place, bit)
        shutil.rmtree(folder)


def test_any_bit_of_the_metadata_may_flip(tmp_path: Path, small: tuple[Path, Messages]) -> None:
    bag, messages = small
    whole = (bag / 'metadata.yaml').read_bytes()
    bits = random.Random(0)
    for place in range(0, len(whole), 5):
        data = bytearray(whole)
        data[place] ^= 1 << bits.randrange(8)
        folder = shutil.copytree(bag, tmp_path / 'flipped')
        (folder / 'metadata.yaml').write_bytes(data)
        recover(folder)
        assert (folder / 'metadata.yaml').read_bytes() == whole or read(folder) == messages
        assert inspect(folder / 'bag_0.mcap').faults == []
        shutil.rmtree(folder)


@pytest.mark.parametrize('compressed', [False, True])
def test_bags_of_another_writer(tmp_path: Path, compressed: bool) -> None:
    """Those of rosbags are whole, and recovered when a bit of their end flips."""
    writer = RosbagsWriter(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP)
    if compressed:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(
            '/t0', 'std_msgs/msg/String', msgdef='string data\n', rihs01=HASH
        )
        for k in range(10):
            writer.write(connection, START + k, text_message(f'{k}'))
    messages = [('/t0', START + k, text_message(f'{k}')) for k in range(10)]
    assert recover(tmp_path / 'bag').was_whole
    file = tmp_path / 'bag' / 'bag.mcap'
    whole = file.read_bytes()
    for place in range(len(whole) - 37, len(whole)):
        data = bytearray(whole)
        data[place] ^= 1 << place % 8
        file.write_bytes(data)
        assert not recover(tmp_path / 'bag').was_whole
        assert read(tmp_path / 'bag') == messages
        file.with_name('bag.mcap.broken').unlink()
        for kept in (tmp_path / 'bag').glob('metadata.yaml.broken'):
            kept.unlink()


@pytest.mark.parametrize(
    ('options', 'unit'),
    [
        ({'compression': CompressionType.NONE}, 'chunk'),
        ({'compression': CompressionType.ZSTD}, 'chunk'),
        ({'compression': CompressionType.LZ4}, 'chunk'),
        ({'compression': CompressionType.ZSTD, 'enable_crcs': True}, 'chunk'),
        ({'use_chunking': False}, 'message'),
    ],
)
def test_bags_of_a_stock_recorder(tmp_path: Path, options: dict[str, Any], unit: str) -> None:
    messages = some_messages(500)
    write_file(tmp_path / 'stock_0.mcap', messages, **options)
    whole = (tmp_path / 'stock_0.mcap').read_bytes()
    ends = chunk_ends(tmp_path / 'stock_0.mcap') if unit == 'chunk' else []
    generator = random.Random(0)
    for trial in range(3):
        folder = tmp_path / f'{trial}'
        folder.mkdir()
        length = generator.randrange(400, len(whole))
        (folder / 'stock_0.mcap').write_bytes(whole[:length])
        recover(folder)
        found = read(folder)
        assert found == messages[: len(found)]
        if unit == 'chunk':
            assert len(found) == max((count for end, count in ends if end <= length), default=0)
        else:
            taken = sum(len(data) + 31 for _, _, data in found)
            assert taken > length - 4000  # all but topics, the last message and the index
        with (folder / 'stock_0.mcap').open('rb') as stream:
            chunks = [r for r in StreamReader(stream, emit_chunks=True).records
                      if isinstance(r, Chunk)]  # fmt: skip
        name = {CompressionType.ZSTD: 'zstd', CompressionType.LZ4: 'lz4'}
        wanted = name.get(options.get('compression', CompressionType.NONE), '')
        assert {chunk.compression for chunk in chunks} <= {wanted}
        metadata = yaml.safe_load((folder / 'metadata.yaml').read_text())
        assert metadata['rosbag2_bagfile_information']['custom_data'] is None


def test_numbers_of_policies_become_names(tmp_path: Path) -> None:
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, ReliabilityPolicy

    kinds = {
        'history': HistoryPolicy,
        'reliability': ReliabilityPolicy,
        'durability': DurabilityPolicy,
        'liveliness': LivelinessPolicy,
    }
    profiles = [
        {**PROFILE, policy: int(value)} for policy, kind in kinds.items() for value in kind
    ]
    with (tmp_path / 'old_0.mcap').open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data\n')
        writer.register_channel(
            '/t', 'cdr', schema, {'offered_qos_profiles': json.dumps(profiles)}
        )
        writer.finish()
    recover(tmp_path)
    content = yaml.safe_load((tmp_path / 'metadata.yaml').read_text())
    (topic,) = content['rosbag2_bagfile_information']['topics_with_message_count']
    assert topic['topic_metadata']['offered_qos_profiles'] == [
        {**PROFILE, policy: value.name.lower()} for policy, kind in kinds.items() for value in kind
    ]


# Bags of several files.


def test_last_file_is_recovered_and_the_others_are_left_alone(tmp_path: Path) -> None:
    messages = some_messages(605)
    bag = write_bag(tmp_path / 'bag', messages, max_duration_ns=249_000_000)
    assert bag.file_count == 3
    dead = killed(bag, tmp_path / 'killed')
    before = bytes_of(dead)
    with pytest.raises(FileNotFoundError, match=r'not been closed.*does not list bag_2\.mcap'):
        read_run(dead)
    assert read_by_rosbags(dead) == messages[:500]  # what is in metadata.yaml until then
    first, second, third = recover(dead).files
    assert (first.faults, second.faults) == ([], [])
    assert [r.information.message_count for r in (first, second, third)] == [250, 250, 100]
    after = bytes_of(dead)
    assert after['bag_0.mcap'] == before['bag_0.mcap']
    assert after['bag_1.mcap'] == before['bag_1.mcap']
    assert after['bag_2.mcap.broken'] == before['bag_2.mcap']
    assert after['metadata.yaml.broken'] == before['metadata.yaml']
    assert read(dead) == messages[:600]
    content = yaml.safe_load(after['metadata.yaml'])['rosbag2_bagfile_information']
    assert [file['message_count'] for file in content['files']] == [250, 250, 100]
    assert content['custom_data'] == {'who': 'we'}


def test_files_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    messages = some_messages(1200)
    bag = write_bag(tmp_path / 'bag', messages, max_duration_ns=99_000_000)
    assert bag.file_count == 12
    bag.close()
    expected = (bag.path / 'metadata.yaml').read_text()
    (bag.path / 'metadata.yaml').unlink()
    assert not any(result.faults for result in recover(bag.path).files)
    assert (bag.path / 'metadata.yaml').read_text() == expected
    assert read_by_rosbags(bag.path) == messages


# Bags that were damaged.


def test_damage_costs_the_chunk_it_is_in_or_what_follows(tmp_path: Path) -> None:
    messages = some_messages(60)
    write_bag(tmp_path / 'bag', messages).close()
    ends = chunk_ends(tmp_path / 'bag' / 'bag_0.mcap')
    whole = (tmp_path / 'bag' / 'bag_0.mcap').read_bytes()
    for seed in range(20):
        generator = random.Random(seed)
        data = bytearray(whole)
        place = generator.randrange(400, ends[-1][0])
        new = generator.randbytes(generator.choice((1, 8, 300)))
        data[place : place + len(new)] = new
        folder = shutil.copytree(tmp_path / 'bag', tmp_path / f'{seed}')
        (folder / 'bag_0.mcap').write_bytes(data)
        recover(folder)
        found = read(folder)
        before = max((count for end, count in ends if end <= place), default=0)
        assert found[:before] == messages[:before]
        assert [message for message in messages if message in found] == found  # none is made up


def test_wrong_checksum_costs_one_chunk(tmp_path: Path) -> None:
    messages = some_messages(60)
    write_bag(tmp_path / 'bag', messages).close()
    file = tmp_path / 'bag' / 'bag_0.mcap'
    data = bytearray(file.read_bytes())
    data[data.index(messages[33][2]) + 10] ^= 1
    file.write_bytes(data)
    (result,) = recover(file.parent).files
    assert read(file.parent) == messages[:30] + messages[40:]
    assert 'checksum' in result.faults[0]
    assert re.match('the chunk of [0-9]{3,4} bytes at byte [0-9]+: its checksum', result.faults[0])


def test_topics_are_found_in_the_index_when_the_first_chunk_is_lost(tmp_path: Path) -> None:
    messages = some_messages(200)
    write_bag(tmp_path / 'bag', messages).close()
    file = tmp_path / 'bag' / 'bag_0.mcap'
    data = bytearray(file.read_bytes())
    place = data.index(messages[3][2])  # topics are in the same chunk
    data[place + 10] ^= 1
    file.write_bytes(data)
    (result,) = recover(tmp_path / 'bag').files
    assert read(tmp_path / 'bag') == messages[10:]
    (fault,) = result.faults
    assert 'checksum' in fault


def test_messages_of_lost_topics_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = some_messages(200)
    dead = killed(write_bag(tmp_path / 'bag', messages), tmp_path / 'killed')
    data = bytearray((dead / 'bag_0.mcap').read_bytes())
    data[data.index(messages[3][2]) + 10] ^= 1
    (dead / 'bag_0.mcap').write_bytes(data)
    assert main([str(dead)]) == 0
    assert read(dead) == []
    assert 'it lacks the topics of 190 messages' in capsys.readouterr().out


def test_times_are_those_of_the_messages_that_are_left(tmp_path: Path) -> None:
    messages = some_messages(50)
    bag = write_bag(tmp_path / 'bag', messages)
    bag.add_topic('/late', 'std_msgs/msg/Late', 'string data\n', [PROFILE], '')
    late = ('/late', START + 25_500_000, text_message('late'))
    bag.write('/late', late[2], late[1], late[1])
    bag.flush()
    dead = killed(bag, tmp_path / 'killed')
    data = bytearray((dead / 'bag_0.mcap').read_bytes())
    data[data.index(messages[3][2]) + 10] ^= 1  # the chunk with the other topics
    (dead / 'bag_0.mcap').write_bytes(data)
    recover(dead)
    assert read(dead) == [late]
    with AnyReader([dead]) as reader:
        assert (reader.start_time, reader.duration) == (late[1], 1)
    assert recover(dead).was_whole


def test_chunk_without_checksum_is_kept_or_left_out_as_a_whole(tmp_path: Path) -> None:
    messages = some_messages(200)
    write_file(tmp_path / 'stock_0.mcap', messages, chunk_size=5000)
    data = bytearray((tmp_path / 'stock_0.mcap').read_bytes())
    place = data.index(messages[100][2]) - 31  # the head of its record
    data[place : place + 9] = b'\xff' * 9
    (tmp_path / 'stock_0.mcap').write_bytes(data)
    (result,) = recover(tmp_path).files
    found = read(tmp_path)
    assert re.match('the chunk of [0-9]{4} bytes at byte [0-9]+: ', result.faults[0])
    missing = [k for k, message in enumerate(messages) if message not in found]
    assert missing == list(range(missing[0], missing[-1] + 1))
    assert 10 < len(missing) < 100


def test_index_that_lies_is_damage(tmp_path: Path) -> None:
    messages = some_messages(100)
    write_bag(tmp_path / 'bag', messages).close()
    file = tmp_path / 'bag' / 'bag_0.mcap'
    with file.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    index = summary.chunk_indexes[3]
    builder = RecordBuilder()
    index.write(builder)
    old = builder.end()
    index.chunk_start_offset += 1
    index.write(builder)
    file.write_bytes(file.read_bytes().replace(old, builder.end()))
    with pytest.raises(ValueError, match=r'index.*recover it by'):
        read_run(tmp_path / 'bag')
    recover(tmp_path / 'bag')
    assert read(tmp_path / 'bag') == messages


@pytest.mark.parametrize('kind', [3, 4])
def test_type_or_topic_after_its_messages_is_damage(tmp_path: Path, kind: int) -> None:
    messages = some_messages(100)
    file = tmp_path / 'stock_0.mcap'
    write_file(file, messages, use_chunking=False)
    data = file.read_bytes()
    begin, end = record_at(data, kind)
    data_end = data.rindex(struct.pack('<BQ', 15, 4))
    file.write_bytes(data[:begin] + data[end:data_end] + data[begin:end] + data[data_end:])
    assert inspect(file).faults == ['its index is not that of its data']
    recover(tmp_path)
    assert read(tmp_path) == messages


def record_at(data: bytes, kind: int) -> tuple[int, int]:
    """Where the first record of a kind is."""
    begin = 8
    while True:
        end = begin + 9 + int.from_bytes(data[begin + 1 : begin + 9], 'little')
        if data[begin] == kind:
            return begin, end
        begin = end


def test_whole_bag_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    messages = some_messages(600)
    write_bag(tmp_path / 'bag', messages, max_duration_ns=249_000_000).close()
    before = {file: (file.stat(), file.read_bytes()) for file in (tmp_path / 'bag').iterdir()}
    assert main([str(tmp_path / 'bag')]) == 0
    after = {file: (file.stat(), file.read_bytes()) for file in (tmp_path / 'bag').iterdir()}
    assert {f: (s.st_ino, s.st_mtime_ns, d) for f, (s, d) in before.items()} == {
        f: (s.st_ino, s.st_mtime_ns, d) for f, (s, d) in after.items()
    }
    assert 'was whole: 600 messages of 4 topics; nothing was changed' in capsys.readouterr().out


def test_whole_bag_of_a_stock_recorder_only_gets_its_metadata(tmp_path: Path) -> None:
    for options in ({}, {'use_chunking': False}, {'compression': CompressionType.ZSTD}):
        folder = tmp_path / f'{len(options)}{options}'
        folder.mkdir()
        write_file(folder / 'stock_0.mcap', some_messages(300), **options)
        before = (folder / 'stock_0.mcap').read_bytes()
        result = recover(folder)
        assert result.new_metadata
        assert (folder / 'stock_0.mcap').read_bytes() == before
        assert read_by_rosbags(folder) == some_messages(300)


def test_second_recovery_has_nothing_to_do(tmp_path: Path) -> None:
    dead = killed(write_bag(tmp_path / 'bag', some_messages(105)), tmp_path / 'killed')
    recover(dead)
    before = bytes_of(dead)
    assert recover(dead).was_whole
    assert bytes_of(dead) == before


# What is not a bag, or is not to be touched.


@pytest.mark.parametrize(
    ('what', 'said'),
    [
        ('nothing', 'does not exist'),
        ('file', 'is a file; give the folder it is in'),
        ('empty', 'is not a bag in mcap: it has no .mcap file'),
        ('sqlite3', 'is not a bag in mcap: it has no .mcap file'),
        ('text', 'text_0.mcap is not an mcap file'),
    ],
)
def test_what_is_no_bag_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str, said: str
) -> None:
    target = tmp_path / what
    if what == 'file':
        target.write_bytes(MCAP0_MAGIC)
    elif what != 'nothing':
        target.mkdir()
    if what == 'sqlite3':
        (target / 'bag_0.db3').write_bytes(b'SQLite format 3\0')
    if what == 'text':
        (target / 'text_0.mcap').write_text('something else')
    before = sorted(tmp_path.rglob('*'))
    assert main([str(target)]) == 2
    assert said in capsys.readouterr().err
    assert sorted(tmp_path.rglob('*')) == before


def test_bag_that_is_being_recorded_is_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = some_messages(100)
    bag = write_bag(tmp_path / 'bag', messages)
    assert main([str(bag.path)]) == 2
    assert 'is being recorded; end the recorder first' in capsys.readouterr().err
    bag.close()
    assert read(bag.path) == messages


def test_locks_end_with_the_process(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', some_messages(10))
    with (bag.path / 'bag_0.mcap').open('rb') as stream:
        with pytest.raises(BlockingIOError):
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        bag.close()
        fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)


@pytest.mark.parametrize('name', ['bag_0.mcap.broken', 'metadata.yaml.broken'])
def test_nothing_is_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    dead = killed(write_bag(tmp_path / 'bag', some_messages(100)), tmp_path / 'killed')
    (dead / 'metadata.yaml').write_text('of old')
    (dead / name).write_text('precious')
    before = bytes_of(dead)
    assert main([str(dead)]) == 2
    assert f'{name} exists already and is not overwritten; move it away' in capsys.readouterr().err
    assert bytes_of(dead) == before


class Interrupted(io.FileIO):
    """A file whose reading is interrupted after a number of calls, in all files together."""

    left = 0

    def read(self, size: int | None = -1, /) -> bytes:
        type(self).left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().read(size)


def test_recovery_may_be_interrupted_at_any_time(tmp_path: Path) -> None:
    messages = some_messages(30)
    bag = write_bag(tmp_path / 'bag', messages, max_duration_ns=14_000_000)
    dead = killed(bag, tmp_path / 'killed')
    (dead / 'bag_0.mcap').write_bytes((dead / 'bag_0.mcap').read_bytes()[:-20])
    interrupted = 0
    for calls in range(0, 100_000, 29):
        folder = shutil.copytree(dead, tmp_path / f'{calls}')
        Interrupted.left = calls
        try:
            recover(folder, Interrupted)  # type: ignore[arg-type]
        except KeyboardInterrupt:
            interrupted += 1
        else:
            break
        recover(folder)
        assert read_by_mcap(folder) == messages
        assert not list(folder.glob('*.partial'))
    assert interrupted > 4


def test_kill_between_two_renames_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages = some_messages(105)
    dead = killed(write_bag(tmp_path / 'bag', messages), tmp_path / 'killed')
    before = (dead / 'bag_0.mcap').read_bytes()
    keep = recovery._keep

    def die(path: Path) -> Path:
        keep(path)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(recovery, '_keep', die)
        with pytest.raises(KeyboardInterrupt):
            recover(dead)
    assert (dead / 'bag_0.mcap.broken').read_bytes() == before
    recover(dead)
    assert read(dead) == messages[:100]
    assert (dead / 'bag_0.mcap.broken').read_bytes() == before


def test_full_disk_leaves_the_bag_as_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = some_messages(20_000)
    dead = killed(write_bag(tmp_path / 'bag', messages, 1000), tmp_path / 'killed')
    before = bytes_of(dead)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, hard))
    try:
        assert main([str(dead)]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert 'File too large' in capsys.readouterr().err
    assert bytes_of(dead) == before
    recover(dead)
    assert read(dead) == messages


# Bags that were made to do harm.


def test_nothing_outside_of_the_folder_is_read_or_written(tmp_path: Path) -> None:
    messages = some_messages(105)
    dead = killed(write_bag(tmp_path / 'bag', messages), tmp_path / 'killed')
    (tmp_path / 'precious').write_text('precious')
    for name in ('metadata.yaml.partial', 'bag_0.mcap.partial', 'metadata.yaml'):
        (dead / name).symlink_to(tmp_path / 'precious')
    recover(dead)
    assert (tmp_path / 'precious').read_text() == 'precious'
    assert read(dead) == messages[:100]
    assert not (dead / 'metadata.yaml').is_symlink()


@pytest.mark.parametrize(
    'path', ['../stranger/stranger_0.mcap', '/etc/passwd', '..', '{absolute}']
)
def test_paths_in_metadata_lead_nowhere(tmp_path: Path, path: str) -> None:
    messages = some_messages(100)
    write_bag(tmp_path / 'stranger', some_messages(50)).close()
    write_bag(tmp_path / 'bag', messages).close()
    before = bytes_of(tmp_path / 'stranger')
    metadata = tmp_path / 'bag' / 'metadata.yaml'
    path = path.format(absolute=tmp_path / 'stranger' / 'stranger_0.mcap')
    metadata.write_text(metadata.read_text().replace('bag_0.mcap', path))
    with pytest.raises((FileNotFoundError, ValueError), match=r'not been closed|missing'):
        read_run(tmp_path / 'bag')
    recover(tmp_path / 'bag')
    assert read(tmp_path / 'bag') == messages
    assert bytes_of(tmp_path / 'stranger') == before


def test_links_to_data_are_not_followed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dead = killed(write_bag(tmp_path / 'bag', some_messages(10)), tmp_path / 'killed')
    (tmp_path / 'links').mkdir()
    (tmp_path / 'links' / 'bag_0.mcap').symlink_to(dead / 'bag_0.mcap')
    before = bytes_of(dead)
    assert main([str(tmp_path / 'links')]) == 2
    assert 'must be a file in the bag' in capsys.readouterr().err
    assert bytes_of(dead) == before


EVIL = "!!python/object/apply:os.system ['touch {}']"


def test_no_yaml_runs_code(tmp_path: Path) -> None:
    trace = tmp_path / 'trace'
    evil = EVIL.format(trace)
    messages = some_messages(20)
    with (tmp_path / 'evil_0.mcap').open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        writer.add_metadata('rosbag2', {'serialized_metadata': evil})
        writer.add_metadata('rosbag2', {'serialized_metadata': f'custom_data: {evil}'})
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data\n')
        channels = {
            topic: writer.register_channel(topic, 'cdr', schema, {'offered_qos_profiles': ''})
            for topic in ('/t0', '/t1', '/t2')
        }
        channels['/evil'] = writer.register_channel(
            '/evil', 'cdr', schema, {'offered_qos_profiles': evil, 'topic_type_hash': evil}
        )
        for topic, time, data in messages:
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
    for text in (evil, f'rosbag2_bagfile_information: {evil}', '[' * 100_000):
        (tmp_path / 'metadata.yaml').write_text(text)
        with pytest.raises(ValueError, match='does not describe a bag'):
            read_run(tmp_path)
    file = tmp_path / 'evil_0.mcap'
    file.write_bytes(file.read_bytes()[:-30])
    recover(tmp_path)
    assert not trace.exists()
    assert read_by_mcap(tmp_path) == messages


def record(kind: int, content: bytes, length: int | None = None) -> bytes:
    return struct.pack('<BQ', kind, len(content) if length is None else length) + content


def text(value: bytes, length: int | None = None) -> bytes:
    return struct.pack('<I', len(value) if length is None else length) + value


def chunk(data: bytes, size: int, compression: bytes, length: int | None = None) -> bytes:
    head = struct.pack('<QQQI', 0, 0, size, 0) + text(compression)
    stored = len(data) if length is None else length
    return record(6, head + struct.pack('<Q', stored) + data)


HUGE = 2**40
NAME = text(b'x')


@pytest.fixture(scope='module')
def hostile_records() -> dict[str, bytes]:
    bomb = zstandard.compress(bytes(400 * 2**20))
    return {
        'record': record(6, b'', HUGE),
        'record beyond 64 bits': record(6, b'', 2**64 - 1),
        'chunk of a huge size': chunk(b'', HUGE, b'zstd'),
        'chunk of a large size': chunk(b'', MOST_BYTES + 1, b''),
        'chunk data': chunk(b'', 10, b'', HUGE),
        'chunk of an unknown kind': chunk(b'xy', 2, b'bz2'),
        'zstd bomb': chunk(bomb, 1000, b'zstd'),
        'zstd bomb that says so': chunk(bomb, HUGE, b'zstd'),
        'lz4 bomb': chunk(lz4.frame.compress(bytes(400 * 2**20)), 1000, b'lz4'),
        'no zstd': chunk(b'no such thing', 1000, b'zstd'),
        'no lz4': chunk(b'no such thing', 1000, b'lz4'),
        'text': record(3, struct.pack('<H', 1) + text(b'', 2**32 - 1)),
        'map': record(4, struct.pack('<HH', 1, 1) + NAME + NAME + struct.pack('<I', 2**32 - 1)),
        'metadata': record(12, NAME + struct.pack('<I', 2**32 - 1)),
        'attachment': record(9, struct.pack('<QQ', 0, 0) + NAME + NAME + struct.pack('<Q', 2**63)),
        'short message': record(5, b'x'),
        'statistics': record(11, bytes(42) + struct.pack('<I', 2**32 - 1)),
        'index of messages': record(7, struct.pack('<HI', 1, 2**32 - 1)),
        'index of chunks': record(8, bytes(32) + struct.pack('<I', 2**32 - 1)),
        'unknown kind': record(0x50, b'x' * 100),
        'zeros': bytes(10_000),
    }


def test_absurd_sizes_take_no_memory(tmp_path: Path, hostile_records: dict[str, bytes]) -> None:
    """In a process of its own, which has memory for little more than the programs."""
    messages = some_messages(40)
    write_bag(tmp_path / 'bag', messages).close()
    data = (tmp_path / 'bag' / 'bag_0.mcap').read_bytes()
    (place, _), *_ = chunk_ends(tmp_path / 'bag' / 'bag_0.mcap')
    folders: list[Path] = []
    for name, hostile in hostile_records.items():
        for each in (hostile, chunk(zstandard.compress(hostile), len(hostile), b'zstd')):
            folders.append(tmp_path / f'{name} {len(folders)}')
            folders[-1].mkdir()
            file = folders[-1] / 'bag_0.mcap'
            file.write_bytes(data[:place] + each + data[place:])
            assert inspect(file).faults != []
    program = (
        'import pathlib, resource, sys; from herding_ros.bag.recovery import recover; '
        'resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30)); '
        '[recover(pathlib.Path(folder)) for folder in sys.argv[1:]]'
    )
    result = subprocess.run(
        [sys.executable, '-c', program, *map(str, folders)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    for folder in folders:
        assert read_by_mcap(folder) in (messages, messages[:10]), folder


def test_files_without_rhyme_or_reason(tmp_path: Path, hostile_records: dict[str, bytes]) -> None:
    generator = random.Random(0)
    for trial in range(50):
        folder = tmp_path / f'{trial}'
        folder.mkdir()
        kinds = generator.choices([*hostile_records.values(), generator.randbytes(50)], k=4)
        (folder / 'x_0.mcap').write_bytes(MCAP0_MAGIC + b''.join(kinds)[:100_000])
        recover(folder)
        assert read_by_mcap(folder) == []
        shutil.rmtree(folder)


def test_messages_that_hold_a_bag_are_messages(tmp_path: Path) -> None:
    write_bag(tmp_path / 'inner', some_messages(100)).close()
    inner = (tmp_path / 'inner' / 'inner_0.mcap').read_bytes()
    messages = [('/t0', START + k, b'\0\1\0\0' + inner) for k in range(10)]
    dead = killed(write_bag(tmp_path / 'bag', messages), tmp_path / 'killed')
    recover(dead)
    assert read_by_mcap(dead) == messages


# The program.


def test_program(tmp_path: Path) -> None:
    dead = killed(write_bag(tmp_path / 'bag', some_messages(105)), tmp_path / 'killed')
    command = [sys.executable, '-m', 'herding_ros.bag.cli']
    shown = subprocess.run([*command, '--help'], capture_output=True, text=True, check=True)
    assert 'NAME.mcap.broken' in shown.stdout
    done = subprocess.run([*command, str(dead)], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert '100 messages recovered' in done.stdout
    assert 'metadata.yaml is new' in done.stdout
    assert done.stderr == ''
    refused = subprocess.run([*command, '/nowhere'], capture_output=True, text=True, check=False)
    assert (refused.returncode, refused.stdout) == (2, '')
    assert refused.stderr == 'recover: /nowhere does not exist\n'


def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    import tracemalloc

    messages = [('/t0', START + k, bytes(100_000)) for k in range(400)]  # 40 MB
    dead = killed(write_bag(tmp_path / 'bag', messages), tmp_path / 'killed')
    tracemalloc.start()
    recover(dead)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20e6
    assert len(read_by_mcap(dead)) == 400


def test_inspection_of_a_whole_file_agrees_with_the_writer(tmp_path: Path) -> None:
    with write_bag(tmp_path / 'bag', some_messages(500)) as bag:
        pass
    found = inspect(bag.path / 'bag_0.mcap')
    assert found.faults == []
    assert found.information.counts == bag.topics
    assert found.information.first_ns == START
    assert found.information.last_ns == START + 499_000_000
