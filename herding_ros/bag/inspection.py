# SPDX-License-Identifier: Apache-2.0
"""Whether a data file of a bag is whole, and what it holds.

It may have been cut off, damaged or made to do harm. mcap's reader trusts every length in a file;
here no record gets more bytes than it has, and neither time nor memory is much larger than is due
to a file of its size.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
import struct
from typing import Any, BinaryIO, NamedTuple
import zlib

import lz4.frame  # type: ignore[import-untyped]
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    Metadata,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC
import zstandard

from .metadata import (
    FileInformation,
    HASH_KEY,
    PROFILES_KEY,
    read_profiles,
    RECORD_KEY,
    RECORD_NAME,
)

Open = Callable[[Path], BinaryIO]
"""Opens a file for reading; the caller may give one that shows how far it has been read."""

MOST_FAULTS = 10
"""So many of what is wrong with a file are noted; a hostile one could have millions."""

MOST_BYTES = 16 * 1024 * 1024
"""No record is read that is larger, nor a chunk that is when decompressed [byte]."""

_MOST_ENTRIES = 4 * 1024 * 1024
"""No record but messages and what holds such is read that is larger [byte]."""

_LARGE = {Opcode.CHUNK, Opcode.MESSAGE, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT}

_MOST_OF_TOPICS = 8 * 1024 * 1024
"""What all topics and types of a file may take, and not much more than the file [byte]."""

_OF_TOPIC = 500
"""What each of them is counted for besides its own size [byte]."""

_RATIO = 100
"""The chunks of a file are at most so many times as large as the file up to them, and 16 MiB."""

_WORK = 100_000
"""With a quarter of the size of a file, the records that its chunks may have.

Such of topics count once more for every 8 bytes. A message takes more than 4 bytes, however well
it is compressed, since its times are in an index.
"""

_IN_CHUNKS: dict[int, Any] = {Opcode.CHANNEL: Channel, Opcode.SCHEMA: Schema}

_KINDS: dict[int, Any] = {
    **_IN_CHUNKS,
    Opcode.CHUNK: Chunk,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.DATA_END: DataEnd,
    Opcode.FOOTER: Footer,
    Opcode.HEADER: Header,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
}

_HEAD = struct.Struct('<BQ')  # opcode and length of a record
_MESSAGE = struct.Struct('<HIQQ')  # channel, sequence, log time and publish time
_ENTRY = struct.Struct('<QQ')  # of an index of messages: log time and place in the chunk


class Record(NamedTuple):
    """A whole record at the bytes from `start` up to `end`, and the checksum of those before.

    content: as one of mcap's records, or as bytes when it is an index of messages or unknown;
    checksum: of all since the beginning of the file or, behind the data, since their end.
    """

    start: int
    end: int
    opcode: int
    content: Any
    checksum: int


class _Exact(BytesIO):
    """Gives as many bytes as are asked for, or raises EndOfFile."""

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        if size is not None and len(data) < size:
            raise EndOfFile
        return data


def records(stream: BinaryIO, faults: list[str]) -> Iterator[Record]:
    """Yield the records of a file up to its footer; those in a chunk follow it, if it is whole.

    Records behind one that is not whole are not searched for. What is wrong is added to `faults`,
    as long as they are few.
    """
    end = stream.seek(len(MCAP0_MAGIC))
    unpacked = work = 0  # of what is in chunks: bytes, records
    try:
        for record in _split(stream, _KINDS, end, zlib.crc32(MCAP0_MAGIC)):
            end = record.end
            yield record
            if record.opcode == Opcode.CHUNK:
                unpacked += record.content.uncompressed_size
                try:
                    if unpacked > _RATIO * end + MOST_BYTES:
                        raise ValueError(f'it must have at most {_RATIO} times the bytes it takes')
                    data = _decompressed(record.content)
                    for each in _split(BytesIO(data), _IN_CHUNKS):  # all before one is taken
                        is_message = each.opcode == Opcode.MESSAGE
                        work += 1 if is_message else 1 + (each.end - each.start) // 8
                        if work > _WORK + end // 4:
                            raise ValueError('it has too many records for its size')
                except ValueError as error:
                    lost = end - record.start
                    _note(faults, f'the chunk of {lost} bytes at byte {record.start}: {error}')
                else:
                    yield from _split(BytesIO(data), _IN_CHUNKS)
            elif record.opcode == Opcode.FOOTER:
                if stream.read(len(MCAP0_MAGIC) + 1) != MCAP0_MAGIC:
                    _note(faults, f'what follows byte {end} is not the end of an mcap file')
                return
        raise ValueError('it ends without an index')
    except ValueError as error:
        lost = _used(stream, end)
        what = f'the {lost} bytes from byte {end} on are lost: {error}'
        _note(faults, what if lost else f'it ends at byte {end}, without an index')


def _note(faults: list[str], fault: str) -> None:
    if len(faults) < MOST_FAULTS:
        faults.append(fault)


def _used(stream: BinaryIO, start: int) -> int:
    """Return the number of bytes from `start` on, without the zeros that a file ends with.

    A recorder that was killed had reserved them.
    """
    end = position = stream.seek(start)
    while block := stream.read(1024 * 1024):
        used = len(block.rstrip(b'\0'))
        end = position + used if used else end
        position += len(block)
    return end - start


def _split(
    stream: BinaryIO, kinds: dict[int, Any], start: int = 0, checksum: int = 0
) -> Iterator[Record]:
    """Yield the records of a file or of a chunk's data, those of some kinds as mcap's.

    Raises ValueError at the first that is not whole. Messages come by the million, so they are
    taken apart here and not by mcap.
    """
    while head := stream.read(_HEAD.size):
        if len(head) < _HEAD.size:
            raise ValueError('it ends within a record')
        opcode, length = _HEAD.unpack(head)
        if not opcode:
            raise ValueError('a record must be of another kind than 0')
        most = MOST_BYTES if opcode in _LARGE else _MOST_ENTRIES
        if length > most:
            raise ValueError(f'a record {opcode} must have at most {most} bytes, got {length}')
        data = stream.read(length)
        end = start + _HEAD.size + length
        if len(data) < length:
            raise ValueError('it ends within a record')
        content: Any = data
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise ValueError(f'a message must have at least {_MESSAGE.size} bytes')
            channel, sequence, logged, published = _MESSAGE.unpack_from(data)
            content = Message(channel, logged, data[_MESSAGE.size :], published, sequence)
        elif opcode in kinds:
            try:
                content = kinds[opcode].read(ReadDataStream(_Exact(data)))
            except (McapError, OverflowError) as error:
                raise ValueError('a length in it is wrong') from error
        yield Record(start, end, opcode, content, checksum)
        checksum = 0 if opcode == Opcode.DATA_END else zlib.crc32(data, zlib.crc32(head, checksum))
        start = end


def _decompressed(chunk: Chunk) -> bytes:
    """Return the data of a chunk; raises ValueError."""
    size = chunk.uncompressed_size
    if size > MOST_BYTES:
        raise ValueError(f'it must have at most {MOST_BYTES} bytes, got {size}')
    data: bytes
    try:
        # At most one byte more than declared, whatever a decompression bomb holds.
        if chunk.compression == '':
            data = chunk.data
        elif chunk.compression == 'zstd':
            decompressor = zstandard.ZstdDecompressor(max_window_size=MOST_BYTES)
            with decompressor.stream_reader(chunk.data) as reader:
                data = reader.read(size + 1)
        elif chunk.compression == 'lz4':
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
        else:
            raise ValueError(f'its compression must be lz4 or zstd, got {chunk.compression!r:.20}')
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ValueError(f'it cannot be decompressed: {error}') from error
    if len(data) != size:
        raise ValueError(f'it must have the {size} bytes that it declares')
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError('its checksum is wrong')
    return data


@dataclass
class Inspection:
    """What was found in a file.

    faults: why it is not whole, the first ten, empty if it is; schemas, channels: by their number
    in the file; profiles: the QoS profiles of each channel; metadata: the last of rosbag2's maps
    in the file, as YAML; compression: of the chunks, '', lz4 or zstd; profile: of the file's
    header; information: what a bag lists of the file.
    """

    path: Path
    information: FileInformation
    faults: list[str] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    profiles: dict[int, list[dict[str, Any]]] = field(default_factory=dict)
    metadata: str = ''
    compression: str = ''
    profile: str = 'ros2'


def open_file(path: Path) -> BinaryIO:
    """Open a file for reading."""
    return path.open('rb')


def inspect(path: Path, opening: Open = open_file) -> Inspection:
    """Read a file from one end to the other, in bounded memory.

    A whole file consists of whole records with right checksums, and its summary describes its
    data. Raises ValueError when it is not an mcap file, OSError when it cannot be read.
    """
    found = Inspection(path, FileInformation(path.name))
    tally = _Tally()
    with opening(path) as stream:
        # One that begins with zeros was reserved by a recorder that was killed.
        if not MCAP0_MAGIC.startswith(stream.read(len(MCAP0_MAGIC)).rstrip(b'\0')):
            raise ValueError(f'{path} is not an mcap file')
        room = min(_MOST_OF_TOPICS, 1_000_000 + stream.seek(0, 2))
        for record in records(stream, found.faults):
            tally.add(record)
            content = record.content
            if isinstance(content, Schema | Channel):
                known: Any = found.schemas if isinstance(content, Schema) else found.channels
                if content.id not in known:
                    room -= record.end - record.start + _OF_TOPIC
                    if room >= 0:
                        known[content.id] = content
            elif isinstance(content, Metadata) and content.name == RECORD_NAME:
                found.metadata = content.metadata.get(RECORD_KEY, '')
            elif isinstance(content, Chunk):
                found.compression = content.compression
            elif isinstance(content, Header):
                found.profile = content.profile
    if room < 0:
        _note(found.faults, 'it has more of topics than a bag of its size may')
    if not found.faults and not tally.is_described:
        found.faults.append('its index is not that of its data')
    _add_topics(found, tally)
    return found


def _add_topics(found: Inspection, tally: _Tally) -> None:
    """Note what a bag lists of a file."""
    for number, channel in list(found.channels.items()):
        schema = found.schemas.get(channel.schema_id)
        if schema is None:
            _note(found.faults, f'it lacks the type of {channel.topic!r:.80}')
            del found.channels[number]
            continue
        try:
            profiles = read_profiles(channel.metadata.get(PROFILES_KEY, ''))
        except ValueError as error:
            _note(found.faults, f'the QoS profiles of {channel.topic!r:.80} are lost: {error}')
            profiles = []
        found.profiles[number] = profiles
        type_hash = channel.metadata.get(HASH_KEY, '')
        found.information.add_topic(channel.topic, schema.name, profiles, type_hash)
        found.information.counts[channel.topic] += tally.counts[number]
    found.information.message_count = found.information.counts.total()
    full = [number for number in found.channels if tally.counts[number]]
    found.information.first_ns = min((tally.first_ns[number] for number in full), default=0)
    found.information.last_ns = max((tally.last_ns[number] for number in full), default=0)
    if lost := tally.counts.total() - found.information.message_count:
        _note(found.faults, f'it lacks the topics of {lost} messages')


class _Tally:
    """What the records of a file's data amount to, and whether its summary says the same.

    What both say of the chunks is kept as hashes, since there may be a million of them.
    """

    def __init__(self) -> None:
        self.counts: Counter[int] = Counter()  # messages by channel
        self.first_ns: dict[int, int] = {}  # log times by channel
        self.last_ns: dict[int, int] = {}
        self.is_described = False
        self._agrees = True
        self._chunk: Record | None = None
        self._entries: dict[int, bytearray] = defaultdict(bytearray)  # of the chunk, by channel
        self._offsets: dict[int, int] = {}  # of their indexes in the file
        self._chunks = self._indexes = 0  # hashes
        self._topics: dict[tuple[int, int], int] = {}  # hashes
        self._repeated: dict[tuple[int, int], int] = {}  # those of the summary
        self._data_end = 0
        self._summary_offsets = 0  # where they begin
        self._statistics: Statistics | None = None

    def add(self, record: Record) -> None:
        """Take the next record of a file."""
        content = record.content
        if isinstance(content, Message):
            channel, time_ns = content.channel_id, content.log_time
            if channel not in self.counts:
                self._agrees &= (Opcode.CHANNEL, channel) in self._topics  # before it
            self.counts[channel] += 1
            self.first_ns[channel] = min(time_ns, self.first_ns.get(channel, time_ns))
            self.last_ns[channel] = max(time_ns, self.last_ns.get(channel, time_ns))
            if self._chunk:
                self._entries[channel] += _ENTRY.pack(time_ns, record.start)
        elif isinstance(content, Schema | Channel):
            topics = self._repeated if self._data_end else self._topics
            if isinstance(content, Channel):
                self._agrees &= (Opcode.SCHEMA, content.schema_id) in topics
            topics[record.opcode, content.id] = hash(repr(content))
        elif isinstance(content, Chunk):
            self._end_chunk()
            self._chunk = record
        elif record.opcode == Opcode.MESSAGE_INDEX and self._chunk:
            channel = int.from_bytes(content[:2], 'little')
            self._offsets[channel] = record.start
            self._agrees &= content[6:] == self._entries.get(channel, b'')
        elif isinstance(content, DataEnd):
            self._end_chunk()
            self._data_end = record.end
            self._agrees &= content.data_section_crc in (0, record.checksum)
        elif isinstance(content, ChunkIndex):
            place = content.chunk_start_offset, content.chunk_length, content.compressed_size
            entry = *place, *_common(content), tuple(sorted(content.message_index_offsets.items()))
            self._indexes = hash((self._indexes, entry))
        elif isinstance(content, Statistics):
            self._statistics = content
        elif isinstance(content, SummaryOffset):
            self._summary_offsets = self._summary_offsets or record.start
        elif isinstance(content, Footer):
            self.is_described = self._is_described(content, record.checksum)

    def _end_chunk(self) -> None:
        if self._chunk:
            start, end, _, chunk, _ = self._chunk
            place = start, end - start, len(chunk.data)
            entry = *place, *_common(chunk), tuple(sorted(self._offsets.items()))
            self._chunks = hash((self._chunks, entry))
        self._chunk = None
        self._entries = defaultdict(bytearray)
        self._offsets = {}

    def _is_described(self, footer: Footer, checksum: int) -> bool:
        head = struct.pack('<BQQQ', 2, 20, footer.summary_start, footer.summary_offset_start)
        said = self._statistics
        return (
            self._agrees
            and footer.summary_start == self._data_end
            and footer.summary_offset_start in (self._summary_offsets, 0)
            and footer.summary_crc in (0, zlib.crc32(head, checksum))
            and self._indexes == self._chunks
            and self._topics.items() <= self._repeated.items()
            and said is not None
            and said.message_count == self.counts.total()
            and +Counter(said.channel_message_counts) == self.counts
            and (
                not self.counts
                or (said.message_start_time, said.message_end_time)
                == (min(self.first_ns.values()), max(self.last_ns.values()))
            )
        )


def _common(chunk: Chunk | ChunkIndex) -> tuple[object, ...]:
    times = chunk.message_start_time, chunk.message_end_time
    return (*times, chunk.compression, chunk.uncompressed_size)
