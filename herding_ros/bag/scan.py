"""The records of an mcap file that may be cut off, damaged or made to do harm.

mcap's own reader stops at the first fault, and takes the room that a record asks for. Here what is
whole is read, whatever lies between, in memory that depends on `MOST_BYTES` alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from io import BytesIO
import re
import struct
from typing import BinaryIO, NamedTuple
import zlib

import lz4.frame  # type: ignore[import-untyped]
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC
import zstandard

MOST_BYTES = 256 * 1024 * 1024
"""No record is read that is larger, nor a chunk that is when decompressed [byte]."""

_PARSERS: dict[int, Callable[..., McapRecord]] = {
    Opcode.HEADER: Header.read,
    Opcode.FOOTER: Footer.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.METADATA: Metadata.read,
    Opcode.DATA_END: DataEnd.read,
}

_SKIPPED = {
    *(Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT_INDEX),
    *(Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET),
}
"""Records that tell nothing new."""

_HEAD = struct.Struct('<BQ')
"""What each record begins with: its kind and the number of bytes that follow."""

_CHUNK_HEAD = struct.Struct('<QQQII')
_CHUNK_SIZES = _CHUNK_HEAD.size + 8
_COMPRESSIONS = {'', 'lz4', 'zstd'}
_MAYBE_CHUNK = re.compile(rb'\x06(?=.{4}\x00{4})', re.DOTALL)
_BLOCK = 1024 * 1024


@dataclass(frozen=True)
class Damage:
    """Bytes of a file, from `start` up to `end`, that make no whole record, and why."""

    start: int
    end: int
    reason: str


class Found(NamedTuple):
    """A whole record, and where it is in the file: from `start` up to `end`."""

    start: int
    end: int
    record: McapRecord


class _BrokenError(Exception):
    """A record that is not whole; `end` is where the next one begins, 0 if nobody knows."""

    def __init__(self, reason: str, end: int = 0) -> None:
        super().__init__(reason)
        self.end = end


def is_mcap(stream: BinaryIO) -> bool:
    """Whether a file begins as mcap does; one of fewer than eight bytes may have been cut off."""
    stream.seek(0)
    return MCAP0_MAGIC.startswith(stream.read(len(MCAP0_MAGIC)))


def whole_records(stream: BinaryIO, damages: list[Damage]) -> Iterator[Found]:
    """Yield the whole records of a file up to its footer, and append to `damages` what is not.

    Indexes of messages, attachments and metadata are left out. Whatever its compression, the
    data of a chunk come decompressed. Zero bytes at the end of the file are no damage: a recorder
    that was killed had reserved them.
    """
    size = stream.seek(0, 2)
    yield from _records(stream, len(MCAP0_MAGIC), size, damages, _next_chunk)
    if damages and damages[-1].end == size:
        last = damages.pop()
        end = _end_of_data(stream, last.start, size)
        if end > last.start:
            damages.append(replace(last, end=end))


def records_of(chunk: Chunk, damages: list[Damage]) -> Iterator[McapRecord]:
    """Yield the schemas, channels and messages of a chunk as `whole_records` returns it.

    Damages are those within the chunk.
    """
    stream, size = BytesIO(chunk.data), len(chunk.data)
    for found in _records(stream, 0, size, damages, lambda _, __, end: end):
        yield found.record


def _records(
    stream: BinaryIO,
    position: int,
    size: int,
    damages: list[Damage],
    find_next: Callable[[BinaryIO, int, int], int],
) -> Iterator[Found]:
    while position < size:
        try:
            record, end = _record(stream, position, size)
        except _BrokenError as error:
            end = error.end or find_next(stream, position + 1, size)
            damages.append(Damage(position, end, str(error)))
        else:
            if record is not None:
                yield Found(position, end, record)
            if isinstance(record, Footer):
                return
        position = end


def _record(stream: BinaryIO, position: int, size: int) -> tuple[McapRecord | None, int]:
    """Return the record at a position, None for one that is left out, and where it ends."""
    stream.seek(position)
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise _BrokenError('the file ends within a record', size)
    kind, length = _HEAD.unpack(head)
    end = position + _HEAD.size + length
    own = kind >= 0x80  # others' own records, to be skipped
    if kind not in _PARSERS and kind not in _SKIPPED and kind != Opcode.MESSAGE and not own:
        raise _BrokenError(f'there is no kind {kind} of records')
    if end > size:
        raise _BrokenError(f'a record of {length} bytes does not fit into the file')
    if own or kind in _SKIPPED:
        if kind == Opcode.MESSAGE_INDEX:
            _check_message_index(stream, length)
        return None, end
    if length > MOST_BYTES:
        raise _BrokenError(f'a record has {length} bytes, allowed are {MOST_BYTES}')
    try:
        return _parsed(kind, stream.read(length)), end
    except ValueError as error:
        # Is it the content or the length that is wrong? If the next record follows, the former.
        known = end if _is_head(stream, end, size) else 0
        raise _BrokenError(
            f'a broken {Opcode(kind).name.lower()} record: {error}', known
        ) from None


def _parsed(kind: int, content: bytes) -> McapRecord:
    """Return a record by its content; raises ValueError."""
    fields = _Fields(content)
    if kind == Opcode.MESSAGE:
        if len(content) < 22:
            raise ValueError(f'it has {len(content)} bytes, fewer than 22')
        return Message.read(fields, len(content))
    record = _PARSERS[kind](fields)
    if fields.count != len(content):
        raise ValueError(f'it has {len(content)} bytes, of which {fields.count} are used')
    return _decompressed(record) if isinstance(record, Chunk) else record


class _Fields(ReadDataStream):
    """Gives all bytes that are asked for, or none."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        left = self._size - self.count
        if length > left:
            raise ValueError(f'a field has {length} bytes, of which {left} are there')
        return super().read(length)


def _decompressed(chunk: Chunk) -> Chunk:
    """Return a chunk with its data as they were, checked; raises ValueError."""
    size = chunk.uncompressed_size
    if size > MOST_BYTES:
        raise ValueError(f'it has {size} bytes when decompressed, allowed are {MOST_BYTES}')
    # One byte more than it should be: so a bomb goes off in our hands, but is a small one.
    data: bytes
    try:
        if chunk.compression == '':
            data = chunk.data
        elif chunk.compression == 'zstd':
            with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
                data = reader.read(size + 1)
        elif chunk.compression == 'lz4':
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
        else:
            raise ValueError(f'unknown compression {chunk.compression!r}')
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ValueError(f'it cannot be decompressed: {error}') from error
    if len(data) != size:
        raise ValueError('it has another size than it says')
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError('its checksum is wrong')
    return replace(chunk, data=data)


def _check_message_index(stream: BinaryIO, length: int) -> None:
    """Raise _BrokenError unless the record at the stream's position is an index of messages."""
    head = stream.read(6)
    if length < 6 or struct.unpack('<HI', head)[1] != length - 6:
        raise _BrokenError('a broken message_index record')


def _is_head(stream: BinaryIO, position: int, size: int) -> bool:
    """Whether a record begins at a position, or the file ends there."""
    if position == size:
        return True
    stream.seek(position)
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return False
    kind, length = _HEAD.unpack(head)
    known = kind in _PARSERS or kind in _SKIPPED or kind == Opcode.MESSAGE
    return known and position + _HEAD.size + length <= size


def _next_chunk(stream: BinaryIO, position: int, size: int) -> int:
    """Return where the first chunk from a position on begins; the size if there is none."""
    while position < size:
        stream.seek(position)
        block = stream.read(_BLOCK + _HEAD.size)
        for match in _MAYBE_CHUNK.finditer(block):
            if match.start() < _BLOCK and _is_chunk(stream, position + match.start(), size):
                return position + match.start()
        position += _BLOCK
    return size


def _is_chunk(stream: BinaryIO, position: int, size: int) -> bool:
    """Whether there is a chunk at a position, by the sizes in its head."""
    stream.seek(position)
    head = stream.read(_HEAD.size + _CHUNK_HEAD.size + 4 + 8)
    if len(head) < _HEAD.size + _CHUNK_SIZES:
        return False
    kind, length = _HEAD.unpack_from(head)
    *_, name_length = _CHUNK_HEAD.unpack_from(head, _HEAD.size)
    if kind != Opcode.CHUNK or name_length > 4 or position + _HEAD.size + length > size:
        return False
    name = head[_HEAD.size + _CHUNK_HEAD.size :][:name_length]
    (data_length,) = struct.unpack_from('<Q', head, _HEAD.size + _CHUNK_HEAD.size + name_length)
    known = name.decode(errors='replace') in _COMPRESSIONS
    return bool(known and length == _CHUNK_SIZES + name_length + data_length)


def _end_of_data(stream: BinaryIO, start: int, size: int) -> int:
    """Return where the last byte after `start` ends that is not zero, or `start`."""
    end = start
    for position in range(start, size, _BLOCK):
        stream.seek(position)
        used = len(stream.read(_BLOCK).rstrip(b'\0'))
        end = position + used if used else end
    return end
