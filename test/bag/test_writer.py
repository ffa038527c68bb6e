# SPDX-License-Identifier: Apache-2.0
"""Our bags, read by others: the mcap reader, rosbags, YAML 1.2 as yaml-cpp understands it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
import errno
from pathlib import Path
import random
import re
import resource
import shutil
from typing import Any

from herding_ros.bag import inspection, writer
from herding_ros.bag.inspection import inspect, MOST_BYTES
from herding_ros.bag.recovery import recover
from herding_ros.bag.writer import BagWriter, CHUNK_SIZE, LARGEST_MESSAGE, RESERVE
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader, McapReader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from ruamel.yaml import YAML

FOREVER = {'sec': 9223372036, 'nsec': 854775807}
PROFILE: dict[str, Any] = {
    'history': 'keep_last',
    'depth': 7,
    'reliability': 'best_effort',
    'durability': 'transient_local',
    'deadline': FOREVER,
    'lifespan': FOREVER,
    'liveliness': 'automatic',
    'liveliness_lease_duration': FOREVER,
    'avoid_ros_namespace_conventions': False,
}
RELIABLE = {**PROFILE, 'reliability': 'reliable', 'durability': 'volatile', 'depth': 0,
            'history': 'unknown'}  # fmt: skip
HASH = 'RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18'
START = 1_700_000_000_000_000_000


def text_message(text: str) -> bytes:
    """A std_msgs/String in little-endian CDR."""
    data = text.encode() + b'\0'
    return b'\0\1\0\0' + len(data).to_bytes(4, 'little') + data


def write_bag(path: Path, count: int = 5, **kwargs: Any) -> dict[str, list[tuple[int, bytes]]]:
    """Two topics in turn, and one without messages. Returns their times and data."""
    written: dict[str, list[tuple[int, bytes]]] = {'/a': [], '/b': [], '/empty': []}
    with BagWriter(path, **kwargs) as bag:
        bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [PROFILE, RELIABLE], HASH)
        bag.add_topic('/b', 'std_msgs/msg/String', 'string data\n', [RELIABLE], HASH)
        bag.add_topic('/empty', 'std_msgs/msg/String', 'string data\n', [], HASH)
        for k in range(count):
            topic = '/b' if k % 2 else '/a'
            message = START + 1_000_000 * k, text_message(f'message {k} ' + 'x' * (k % 50))
            bag.write(topic, message[1], message[0], message[0] - 250)
            written[topic].append(message)
    return written


def load(path: Path) -> Any:
    """The map of a bag, read with YAML 1.2 rules as yaml-cpp does."""
    return YAML(typ='safe', pure=True).load(path / 'metadata.yaml')['rosbag2_bagfile_information']


@pytest.fixture
def mcap_file(tmp_path: Path) -> Iterator[McapReader]:
    write_bag(tmp_path / 'bag', custom_data={'key': 'value'})
    with (tmp_path / 'bag' / 'bag_0.mcap').open('rb') as stream:
        yield make_reader(stream, validate_crcs=True)


def test_every_byte_and_time_comes_back_from_mcap(tmp_path: Path) -> None:
    written = write_bag(tmp_path / 'bag', count=3000)
    read: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in written}
    with (tmp_path / 'bag' / 'bag_0.mcap').open('rb') as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.name, schema.encoding) == ('std_msgs/msg/String', 'ros2msg')
            assert channel.message_encoding == 'cdr'
            assert message.publish_time == message.log_time - 250
            read[channel.topic].append((message.log_time, message.data))
    assert read == written


def test_every_byte_comes_back_from_rosbags(tmp_path: Path) -> None:
    written = write_bag(tmp_path / 'bag', count=3000)
    read: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in written}
    with AnyReader([tmp_path / 'bag']) as reader:
        for connection, time, data in reader.messages():
            read[connection.topic].append((time, bytes(data)))
            text: Any = reader.deserialize(data, connection.msgtype)
            assert text.data.startswith('message ')
        assert {c.topic: c.msgcount for c in reader.connections} == {
            topic: len(messages) for topic, messages in written.items()
        }
    assert read == written


def test_messages_of_one_instant_keep_their_order(tmp_path: Path) -> None:
    texts = [text_message(f'{k}') for k in range(20_000)]  # several chunks
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [], HASH)
        for text in texts:
            bag.write('/a', text, START, START)
    with AnyReader([tmp_path / 'bag']) as reader:
        assert [bytes(data) for _, _, data in reader.messages()] == texts


def test_profile_and_index_are_what_play_needs(mcap_file: McapReader) -> None:
    assert mcap_file.get_header().profile == 'ros2'
    summary = mcap_file.get_summary()
    assert summary is not None
    # `ros2 bag play` asks for messages in the order of time and gets it from these.
    assert all(chunk.message_index_length > 0 for chunk in summary.chunk_indexes)
    assert summary.statistics is not None
    assert summary.statistics.message_count == 5
    assert summary.statistics.message_start_time == START


def test_channels_carry_profiles_and_type_hash(mcap_file: McapReader) -> None:
    summary = mcap_file.get_summary()
    assert summary is not None
    metadata = {channel.topic: channel.metadata for channel in summary.channels.values()}
    assert set(metadata) == {'/a', '/b', '/empty'}
    for topic, profiles in (('/a', [PROFILE, RELIABLE]), ('/b', [RELIABLE]), ('/empty', [])):
        assert set(metadata[topic]) == {'offered_qos_profiles', 'topic_type_hash'}
        loaded = YAML(typ='safe', pure=True).load(metadata[topic]['offered_qos_profiles'])
        assert loaded == profiles
        assert metadata[topic]['topic_type_hash'] == HASH


def test_metadata_is_complete(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', count=5, custom_data={'key': 'value'})
    start, duration = {'nanoseconds_since_epoch': START}, {'nanoseconds': 4_000_000}
    assert load(tmp_path / 'bag') == {
        'version': 9,
        'storage_identifier': 'mcap',
        'duration': duration,
        'starting_time': start,
        'message_count': 5,
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': name,
                    'type': 'std_msgs/msg/String',
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': profiles,
                    'type_description_hash': HASH,
                },
                'message_count': count,
            }
            for name, profiles, count in (
                ('/a', [PROFILE, RELIABLE], 3),
                ('/b', [RELIABLE], 2),
                ('/empty', [], 0),
            )
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': ['bag_0.mcap'],
        'files': [
            {
                'path': 'bag_0.mcap',
                'starting_time': start,
                'duration': duration,
                'message_count': 5,
            }
        ],
        'custom_data': {'key': 'value'},
        'ros_distro': 'jazzy',
    }


def test_metadata_has_no_aliases_and_no_folded_lines(tmp_path: Path) -> None:
    long = 'word ' * 200
    write_bag(tmp_path / 'bag', custom_data={'long': long})
    text = (tmp_path / 'bag' / 'metadata.yaml').read_text()
    assert not re.search(r'[:-] [&*]', text)
    assert long in text


def test_last_record_in_the_file_equals_metadata_yaml(
    tmp_path: Path, mcap_file: McapReader
) -> None:
    # What `ros2 bag reindex` restores metadata.yaml from.
    records = [record for record in mcap_file.iter_metadata() if record.name == 'rosbag2']
    restored = YAML(typ='safe', pure=True).load(records[-1].metadata['serialized_metadata'])
    assert restored == load(tmp_path / 'bag')


def test_metadata_has_the_layout_of_another_writer(tmp_path: Path) -> None:
    forever = QosTime(**FOREVER)
    qos = Qos(
        QosHistory.KEEP_LAST, 7, QosReliability.BEST_EFFORT, QosDurability.TRANSIENT_LOCAL,
        forever, forever, QosLiveliness.AUTOMATIC, forever, False,
    )  # fmt: skip
    with Writer(tmp_path / 'other', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(
            '/a', 'std_msgs/msg/String', msgdef='string data\n', rihs01=HASH,
            offered_qos_profiles=[qos],
        )  # fmt: skip
        writer.write(connection, START, text_message('x'))
        writer.set_custom_data('key', 'value')
    with BagWriter(tmp_path / 'ours', {'key': 'value'}) as bag:
        bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [PROFILE], HASH)
        bag.write('/a', text_message('x'), START, START)

    def anonymous(path: Path) -> dict[str, Any]:
        data: dict[str, Any] = load(path)
        data['relative_file_paths'] = data['files'][0]['path'] = data['ros_distro'] = None
        return data

    assert anonymous(tmp_path / 'ours') == anonymous(tmp_path / 'other')


def test_rosbags_understands_the_profiles(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag')
    with Reader(tmp_path / 'bag') as reader:
        profiles = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert [p.reliability for p in profiles['/a']] == [
        QosReliability.BEST_EFFORT,
        QosReliability.RELIABLE,
    ]
    assert profiles['/a'][0].durability == QosDurability.TRANSIENT_LOCAL
    assert profiles['/a'][1].history == QosHistory.UNKNOWN


@pytest.mark.parametrize(
    'text',
    ['', 'true', '1.0', 'null', '~', 'a: b', "it's", 'two\nlines\n', ' spaces ', '{"a": [1]}',
     'π ≠ 3', '# no comment', '- item', '\t', 'x' * 5000],
)  # fmt: skip
def test_custom_data_stay_the_same_text(tmp_path: Path, text: str) -> None:
    write_bag(tmp_path / 'bag', custom_data={'key': text, text or 'empty': 'key'})
    assert load(tmp_path / 'bag')['custom_data'] == {'key': text, text or 'empty': 'key'}


def test_custom_data_may_come_late_and_survive_without_close(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / 'bag', {'key': 'old'})
    bag.set_custom_data({'key': 'new'})
    shutil.copytree(tmp_path / 'bag', tmp_path / 'killed')
    bag.close()
    assert load(tmp_path / 'bag')['custom_data'] == {'key': 'new'}
    assert b'key: new' in (tmp_path / 'killed' / 'bag_0.mcap').read_bytes()


def test_without_close_all_but_the_last_chunk_is_on_disk(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / 'bag')
    bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [], HASH)
    texts = [text_message(f'{k:090}') for k in range(5000)]
    for k, text in enumerate(texts):
        bag.write('/a', text, START + k, START)
    shutil.copytree(tmp_path / 'bag', tmp_path / 'killed')
    bag.close()
    found = []
    with (tmp_path / 'killed' / 'bag_0.mcap').open('rb') as stream, suppress(EndOfFile):
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Message):
                found.append(record.data)
    assert found == texts[: len(found)]
    assert sum(map(len, texts[len(found) :])) <= CHUNK_SIZE


def test_chunks_are_small(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', count=5000)
    with (tmp_path / 'bag' / 'bag_0.mcap').open('rb') as stream:
        records = list(StreamReader(stream, emit_chunks=True).records)
    chunks = [record for record in records if isinstance(record, Chunk)]
    assert len(chunks) > 2
    assert all(chunk.compression == '' for chunk in chunks)
    assert all(chunk.uncompressed_size <= CHUNK_SIZE + 1000 for chunk in chunks)


def test_exception_leaves_a_complete_bag(tmp_path: Path) -> None:
    with suppress(KeyboardInterrupt), BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [], HASH)
        bag.write('/a', text_message('x'), START, START)
        raise KeyboardInterrupt
    with AnyReader([tmp_path / 'bag']) as reader:
        assert reader.message_count == 1


def test_empty_bag_is_a_bag(tmp_path: Path) -> None:
    BagWriter(tmp_path / 'bag').close()
    with AnyReader([tmp_path / 'bag']) as reader:
        assert reader.message_count == 0
    assert load(tmp_path / 'bag')['custom_data'] is None


def test_second_close_does_nothing(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / 'bag')
    bag.close()
    before = (tmp_path / 'bag' / 'bag_0.mcap').read_bytes()
    bag.close()
    assert (tmp_path / 'bag' / 'bag_0.mcap').read_bytes() == before


@pytest.mark.parametrize('kind', ['folder', 'file', 'bag'])
def test_existing_target_is_refused_and_left_alone(tmp_path: Path, kind: str) -> None:
    path = tmp_path / 'bag'
    if kind == 'folder':
        path.mkdir()
    elif kind == 'file':
        path.write_text('precious')
    else:
        write_bag(path)
    before = sorted(tmp_path.rglob('*'))
    with pytest.raises(FileExistsError, match=r'bag exists already .* another path'):
        BagWriter(path)
    assert sorted(tmp_path.rglob('*')) == before


def test_target_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(OSError, match=r'cannot create the bag .*file/bag: Not a directory'):
        BagWriter(tmp_path / 'file' / 'bag')


def test_folders_above_are_made(tmp_path: Path) -> None:
    write_bag(tmp_path / 'runs' / 'today' / 'bag')
    assert (tmp_path / 'runs' / 'today' / 'bag' / 'bag_0.mcap').is_file()


def test_topics_are_checked(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [], HASH)
        with pytest.raises(ValueError, match="'/a' is in the bag"):
            bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [], HASH)
        with pytest.raises(KeyError):
            bag.write('/b', text_message('x'), START, START)
        assert bag.topics == {'/a': 0}


def test_duration_spans_times_in_any_order(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [], HASH)
        for time in (50, 20, 90, 30):
            bag.write('/a', text_message('x'), time, time)
        assert bag.message_count == 4
    data = load(tmp_path / 'bag')
    assert data['starting_time'] == {'nanoseconds_since_epoch': 20}
    assert data['duration'] == {'nanoseconds': 70}


def test_what_was_flushed_is_on_disk(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / 'bag')
    bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [], HASH)
    bag.flush()  # of nothing
    for k in range(7):
        bag.write('/a', text_message(f'{k}'), START + k, START)
        if k == 4:
            bag.flush()
            bag.flush()
    data = (tmp_path / 'bag' / 'bag_0.mcap').read_bytes()
    bag.close()
    assert [text_message(f'{k}') in data for k in range(7)] == [True] * 5 + [False] * 2
    with (tmp_path / 'bag' / 'bag_0.mcap').open('rb') as stream:
        records = list(StreamReader(stream, emit_chunks=True).records)
    assert len([record for record in records if isinstance(record, Chunk)]) == 2


@pytest.mark.parametrize('times', [(-1, 0), (0, -1), (2**63, 0), (0, 2**63)])
def test_times_that_are_none_are_refused(tmp_path: Path, times: tuple[int, int]) -> None:
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [], HASH)
        with pytest.raises(ValueError, match='must be 0 to 9223372036854775807'):
            bag.write('/a', text_message('x'), *times)
        bag.write('/a', text_message('y'), 2**63 - 1, 0)
    with AnyReader([tmp_path / 'bag']) as reader:
        assert [bytes(data) for _, _, data in reader.messages()] == [text_message('y')]


def test_message_that_could_not_be_read_back_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    margin = MOST_BYTES - LARGEST_MESSAGE
    monkeypatch.setattr(inspection, 'MOST_BYTES', 2 * margin)
    monkeypatch.setattr(writer, 'LARGEST_MESSAGE', margin)
    with BagWriter(tmp_path / 'bag') as bag:
        for k in range(100):  # the descriptions of topics are in the same chunk
            bag.add_topic(f'/{k}', f'a/msg/T{k}', 'string data\n' * 300, [PROFILE] * 3, HASH)
        largest = bytes(margin - 47)
        with pytest.raises(ValueError, match=f'at most {len(largest)} bytes, got {margin - 46}'):
            bag.write('/1', largest + b'x', START, START)
        bag.write('/1', largest, START, START)
        assert bag.message_count == 1
    assert inspect(tmp_path / 'bag' / 'bag_0.mcap').faults == []


# Bags of several files.


def numbered(count: int, period_ns: int = 1_000_000) -> list[tuple[str, int, bytes]]:
    return [
        ('/b' if k % 3 else '/a', START + period_ns * k, text_message(f'{k} ' + 'x' * (k % 90)))
        for k in range(count)
    ]


def write_numbered(
    path: Path, messages: list[tuple[str, int, bytes]], late: int = -1, **limits: int
) -> BagWriter:
    """An open bag; a third topic is added before message `late`."""
    bag = BagWriter(path, {'key': 'value'}, **limits)
    for topic in ('/a', '/b'):
        bag.add_topic(topic, 'std_msgs/msg/String', 'string data\n', [PROFILE], HASH)
    for k, (topic, time, data) in enumerate(messages):
        if k == late:
            bag.add_topic('/late', 'std_msgs/msg/String', 'string data\n', [RELIABLE], HASH)
        bag.write(topic, data, time, time)
    return bag


def read_numbered(path: Path) -> list[tuple[str, int, bytes]]:
    with AnyReader([path]) as reader:
        return [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]


@pytest.mark.parametrize('limits', [{'max_size': 100_000}, {'max_duration_ns': 700_000_000}])
def test_nothing_is_lost_or_doubled_between_files(tmp_path: Path, limits: dict[str, int]) -> None:
    messages = numbered(5000)
    with write_numbered(tmp_path / 'bag', messages, late=2500, **limits) as bag:
        count = bag.file_count
    assert count > 4
    assert read_numbered(tmp_path / 'bag') == messages
    names = [f'bag_{k}.mcap' for k in range(count)]
    assert sorted(file.name for file in (tmp_path / 'bag').iterdir()) == sorted(
        [*names, 'metadata.yaml']
    )
    content = load(tmp_path / 'bag')
    assert content['relative_file_paths'] == names
    assert content['message_count'] == len(messages)
    assert content['starting_time'] == {'nanoseconds_since_epoch': START}
    assert content['duration'] == {'nanoseconds': 4_999_000_000}
    assert {
        topic['topic_metadata']['name']: topic['message_count']
        for topic in content['topics_with_message_count']
    } == {'/a': 1667, '/b': 3333, '/late': 0}
    together: list[tuple[str, int, bytes]] = []
    for name, information in zip(names, content['files'], strict=True):
        with (tmp_path / 'bag' / name).open('rb') as stream:
            reader = make_reader(stream, validate_crcs=True)
            part = [
                (channel.topic, message.log_time, message.data)
                for _, channel, message in reader.iter_messages()
            ]
            summary = reader.get_summary()
            assert summary is not None
            # Every file can be read by itself, and has all topics known until then.
            assert {c.topic for c in summary.channels.values()} >= {'/a', '/b'}
            assert summary.statistics is not None
            assert summary.statistics.message_count == len(part)
            *_, record = reader.iter_metadata()
        assert 'key: value' in record.metadata['serialized_metadata']
        assert information == {
            'path': name,
            'starting_time': {'nanoseconds_since_epoch': part[0][1]},
            'duration': {'nanoseconds': part[-1][1] - part[0][1]},
            'message_count': len(part),
        }
        together += part
    assert together == messages


def test_files_end_at_their_size(tmp_path: Path) -> None:
    with write_numbered(tmp_path / 'bag', numbered(20_000), max_size=300_000) as bag:
        assert bag.size > 1_500_000
    sizes = [file.stat().st_size for file in (tmp_path / 'bag').glob('*.mcap')]
    assert bag.size == sum(sizes)
    assert len(sizes) > 5
    assert max(sizes) < 310_000  # with what completes the file
    assert sorted(sizes)[1] > 290_000


def test_files_end_after_their_time(tmp_path: Path) -> None:
    messages = numbered(100, period_ns=10_000_000)
    write_numbered(tmp_path / 'bag', messages, max_duration_ns=100_000_000).close()
    files = load(tmp_path / 'bag')['files']
    # One begins with the message that is later than the time after the first: as in rosbag2.
    assert [file['message_count'] for file in files] == [11] * 9 + [1]
    assert {file['duration']['nanoseconds'] for file in files[:-1]} == {100_000_000}


def test_no_file_is_without_messages(tmp_path: Path) -> None:
    messages = numbered(5)
    write_numbered(tmp_path / 'bag', messages, max_size=1, max_duration_ns=1).close()
    assert [file['message_count'] for file in load(tmp_path / 'bag')['files']] == [1] * 5
    assert read_numbered(tmp_path / 'bag') == messages


def test_files_that_are_complete_are_readable_before_the_end(tmp_path: Path) -> None:
    messages = numbered(5000)
    bag = write_numbered(tmp_path / 'bag', messages, max_duration_ns=999_000_000)
    assert bag.file_count == 5
    shutil.copytree(tmp_path / 'bag', tmp_path / 'killed')
    bag.close()
    assert read_numbered(tmp_path / 'killed') == messages[:4000]


# Disks that refuse.


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file can be larger than this: as if the disk were full then."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def grow_evenly(bag: BagWriter, k: int) -> None:
    if k % 30 == 29:
        bag.flush()
    if k % 300 == 299:
        bag.set_custom_data({'growing': 'x' * k})
        bag.add_topic(f'/t{k}', 'std_msgs/msg/String', 'string data\n' * k, [], HASH)


def grow_in_chunks(bag: BagWriter, k: int) -> None:
    """So that the index takes more than the messages."""
    if k < 40:
        bag.add_topic(f'/t{k}', 'std_msgs/msg/String', 'string data\n', [], HASH)
    bag.flush()


def grow_in_topics(bag: BagWriter, k: int) -> None:
    if k % 4 == 3:
        definition = f'string data_{k}\n' * 300
        bag.add_topic(f'/t{k}', f'std_msgs/msg/T{k}', definition, [PROFILE] * 3, HASH)


def grow_in_metadata(bag: BagWriter, k: int) -> None:
    if k == 20:
        bag.set_custom_data({'large': 'x' * 400_000})


Grow = Callable[[BagWriter, int], None]
all_ways = pytest.mark.parametrize(
    'grow', [grow_evenly, grow_in_chunks, grow_in_topics, grow_in_metadata]
)


def write_until_refused(bag: BagWriter, grow: Grow) -> list[tuple[str, int, bytes]]:
    """Write until the disk refuses; returns what was accepted."""
    accepted: list[tuple[str, int, bytes]] = []
    generator = random.Random(0)
    bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [PROFILE], HASH)
    try:
        for k in range(10**6):
            time, data = START + 1_000_000 * k, generator.randbytes(generator.randrange(900))
            bag.write('/a', data, time, time)
            accepted.append(('/a', time, data))
            grow(bag, k)
    except OSError as error:
        number = error.errno
    assert number in (errno.ENOSPC, errno.EFBIG)
    return accepted


def check_complete(bag: BagWriter, accepted: list[tuple[str, int, bytes]]) -> None:
    assert bag.message_count == len(accepted) > 100
    found = []
    for file in sorted(bag.path.glob('*.mcap'), key=lambda file: int(file.stem.split('_')[1])):
        assert inspect(file).faults == []
        with file.open('rb') as stream:
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
                found.append((channel.topic, message.log_time, message.data))
    assert found == accepted
    assert load(bag.path)['message_count'] == len(accepted)
    with Reader(bag.path) as reader:
        assert reader.message_count == len(accepted)


@all_ways
@pytest.mark.parametrize('size', [2_500_000, 2_966_666])
def test_all_that_was_accepted_is_in_the_bag_when_a_file_cannot_grow(
    tmp_path: Path, size: int, grow: Grow
) -> None:
    with largest_file(size):
        bag = BagWriter(tmp_path / 'bag')
        accepted = write_until_refused(bag, grow)
        bag.close()
    check_complete(bag, accepted)
    assert bag.size < size


@pytest.mark.parametrize(
    ('grow', 'limits'),
    [
        (grow_evenly, {}),
        (grow_in_chunks, {'max_duration_ns': 499_000_000}),
        (grow_in_topics, {'max_size': 700_000}),
        (grow_in_metadata, {'max_size': 700_000}),
    ],
)
def test_all_that_was_accepted_is_in_the_bag_when_the_disk_is_full(
    small_disk: Path, limits: dict[str, int], grow: Grow
) -> None:
    bag = BagWriter(small_disk / 'bag', **limits)
    accepted = write_until_refused(bag, grow)
    bag.close()
    check_complete(bag, accepted)


def test_most_of_the_disk_is_used(small_disk: Path) -> None:
    bag = BagWriter(small_disk / 'bag')
    write_until_refused(bag, lambda bag, k: None)
    bag.close()
    assert bag.size > 4 * 2**20 - RESERVE - 200_000


def test_disk_full_with_a_large_message(small_disk: Path) -> None:
    with BagWriter(small_disk / 'bag') as bag:
        bag.add_topic('/a', 'std_msgs/msg/String', 'string data\n', [PROFILE], HASH)
        bag.write('/a', b'first', START, START)
        with pytest.raises(OSError, match='No space left'):
            bag.write('/a', bytes(10_000_000), START + 1, START)
    assert read_numbered(bag.path) == [('/a', START, b'first')]


def test_full_disk_at_the_start_leaves_nothing_behind(small_disk: Path) -> None:
    (small_disk / 'filling').write_bytes(bytes(3_500_000))
    with pytest.raises(OSError, match=r'cannot write the bag .*bag: No space left on device'):
        BagWriter(small_disk / 'bag')
    assert [file.name for file in small_disk.iterdir()] == ['filling']


def test_disk_that_breaks_its_word_leaves_what_can_be_recovered(tmp_path: Path) -> None:
    messages = numbered(2000)
    bag = write_numbered(tmp_path / 'bag', messages)
    bag.flush()
    bag.write('/a', text_message('not flushed'), START + 10**12, START)
    with largest_file(1000):  # less than the file has already
        with pytest.raises(OSError, match='File too large'):
            bag.flush()
        with pytest.raises(OSError, match='could not be completed'):
            bag.close()
        bag.close()  # nothing is left to do
    assert not (tmp_path / 'bag' / 'metadata.yaml').exists()
    recover(tmp_path / 'bag')
    assert read_numbered(tmp_path / 'bag') == messages
