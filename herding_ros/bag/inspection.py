"""Whether a data file of a bag is whole, and what it holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Channel, Chunk, ChunkIndex, Footer, Header, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from .metadata import FileInformation, from_yaml, RECORD_KEY, RECORD_NAME, TopicInformation
from .scan import Damage, is_mcap, records_of, whole_records

_POLICIES = {
    'history': ('system_default', 'keep_last', 'keep_all', 'unknown'),
    'reliability': ('system_default', 'reliable', 'best_effort', 'unknown', 'best_available'),
    'durability': ('system_default', 'transient_local', 'volatile', 'unknown', 'best_available'),
    'liveliness': (
        *('system_default', 'automatic', 'manual_by_node', 'manual_by_topic'),
        *('unknown', 'best_available'),
    ),
}
"""Names of the policies by their numbers, which the releases before Jazzy wrote."""


@dataclass
class Inspection:
    """What was found in a file.

    faults: why it is not whole, empty if it is; lost_bytes: those that make no whole record;
    schemas, channels: by their number in the file, but those that are only in chunks with a
    checksum; metadata: the last of rosbag2's maps in the file, as YAML; compression: of the
    first chunk, '', lz4 or zstd; profile: of the file's header, or ros2.
    """

    path: Path
    faults: list[str] = field(default_factory=list)
    lost_bytes: int = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: str = ''
    compression: str = ''
    profile: str = 'ros2'
    statistics: Statistics | None = None

    def add_damages(self, place: str, damages: Sequence[Damage]) -> None:
        """Take note of damages in the file, or in a chunk: then `place` says in which."""
        for damage in damages:
            self.lost_bytes += damage.end - damage.start
            self.faults.append(f'{place}bytes {damage.start} to {damage.end}: {damage.reason}')

    def information(self) -> FileInformation:
        """Return what the file's own summary says of its messages, if the file is whole."""
        assert self.statistics is not None
        counts = self.statistics.channel_message_counts
        file = FileInformation(self.path.name, self.statistics.message_count)
        if file.message_count:
            file.first_ns = self.statistics.message_start_time
            file.last_ns = self.statistics.message_end_time
        for number, channel in self.channels.items():
            topic = topic_information(channel, self.schemas[channel.schema_id])
            file.topics.setdefault(topic.name, topic).message_count += counts.get(number, 0)
        return file


def inspect(path: Path, progress: Callable[[int], None] = lambda position: None) -> Inspection:
    """Read a file from one end to the other, in bounded memory.

    `progress` is told the bytes that have been read. Raises ValueError when it is no mcap file,
    OSError when it cannot be read.
    """
    found = Inspection(path)
    chunks: list[tuple[Any, ...]] = []
    indexed: list[tuple[Any, ...]] = []
    damages: list[Damage] = []
    end = 0
    with path.open('rb') as stream:
        if not is_mcap(stream):
            raise ValueError(f'{path} is no mcap file')
        for start, position, record in whole_records(stream, damages):
            progress(position)
            if isinstance(record, Chunk):
                chunks.append(_facts_of_chunk(start, position, record))
                found.compression = found.compression if len(chunks) > 1 else record.compression
                if not record.uncompressed_crc:
                    _look_into(record, start, found)
            elif isinstance(record, ChunkIndex):
                indexed.append(_facts_of_index(record))
            elif isinstance(record, Footer):
                end = position
            else:
                _note(record, found)
        stream.seek(end)
        closed = end > 0 and stream.read(len(MCAP0_MAGIC) + 1) == MCAP0_MAGIC
    found.add_damages('', damages)
    if not closed:
        found.faults.append('it has no end')
    elif found.statistics is None:
        found.faults.append('it has no statistics')
    if closed and indexed and indexed != chunks:
        found.faults.append('its index is not that of its chunks')
    if any(channel.schema_id not in found.schemas for channel in found.channels.values()):
        found.faults.append('it lacks the type of a topic')
    return found


def topic_information(channel: Channel, schema: Schema) -> TopicInformation:
    """Return a topic by its records in a file; its messages are not counted."""
    try:
        profiles = from_yaml(channel.metadata.get('offered_qos_profiles', '')) or []
        named = [_named(dict(profile)) for profile in profiles]
    except (TypeError, ValueError):
        named = []
    type_hash = channel.metadata.get('topic_type_hash', '')
    return TopicInformation(channel.topic, schema.name, named, type_hash)


def _named(profile: dict[str, Any]) -> dict[str, Any]:
    for policy, names in _POLICIES.items():
        number = profile.get(policy)
        if isinstance(number, int):
            profile[policy] = names[number] if 0 <= number < len(names) else 'unknown'
    return profile


def _note(record: object, found: Inspection) -> None:
    if isinstance(record, Header):
        found.profile = record.profile
    elif isinstance(record, Schema):
        found.schemas[record.id] = record
    elif isinstance(record, Channel):
        found.channels[record.id] = record
    elif isinstance(record, Statistics):
        found.statistics = record
    elif isinstance(record, Metadata) and record.name == RECORD_NAME:
        found.metadata = record.metadata.get(RECORD_KEY, '')


def _look_into(chunk: Chunk, start: int, found: Inspection) -> None:
    """Check a chunk that has no checksum by its records."""
    damages: list[Damage] = []
    for record in records_of(chunk, damages):
        _note(record, found)
    found.add_damages(f'the chunk at byte {start}, ', damages)


def _facts_of_chunk(start: int, end: int, chunk: Chunk) -> tuple[Any, ...]:
    stored = end - start - 9 - 40 - len(chunk.compression)
    return start, end - start, chunk.compression, stored, chunk.uncompressed_size


def _facts_of_index(index: ChunkIndex) -> tuple[Any, ...]:
    return (
        *(index.chunk_start_offset, index.chunk_length, index.compression),
        *(index.compressed_size, index.uncompressed_size),
    )
