# SPDX-License-Identifier: Apache-2.0
"""What a data file of a bag holds, which may have been cut off, damaged or made to do harm.

mcap's streaming reader bounds the size of a record, but trusts every length inside one. Here no
record gets more bytes than it has and no chunk more memory than it declares, so that memory
depends on `MOST_BYTES` alone and time on the size of the file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, cast
import zlib

import lz4.frame  # type: ignore[import-untyped]
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Message,
    Metadata,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
import zstandard

from .metadata import (
    FileInformation,
    from_yaml,
    PROFILES_KEY,
    RECORD_KEY,
    RECORD_NAME,
    TopicInformation,
)

Open = Callable[[Path], BinaryIO]
"""Opens a file for reading; the caller may give one that shows how far it has been read."""

MOST_BYTES = 256 * 1024 * 1024
"""No record is read that is larger, nor a chunk that is when decompressed [byte]."""

_MOST_ENTRIES = 16 * 1024 * 1024
"""No record but chunks and messages is read that is larger [byte]."""

_DAMAGE = (McapError, ValueError, RuntimeError, zstandard.ZstdError)
"""What mcap and the decompressors raise."""


@dataclass
class DataFile:
    """What was found in a file.

    faults: why it is not whole, empty if it is; schemas, channels: by their number in the file;
    counts: messages by channel; first_ns, last_ns: their log times; metadata: the last of
    rosbag2's maps in the file, as YAML; compression: of the chunks, '', lz4 or zstd.
    """

    path: Path
    faults: list[str] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    first_ns: int = 2**64
    last_ns: int = 0
    metadata: str = ''
    compression: str = ''

    @property
    def known_channels(self) -> dict[int, Channel]:
        """The channels whose types are in the file."""
        return {n: each for n, each in self.channels.items() if each.schema_id in self.schemas}

    @property
    def information(self) -> FileInformation:
        """What a bag lists of this file."""
        channels = self.known_channels
        file = FileInformation(self.path.name, sum(self.counts[number] for number in channels))
        if file.message_count:
            file.first_ns, file.last_ns = self.first_ns, self.last_ns
        for number, channel in channels.items():
            type_name = self.schemas[channel.schema_id].name
            type_hash = channel.metadata.get('topic_type_hash', '')
            topic = TopicInformation(channel.topic, type_name, profiles(channel), type_hash)
            file.topics.setdefault(topic.name, topic).message_count += self.counts[number]
        return file


def profiles(channel: Channel) -> list[dict[str, Any]]:
    """Return the QoS profiles of a topic, without those that Jazzy could not read."""
    try:
        content = from_yaml(channel.metadata.get(PROFILES_KEY, ''))
    except ValueError:
        return []
    offered = content if isinstance(content, list) else []
    return [p for p in offered if isinstance(p, dict) and isinstance(p.get('history'), str)]


def open_file(path: Path) -> BinaryIO:
    """Open a file for reading."""
    return path.open('rb')


def inspect(path: Path, opening: Open = open_file) -> DataFile:
    """Read a file from one end to the other, in bounded memory.

    A whole file consists of whole records with right checksums, and its summary describes its
    data. Raises ValueError when it is not an mcap file, OSError when it cannot be read.
    """
    found = DataFile(path)
    summary = _Summary()
    with opening(path) as stream:
        # One that begins with zeros was reserved by a recorder that was killed.
        if not MCAP0_MAGIC.startswith(stream.read(len(MCAP0_MAGIC)).rstrip(b'\0')):
            raise ValueError(f'{path} is not an mcap file')
        for start, end, record in records(stream, found.faults):
            if isinstance(record, Message):
                found.counts[record.channel_id] += 1
                found.first_ns = min(found.first_ns, record.log_time)
                found.last_ns = max(found.last_ns, record.log_time)
            elif isinstance(record, Schema):
                found.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                found.channels.setdefault(record.id, record)
            elif isinstance(record, Metadata) and record.name == RECORD_NAME:
                found.metadata = record.metadata.get(RECORD_KEY, '')
            else:
                summary.add(start, end, record)
                if isinstance(record, Chunk):
                    found.compression = record.compression
        if not found.faults and not summary.describes(found, stream):
            found.faults.append('its index is not that of its data')
    if len(found.known_channels) < len(found.channels | found.counts):
        lost = found.counts.total() - found.information.message_count
        found.faults.append(f'it lacks a topic or its type, and so {lost} messages are lost')
    return found


class _Summary:
    """What a file says of its data, and what it has to say."""

    def __init__(self) -> None:
        self._data_end = 0
        self._offsets = 0  # where the summary's offsets begin
        self._end = 0
        self._chunks: list[tuple[object, ...]] = []
        self._indexes: list[tuple[object, ...]] = []
        self._statistics: Statistics | None = None
        self._footer: Footer | None = None

    def add(self, start: int, end: int, record: McapRecord) -> None:
        if isinstance(record, Chunk):
            size = len(record.data)
            self._chunks.append((start, end - start, size, *_common(record)))
        elif isinstance(record, ChunkIndex):
            place = record.chunk_start_offset, record.chunk_length
            self._indexes.append((*place, record.compressed_size, *_common(record)))
        elif isinstance(record, DataEnd):
            self._data_end = end
        elif isinstance(record, Statistics):
            self._statistics = record
        elif isinstance(record, SummaryOffset):
            self._offsets = self._offsets or start
        elif isinstance(record, Footer):
            self._footer, self._end = record, end

    def describes(self, found: DataFile, stream: BinaryIO) -> bool:
        footer, statistics = self._footer, self._statistics
        if footer is None or statistics is None or self._end - self._data_end > MOST_BYTES:
            return False
        stream.seek(self._data_end)
        covered = stream.read(self._end - 4 - self._data_end)  # all but the checksum itself
        times = statistics.message_start_time, statistics.message_end_time
        return (
            footer.summary_start == self._data_end
            and footer.summary_offset_start in (self._offsets, 0)
            and footer.summary_crc in (zlib.crc32(covered), 0)
            and self._indexes == self._chunks
            and statistics.message_count == found.counts.total()
            and +Counter(statistics.channel_message_counts) == found.counts
            and (not found.counts or times == (found.first_ns, found.last_ns))
        )


def _common(chunk: Chunk | ChunkIndex) -> tuple[object, ...]:
    times = chunk.message_start_time, chunk.message_end_time
    return (*times, chunk.compression, chunk.uncompressed_size)


def records(stream: BinaryIO, faults: list[str]) -> Iterator[tuple[int, int, McapRecord]]:
    """Yield the whole records of a file with the bytes they are at, from `start` up to `end`.

    Those in a chunk follow it, if all of it is whole. Records behind one that is not whole are
    not searched for. What is wrong is added to `faults`.
    """
    reader = _Reader(stream)
    try:
        for record in reader.records:
            yield reader.start, reader.end, record
            if isinstance(record, Chunk):
                try:
                    content = list(_Reader(BytesIO(_decompressed(record)), True).records)
                except _DAMAGE as error:
                    faults.append(f'the chunk at byte {reader.start} is lost: {error}')
                else:
                    for each in content:
                        yield reader.start, reader.end, each
        if reader.has_wrong_checksum:
            faults.append('the checksum of its data is wrong')
        if reader.left:
            raise McapError(f'{reader.left} bytes follow its end')
    except _DAMAGE as error:
        reason = str(error) or 'it ends within a record'
        faults.append(f'what follows byte {reader.end} is lost: {reason}')


class _Reader(StreamReader):
    """mcap's streaming reader of a file or a chunk, and where the last whole record was."""

    def __init__(self, stream: BinaryIO, within_chunk: bool = False) -> None:
        self._source = _Source(stream)
        super().__init__(
            cast(Any, self._source),
            skip_magic=within_chunk,
            emit_chunks=True,
            record_size_limit=MOST_BYTES,
        )
        self._within_chunk = within_chunk
        self.start = self.end = 0
        self._checksum = 0  # of all up to `end`
        self.has_wrong_checksum = False

    @property
    def records(self) -> Iterator[McapRecord]:
        try:
            yield from super().records
        except EndOfFile:
            if not self._within_chunk or self._source.position != self.end:
                raise

    @property
    def left(self) -> int:
        """Number of bytes that have not been read."""
        return self._source.size - self._source.position

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        start = self._source.position - 9
        end = self._source.position + length
        if opcode == 0:
            raise McapError('a record must be of another kind than 0')
        if length > _MOST_ENTRIES and opcode not in (Opcode.CHUNK, Opcode.MESSAGE):
            raise McapError(f'its record {opcode} must be at most {_MOST_ENTRIES} bytes long')
        self._source.end = min(end, self._source.size)
        record = super()._read_record(opcode, length)
        self._source.end = self._source.size
        if self._source.position != end:
            raise McapError(f'its record {opcode} must be {length} bytes long')
        if isinstance(record, DataEnd):
            # mcap would stop here, but the summary may hold topics that were lost with a chunk.
            self.has_wrong_checksum = record.data_section_crc not in (0, self._checksum)
        self.start, self.end, self._checksum = start, end, self._source.checksum
        return record


class _Source:
    """A file that gives all of the bytes that are asked for, up to `end`, or raises EndOfFile."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.size = self.end = stream.seek(0, 2)
        self.position = stream.seek(0)
        self.checksum = 0

    def read(self, length: int) -> bytes:
        if not 0 <= length <= self.end - self.position:
            raise EndOfFile
        self.position += length
        data = self._stream.read(length)
        self.checksum = zlib.crc32(data, self.checksum)
        return data


def _decompressed(chunk: Chunk) -> bytes:
    """Return the data of a chunk, or raise one of `_DAMAGE`."""
    size = chunk.uncompressed_size
    if size > MOST_BYTES:
        raise ValueError(f'a chunk must have at most {MOST_BYTES} bytes, got {size}')
    data: bytes
    # At most one byte more than declared, whatever a decompression bomb holds.
    if chunk.compression == '':
        data = chunk.data
    elif chunk.compression == 'zstd':
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = reader.read(size + 1)
    elif chunk.compression == 'lz4':
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    else:
        raise ValueError(f'unknown compression {chunk.compression!r}')
    if len(data) != size:
        raise ValueError(f'a chunk must have the {size} bytes that it declares')
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError('its checksum is wrong')
    return data
