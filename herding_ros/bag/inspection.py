# SPDX-License-Identifier: Apache-2.0
"""Whether a data file of a bag is whole, and what it holds."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO
import zlib

from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from .metadata import (
    FileInformation,
    offered_profiles,
    RECORD_KEY,
    RECORD_NAME,
    topic_information,
)
from .records import DamageError, Found, is_mcap, records, records_in

Open = Callable[[Path], BinaryIO]
"""Opens a file for reading; the caller may give one that shows how far it has been read."""

_MOST_FAULTS = 10
_BLOCK = 1024 * 1024


@dataclass
class Inspection:
    """What was found in a file.

    faults: why it is not whole, the first ten, empty if it is; lost_bytes: those of the data that
    are not in whole records; schemas, channels: by their number in the file; counts: messages by
    channel; first_ns, last_ns: their log times; metadata: the last of rosbag2's maps in the file,
    as YAML; compression: of the first chunk, '', lz4 or zstd; profile: of the file's header, or
    ros2.
    """

    path: Path
    faults: list[str] = field(default_factory=list)
    lost_bytes: int = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    first_ns: int = 2**64
    last_ns: int = 0
    metadata: str = ''
    compression: str = ''
    profile: str = 'ros2'

    def add_fault(self, fault: str) -> None:
        """Note why the file is not whole."""
        if len(self.faults) < _MOST_FAULTS and fault not in self.faults:
            self.faults.append(fault)

    @property
    def known_channels(self) -> dict[int, Channel]:
        """The channels whose types are in the file."""
        return {n: each for n, each in self.channels.items() if each.schema_id in self.schemas}

    @property
    def lost_messages(self) -> int:
        """Number of messages whose topics are nowhere in the file."""
        return self.counts.total() - self.information.message_count

    @property
    def information(self) -> FileInformation:
        """What a bag lists of this file."""
        channels = self.known_channels
        file = FileInformation(self.path.name, sum(self.counts[number] for number in channels))
        if file.message_count:
            file.first_ns, file.last_ns = self.first_ns, self.last_ns
        for number, channel in channels.items():
            topic = topic_information(channel, self.schemas[channel.schema_id])
            file.topics.setdefault(topic.name, topic).message_count += self.counts[number]
        return file


def open_file(path: Path) -> BinaryIO:
    """Open a file for reading."""
    return path.open('rb')


def inspect(path: Path, opening: Open = open_file) -> Inspection:
    """Read a file from one end to the other, in bounded memory.

    A whole file consists of whole records with right checksums, and its summary describes its
    data. Raises ValueError when it is not an mcap file, OSError when it cannot be read.
    """
    found = Inspection(path)
    data = _DataSection(found)
    summary: list[Found] = []
    position = len(MCAP0_MAGIC)
    with opening(path) as stream:
        if not is_mcap(stream):
            raise ValueError(f'{path} is not an mcap file')
        try:
            for one in records(stream):
                if data.end:
                    summary.append(one)
                else:
                    found.lost_bytes += one.start - position  # records of unknown kinds
                    position = one.end
                    data.add(one)
        except DamageError as damage:
            found.add_fault(f'from byte {damage.position} on: {damage}')
            if not data.end:
                found.lost_bytes += _used_bytes(stream, damage.position)
        if not (summary and isinstance(summary[-1].record, Footer)):
            found.add_fault('it has no end')
        elif not data.is_described_by(summary, stream):
            found.add_fault('its index is not that of its data')
    found.schemas = {**_by_id(summary, Schema), **found.schemas}
    found.channels = {**_by_id(summary, Channel), **found.channels}
    _check_topics(found)
    if not found.faults:
        found.lost_bytes = 0
    return found


def _check_topics(found: Inspection) -> None:
    if not found.counts.keys() <= found.channels.keys():
        found.add_fault('it lacks the topic of a message')
    if len(found.known_channels) < len(found.channels):
        found.add_fault('it lacks the type of a topic')
    for channel in found.channels.values():
        try:
            offered_profiles(channel)
        except ValueError as error:
            found.add_fault(f'the QoS profiles of {channel.topic} cannot be read: {error}')


class _DataSection:
    """What a file's summary has to describe.

    end: the position after the section, 0 until it is known.
    """

    def __init__(self, found: Inspection) -> None:
        self.end = 0
        self._found = found
        self._chunks: list[ChunkIndex] = []
        self._messages: dict[int, list[tuple[int, int]]] = {}  # of the last chunk, by channel

    def add(self, found: Found) -> None:
        """Take the next record of the section."""
        start, end, record = found
        if isinstance(record, Chunk):
            self._add_chunk(start, end, record)
        elif isinstance(record, MessageIndex) and self._chunks:
            self._chunks[-1].message_index_offsets[record.channel_id] = start
            self._chunks[-1].message_index_length += end - start
            if sorted(record.records) != sorted(self._messages.get(record.channel_id, [])):
                self._found.add_fault('the index of a chunk is not that of its messages')
        elif isinstance(record, Metadata) and record.name == RECORD_NAME:
            self._found.metadata = record.metadata.get(RECORD_KEY, '')
        elif isinstance(record, Header):
            self._found.profile = record.profile
        elif isinstance(record, DataEnd):
            self.end = end
        else:
            self._add(record)

    def _add(self, record: McapRecord) -> None:
        """Take a record that may be within a chunk."""
        if isinstance(record, Message):
            self._found.counts[record.channel_id] += 1
            self._found.first_ns = min(self._found.first_ns, record.log_time)
            self._found.last_ns = max(self._found.last_ns, record.log_time)
        elif isinstance(record, Schema):
            self._found.schemas[record.id] = record
        elif isinstance(record, Channel):
            self._found.channels[record.id] = record

    def _add_chunk(self, start: int, end: int, chunk: Chunk) -> None:
        if not self._chunks:
            self._found.compression = chunk.compression
        self._chunks.append(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=start,
                chunk_length=end - start,
                message_index_offsets={},
                message_index_length=0,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        self._messages = defaultdict(list)
        try:
            content = records_in(chunk)
        except DamageError as damage:
            self._found.add_fault(f'in the chunk at byte {start}: {damage}')
            self._found.lost_bytes += end - start
            return
        for place, _, record in content:
            self._add(record)
            if isinstance(record, Message):
                self._messages[record.channel_id].append((record.log_time, place))

    def is_described_by(self, summary: list[Found], stream: BinaryIO) -> bool:
        """Whether a summary is that of this data; it may list more topics."""
        found = self._found
        statistics = [one.record for one in summary if isinstance(one.record, Statistics)]
        chunks = [one.record for one in summary if isinstance(one.record, ChunkIndex)]
        offsets = [one.start for one in summary if isinstance(one.record, SummaryOffset)]
        footer: Any = summary[-1].record
        covered = summary[-1].end - 4  # all of the footer but the checksum itself
        return (
            footer.summary_start == self.end
            and (not offsets or footer.summary_offset_start == offsets[0])
            and footer.summary_crc in (0, _checksum(stream, self.end, covered))
            and found.schemas.items() <= _by_id(summary, Schema).items()
            and found.channels.items() <= _by_id(summary, Channel).items()
            and chunks == self._chunks
            and len(statistics) == 1
            and statistics[0].message_count == found.counts.total()
            and +Counter(statistics[0].channel_message_counts) == found.counts
            and (
                not found.counts
                or (statistics[0].message_start_time, statistics[0].message_end_time)
                == (found.first_ns, found.last_ns)
            )
        )


def _by_id(section: list[Found], kind: type[Schema] | type[Channel]) -> dict[int, Any]:
    return {one.record.id: one.record for one in section if isinstance(one.record, kind)}


def _checksum(stream: BinaryIO, start: int, end: int) -> int:
    checksum = 0
    stream.seek(start)
    for position in range(start, end, _BLOCK):
        checksum = zlib.crc32(stream.read(min(_BLOCK, end - position)), checksum)
    return checksum


def _used_bytes(stream: BinaryIO, start: int) -> int:
    """Return the number of bytes after `start`, without the zeros that the file ends with.

    A recorder that was killed had reserved them.
    """
    end, position = start, stream.seek(start)
    while block := stream.read(_BLOCK):
        used = len(block.rstrip(b'\0'))
        end = position + used if used else end
        position += len(block)
    return end - start
