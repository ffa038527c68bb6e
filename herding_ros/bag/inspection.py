# SPDX-License-Identifier: Apache-2.0
"""Whether a data file of a bag is whole, and what it holds."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, cast, TypeVar
import zlib

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
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
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from .metadata import FileInformation, RECORD_KEY, RECORD_NAME, topic_information
from .records import DamageError, Found, is_mcap, records, records_in

Open = Callable[[Path], BinaryIO]
"""Opens a file for reading; the caller may give one that shows how far it has been read."""

_MOST_FAULTS = 10
"""So many faults of a file are named."""

_KINDS: dict[type, int] = {
    Schema: Opcode.SCHEMA,
    Channel: Opcode.CHANNEL,
    Statistics: Opcode.STATISTICS,
    ChunkIndex: Opcode.CHUNK_INDEX,
    AttachmentIndex: Opcode.ATTACHMENT_INDEX,
    MetadataIndex: Opcode.METADATA_INDEX,
}
"""What a summary consists of."""

_BLOCK = 1024 * 1024

Kind = TypeVar('Kind', bound=McapRecord)


@dataclass
class Inspection:
    """What was found in a file.

    faults: why it is not whole, empty if it is; lost_bytes: those of the data that are not in
    whole records; schemas, channels: by their number in the file; counts: messages by channel;
    first_ns, last_ns: their log times; metadata: the last of rosbag2's maps in the file, as YAML;
    compression: of the first chunk, '', lz4 or zstd; profile: of the file's header, or ros2.
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
        """Note why the file is not whole, once."""
        if len(self.faults) < _MOST_FAULTS and fault not in self.faults:
            self.faults.append(fault)

    def information(self) -> FileInformation:
        """Return what bags list of a file, if the file is whole."""
        file = FileInformation(self.path.name, self.counts.total())
        if file.message_count:
            file.first_ns, file.last_ns = self.first_ns, self.last_ns
        for number, channel in self.channels.items():
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
    data, summary = _Data(found), _Summary()
    position = len(MCAP0_MAGIC)
    with opening(path) as stream:
        if not is_mcap(stream):
            raise ValueError(f'{path} is not an mcap file')
        try:
            for one in records(stream):
                if not data.end:
                    found.lost_bytes += one.start - position  # of unknown kinds
                    position = one.end
                    data.add(one)
                else:
                    summary.add(one)
        except DamageError as damage:
            found.add_fault(f'from byte {damage.position} on: {damage}')
            if not data.end:
                found.lost_bytes += _used_bytes(stream, damage.position)
        if not (data.end and summary.of(Footer)):
            found.add_fault('it has no end')
        elif not (summary.describes(data, found) and summary.is_located(stream, data.end)):
            found.add_fault('its index is not that of its data')
    found.schemas = {**_by_id(summary.of(Schema)), **found.schemas}
    found.channels = {**_by_id(summary.of(Channel)), **found.channels}
    _check_topics(found)
    if not found.faults:
        found.lost_bytes = 0
    return found


def _check_topics(found: Inspection) -> None:
    """Note topics that cannot be read."""
    if not found.counts.keys() <= found.channels.keys():
        found.add_fault('it lacks the topic of a message')
    for channel in found.channels.values():
        if channel.schema_id not in found.schemas:
            found.add_fault('it lacks the type of a topic')
            continue
        try:
            topic_information(channel, found.schemas[channel.schema_id])
        except ValueError as error:
            found.add_fault(f'topic {channel.topic}: {error}')


class _Data:
    """The data section: what is in it, and the index that belongs to it.

    end: the position after it, 0 until it is known.
    """

    def __init__(self, found: Inspection) -> None:
        self.end = 0
        self.schemas: list[Schema] = []
        self.channels: list[Channel] = []
        self.chunks: list[ChunkIndex] = []
        self.metadata: list[MetadataIndex] = []
        self.attachments: list[AttachmentIndex] = []
        self._found = found
        self._messages: dict[int, list[tuple[int, int]]] = {}  # of the last chunk, not indexed yet

    def add(self, found: Found) -> None:
        """Take the next record of the section."""
        start, end, record = found
        if isinstance(record, Chunk | DataEnd):
            self._check_last_chunk()
        if isinstance(record, Chunk):
            self._add_chunk(start, end, record)
        elif isinstance(record, MessageIndex):
            self._add_message_index(start, end, record)
        elif isinstance(record, DataEnd):
            self.end = end
        elif isinstance(record, Metadata):
            self.metadata.append(MetadataIndex(start, end - start, record.name))
            if record.name == RECORD_NAME:
                self._found.metadata = record.metadata.get(RECORD_KEY, '')
        elif isinstance(record, Attachment):
            times, size = (record.log_time, record.create_time), len(record.data)
            self.attachments.append(
                AttachmentIndex(start, end - start, *times, size, record.name, record.media_type)
            )
        else:
            self._add(record)

    def _add(self, record: McapRecord) -> None:
        """Take a record that may be within a chunk."""
        found = self._found
        if isinstance(record, Message):
            found.counts[record.channel_id] += 1
            found.first_ns = min(found.first_ns, record.log_time)
            found.last_ns = max(found.last_ns, record.log_time)
        elif isinstance(record, Schema):
            found.schemas[record.id] = record
            self.schemas.append(record)
        elif isinstance(record, Channel):
            found.channels[record.id] = record
            self.channels.append(record)
        elif isinstance(record, Header):
            found.profile = record.profile

    def _add_chunk(self, start: int, end: int, chunk: Chunk) -> None:
        if not self.chunks:
            self._found.compression = chunk.compression
        self.chunks.append(
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
        times = [time for messages in self._messages.values() for time, _ in messages]
        said = (chunk.message_start_time, chunk.message_end_time)
        if times and said != (min(times), max(times)):
            self._found.add_fault(f'the chunk at byte {start} has other times than its messages')

    def _add_message_index(self, start: int, end: int, index: MessageIndex) -> None:
        if not self.chunks:
            return
        self.chunks[-1].message_index_offsets[index.channel_id] = start
        self.chunks[-1].message_index_length += end - start
        if sorted(index.records) != sorted(self._messages.pop(index.channel_id, [])):
            self._found.add_fault('the index of a chunk is not that of its messages')

    def _check_last_chunk(self) -> None:
        """Note when it has an index which lacks messages."""
        if self.chunks and self.chunks[-1].message_index_offsets and self._messages:
            self._found.add_fault('the index of a chunk is not that of its messages')


class _Summary:
    """The summary section of a file and its footer."""

    def __init__(self) -> None:
        self._found: dict[type, list[Found]] = defaultdict(list)

    def add(self, found: Found) -> None:
        """Take the next record."""
        self._found[type(found.record)].append(found)

    def of(self, kind: type[Kind]) -> list[Kind]:
        """Return the records of a kind."""
        return [cast(Kind, found.record) for found in self._found[kind]]

    def describes(self, data: _Data, found: Inspection) -> bool:
        """Whether it is that of this data. It may list more topics, but no other messages."""
        statistics = self.of(Statistics)
        return (
            len(statistics) == 1
            and _by_id(data.schemas).items() <= _by_id(self.of(Schema)).items()
            and _by_id(data.channels).items() <= _by_id(self.of(Channel)).items()
            and self.of(ChunkIndex) == data.chunks
            and self.of(MetadataIndex) in ([], data.metadata)
            and self.of(AttachmentIndex) in ([], data.attachments)
            and statistics[0].message_count == found.counts.total()
            and +Counter(statistics[0].channel_message_counts) == found.counts
            and (
                not found.counts
                or (statistics[0].message_start_time, statistics[0].message_end_time)
                == (found.first_ns, found.last_ns)
            )
        )

    def is_located(self, stream: BinaryIO, start: int) -> bool:
        """Whether the footer and the offsets lead to it, and the checksum is right."""
        place = self._found[Footer][0].start
        (footer,) = self.of(Footer)
        offsets = self._found[SummaryOffset]
        groups = {
            opcode: (found[0].start, sum(each.end - each.start for each in found))
            for kind, opcode in _KINDS.items()
            if (found := self._found[kind])
        }
        covered = place + 9 + 16  # all of the footer but the checksum itself
        return (
            footer.summary_start == start
            and (not offsets or footer.summary_offset_start == offsets[0].start)
            and footer.summary_crc in (0, _checksum(stream, start, covered))
            and all(
                groups.get(offset.group_opcode) == (offset.group_start, offset.group_length)
                for offset in self.of(SummaryOffset)
                if offset.group_length
            )
        )


def _by_id(items: Sequence[Any]) -> dict[int, Any]:
    return {item.id: item for item in items}


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
