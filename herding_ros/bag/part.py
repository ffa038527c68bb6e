# SPDX-License-Identifier: Apache-2.0
"""One data file of a bag, in mcap, that can be completed even when the disk is full."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
import fcntl
import os
from pathlib import Path

from mcap.writer import CompressionType, Writer

from .metadata import FileInformation, RECORD_KEY, RECORD_NAME, TopicInformation
from .plain_yaml import to_yaml
from .records import MOST_BYTES

CHUNK_SIZE = 64 * 1024
"""Size of a chunk with its index [byte]. A kill loses the chunk being filled, so it is small."""

LARGEST_MESSAGE = MOST_BYTES - 1024 * 1024
"""No larger message could be read back [byte]."""

LAST_TIME_NS = 2**63 - 1
"""Times in a bag are from 0 to this one [ns]."""

RESERVE = 1024 * 1024
"""Room that is taken from the disk at a time [byte]."""

_MESSAGE = 31 + 16
"""What a message takes besides its data: its record's head and an entry in the chunk's index."""

_CHUNK = 49 + 73
"""What a chunk takes besides its records: its head and an entry in the file's index."""

_CHUNK_ENTRY = 73
"""The latter alone, which is written when the file is completed."""

_CHANNEL = 15 + 10
"""What each topic of a chunk takes: the head of its index and an entry in the file's index."""

_CHANNEL_ENTRY = 10
"""The latter alone."""

_END = 4096
"""What completes a file of no messages and no topics."""


class PartWriter:
    """A new data file.

    The messages since the last `flush()` are lost when the process is killed. Before anything is
    accepted, the room for it and for what completes the file is taken from the disk; so a full
    disk is an OSError before anything is written, after which `finish()` still works. Until then
    the file has up to `RESERVE` zero bytes at its end.
    """

    def __init__(self, path: Path) -> None:
        """Create the file; raises OSError, FileExistsError when there is one."""
        self.information = FileInformation(path.name)
        self._path = path
        self._stream = path.open('xb')
        with suppress(OSError):  # some network disks have no locks
            fcntl.flock(self._stream, fcntl.LOCK_EX)  # so that `recover` leaves it alone
        # Its chunks are ended by flush() alone.
        self._mcap = Writer(self._stream, chunk_size=2**62, compression=CompressionType.NONE)
        self._schemas: dict[str, int] = {}  # message type -> id in the file
        self._channels: dict[str, int] = {}  # topic -> id in the file
        self._written = 0  # bytes in the file
        self._chunk = _CHUNK  # at most: bytes of the open chunk
        self._chunk_messages = 0  # messages in it
        self._index = _END  # at most: bytes that complete the file after its last chunk
        self._metadata = 0  # the share of the bag's metadata in the latter
        self._reserved = 0  # bytes that the disk has given
        self._broken = False
        try:
            self._reserve(0)
            self._mcap.start(profile='ros2', library='herding_ros')
        except OSError:
            self._stream.close()
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Size of the file [byte]; until it is finished, without what completes it."""
        return self._written + self._chunk

    def add_topic(self, topic: TopicInformation, definition: str) -> None:
        """Add a topic, see `BagWriter.add_topic`. Raises OSError when the disk refuses."""
        profiles = to_yaml([dict(profile) for profile in topic.qos_profiles])
        # Twice here, and twice more in the bag's metadata, which are in the file and beside it.
        size = len(definition.encode()) + 2 * len(profiles) + len(topic.name + topic.type) + 512
        self._reserve(4 * size)
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._mcap.register_schema(
                topic.type, 'ros2msg', definition.encode()
            )
        self._channels[topic.name] = self._mcap.register_channel(
            topic.name,
            'cdr',
            self._schemas[topic.type],
            {'offered_qos_profiles': profiles, 'topic_type_hash': topic.type_hash},
        )
        self._chunk += size + _CHANNEL
        self._index += 3 * size
        self.information.topics[topic.name] = replace(topic, message_count=0)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one message, see `BagWriter.write`."""
        size = len(data) + _MESSAGE
        if size > LARGEST_MESSAGE:
            most = LARGEST_MESSAGE - _MESSAGE
            raise ValueError(f'a message must have at most {most} bytes, got {len(data)}')
        if (
            min(log_time_ns, publish_time_ns) < 0
            or max(log_time_ns, publish_time_ns) > LAST_TIME_NS
        ):
            raise ValueError(
                f'the times of a message must be 0 to {LAST_TIME_NS} ns, '
                f'got {log_time_ns} and {publish_time_ns}'
            )
        if self._written + self._chunk + self._index + size > self._reserved:
            self._reserve(size)
        self._mcap.add_message(self._channels[topic], log_time_ns, data, publish_time_ns)
        self._chunk += size
        self._chunk_messages += 1
        self.information.count(topic, log_time_ns)
        if self._chunk >= CHUNK_SIZE:
            self.flush()

    def flush(self) -> None:
        """Hand everything to the operating system. Raises OSError."""
        with self._writing():
            self._mcap.flush()
        self._written = self._stream.tell()
        if self._chunk_messages:  # else mcap has kept it: topics, if anything
            self._chunk_messages = 0
            self._chunk = _CHUNK + len(self._channels) * _CHANNEL
            self._index += _CHUNK_ENTRY + len(self._channels) * _CHANNEL_ENTRY

    def write_metadata(self, text: str) -> None:
        """Put the bag's metadata, as YAML, into the file at once. Raises OSError."""
        size = len(text.encode()) + 512
        self._reserve(3 * size)  # now, when the file is completed, and beside it
        self._index += 2 * (size - self._metadata)
        self._metadata = size
        with self._writing():
            self._mcap.add_metadata(RECORD_NAME, {RECORD_KEY: text})
        self.flush()

    def finish(self, metadata: str) -> None:
        """Complete the file with the bag's metadata and close it. A second call does nothing.

        Raises OSError when the file had to be left as it was.
        """
        if self._stream.closed:
            return
        if self._broken:
            self._stream.raw.close()  # without what it still holds
            raise OSError(f'{self._path} could not be completed')
        with self._stream:
            self._mcap.add_metadata(RECORD_NAME, {RECORD_KEY: metadata})
            self._mcap.finish()
            self._written, self._chunk = self._stream.truncate(), 0

    def _reserve(self, more: int) -> None:
        """Make sure that `more` bytes can be written and the file completed. Raises OSError."""
        size = self._written + self._chunk + self._index + more
        if size > self._reserved:
            end = size + RESERVE
            os.posix_fallocate(self._stream.fileno(), self._reserved, end - self._reserved)
            self._reserved = end

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Take note when the disk refuses what it had room for: then nothing may follow."""
        try:
            yield
        except OSError:
            self._broken = True
            raise
