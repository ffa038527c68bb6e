# SPDX-License-Identifier: Apache-2.0
"""Writing a rosbag2 bag that a stock ROS 2 Jazzy lists, plays and reindexes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
import fcntl
import os
from pathlib import Path
import shutil
from types import TracebackType
from typing import Any, NamedTuple

from mcap.writer import CompressionType, Writer

from .inspection import MOST_BYTES
from .metadata import (
    bag_map,
    FileInformation,
    HASH_KEY,
    PROFILES_KEY,
    RECORD_KEY,
    RECORD_NAME,
    to_yaml,
    total_counts,
    write_metadata,
)

CHUNK_SIZE = 64 * 1024
"""Size of a chunk [byte]. A kill loses the chunk being filled, so it is small."""

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

_CHANNEL = 15 + 10
"""What each topic takes in each chunk: the head of its index and an entry in the file's index."""

_END = 4096
"""What completes a file of no messages and no topics."""


class NewTopic(NamedTuple):
    """A topic to be recorded.

    type_name: of the form package/msg/Type; definition: its own with those of the types it uses
    (see `definitions.message_definition`); type_hash: of the form RIHS01_<hexadecimal digits>;
    qos_profiles: one map for each publisher, with the keys history, depth, reliability,
    durability, deadline, lifespan, liveliness, liveliness_lease_duration (the policies by their
    names in small letters, the durations as {sec, nsec}) and avoid_ros_namespace_conventions.
    """

    name: str
    type_name: str
    definition: str
    qos_profiles: Sequence[Mapping[str, Any]]
    type_hash: str


class BagWriter:
    """A new rosbag2 bag: the folder `path` with mcap files and metadata.yaml.

    To be used in a `with` statement. A killed process loses what came after the last `flush()`,
    and the last 64 KiB at most. metadata.yaml is written when a file is complete and lists those
    that are; `close()` completes the last one. After an OSError nothing more can be written, but
    `close()` still makes what was written a complete bag, if the disk was full.
    """

    _part: _File

    def __init__(
        self,
        path: str | os.PathLike[str],
        custom_data: Mapping[str, str] | None = None,
        max_size: int = 0,
        max_duration_ns: int = 0,
    ) -> None:
        """Create the folder and start the first file.

        `custom_data` are strings kept in the bag's metadata. A file that has reached `max_size`
        bytes, or would span more than `max_duration_ns` in log time, is followed by another one;
        0: never.

        Raises FileExistsError when something is at `path` already, another OSError when the
        folder cannot be made or written.
        """
        self.path = Path(path).absolute()
        try:
            self.path.mkdir(parents=True)
        except FileExistsError as error:
            raise FileExistsError(
                f'{error.filename} exists already and is not overwritten; '
                'give the bag another path or move the old one away'
            ) from None
        except OSError as error:
            raise type(error)(f'cannot create the bag {self.path}: {error.strerror}') from error
        self.message_count = 0
        """Number of messages written."""
        self._custom_data = dict(custom_data or {})
        self._max_size = max_size
        self._max_duration_ns = max_duration_ns
        self._topics: dict[str, NewTopic] = {}  # by name
        self._files: list[FileInformation] = []  # the last one is that of the open part
        self._earlier_size = 0  # of the files before the open one
        self._closed = False
        try:
            self._open_part()
        except OSError as error:
            shutil.rmtree(self.path)
            raise type(error)(f'cannot write the bag {self.path}: {error.strerror}') from error

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def size(self) -> int:
        """Size of the data files [byte]."""
        return self._earlier_size + self._part.size

    @property
    def file_count(self) -> int:
        """Number of data files."""
        return len(self._files)

    @property
    def added_topics(self) -> tuple[NewTopic, ...]:
        """What was added, in that order."""
        return tuple(self._topics.values())

    @property
    def topics(self) -> dict[str, int]:
        """Number of messages written, by topic."""
        return dict(total_counts(self._files))

    def add_topic(
        self,
        name: str,
        type_name: str,
        definition: str,
        qos_profiles: Sequence[Mapping[str, Any]],
        type_hash: str,
    ) -> None:
        """Add a topic, before its first message; what is given is that of `NewTopic`.

        Raises ValueError when the topic is there already, OSError when the disk refuses.
        """
        if name in self._topics:
            raise ValueError(f'topic {name!r} is in the bag {self.path} already')
        topic = NewTopic(name, type_name, definition, qos_profiles, type_hash)
        self._part.add_topic(topic)
        self._topics[name] = topic

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one message in CDR, with its times [ns].

        Raises KeyError when the topic has not been added, ValueError when the message is larger
        than could be read back or its times are no times, OSError when the disk refuses.
        """
        if self._is_full(log_time_ns):
            self._complete_part()
            self._open_part()
        self._part.write(topic, data, log_time_ns, publish_time_ns)
        self.message_count += 1

    def flush(self) -> None:
        """Make sure that a kill costs nothing of what was written. Raises OSError."""
        self._part.flush()

    def set_custom_data(self, custom_data: Mapping[str, str]) -> None:
        """Replace the strings kept in the bag's metadata.

        They go into the file at once: so they are there even if the bag is never closed.
        Raises OSError when the disk refuses.
        """
        self._custom_data = dict(custom_data)
        self._part.write_metadata(to_yaml(self._bag_map()))

    def close(self) -> None:
        """Complete the last file and write metadata.yaml. A second call does nothing.

        Raises OSError when the disk has failed in the middle of something; the bag is then to be
        recovered.
        """
        if not self._closed:
            self._closed = True
            self._complete_part()

    def _is_full(self, log_time_ns: int) -> bool:
        """Whether a message of this time begins a new file, as in `ros2 bag record`."""
        file = self._files[-1]
        if not (self._max_size or self._max_duration_ns) or not file.message_count:
            return False
        too_long = 0 < self._max_duration_ns < log_time_ns - file.first_ns
        return too_long or 0 < self._max_size <= self._part.size

    def _open_part(self) -> None:
        part = _File(self.path / f'{self.path.name}_{len(self._files)}.mcap')
        if self._files:
            self._earlier_size += self._part.size
        self._part = part
        self._files.append(part.information)
        for topic in self._topics.values():
            part.add_topic(topic)
        if self._custom_data:
            part.write_metadata(to_yaml(self._bag_map()))

    def _complete_part(self) -> None:
        self._part.finish(to_yaml(self._bag_map()))
        write_metadata(self.path, self._bag_map())

    def _bag_map(self) -> dict[str, Any]:
        return bag_map(self._files, {'custom_data': self._custom_data})


class _File:
    """A new data file.

    Before anything is accepted, the room for it and for what completes the file is taken from the
    disk; so a full disk is an OSError before anything is written, after which `finish()` still
    works. Until then the file has up to `RESERVE` zero bytes at its end.
    """

    def __init__(self, path: Path) -> None:
        self.information = FileInformation(path.name)
        self._path = path
        self._stream = path.open('xb')
        with suppress(OSError):  # some network disks have no locks
            fcntl.flock(self._stream, fcntl.LOCK_EX)  # so that `recover` leaves it alone
        self._mcap = Writer(
            self._stream,
            chunk_size=2**62,  # flush() alone ends them
            compression=CompressionType.NONE,
            enable_data_crcs=True,
        )
        self._schemas: dict[str, int] = {}  # message type -> id in the file
        self._channels: dict[str, int] = {}  # topic -> id in the file
        self._chunk = 0  # bytes of the open chunk
        self._final = 0  # at most: bytes of the file if it were completed now
        self._reserved = 0  # bytes that the disk has given
        self._broken = False  # the disk refused what it had room for: nothing may follow
        try:
            self._take(_END)
            self._mcap.start(profile='ros2', library='herding_ros')
            self._written = self._stream.tell()
        except OSError:
            self._stream.close()
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Size of the file [byte]; until it is finished, without what completes it."""
        return self._written + self._chunk

    def add_topic(self, topic: NewTopic) -> None:
        """Add a topic, see `BagWriter.add_topic`."""
        name, type_name, definition, qos_profiles, type_hash = topic
        profiles = to_yaml([dict(profile) for profile in qos_profiles])
        # Twice here, and twice more in the bag's metadata, which are in the file and beside it.
        size = len(definition.encode()) + 2 * len(profiles) + len(name + type_name) + 512
        self._take(4 * size + _CHANNEL + self._new_chunk)
        if type_name not in self._schemas:
            self._schemas[type_name] = self._mcap.register_schema(
                type_name, 'ros2msg', definition.encode()
            )
        self._channels[name] = self._mcap.register_channel(
            name,
            'cdr',
            self._schemas[type_name],
            {PROFILES_KEY: profiles, HASH_KEY: type_hash},
        )
        self._chunk += size
        self.information.add_topic(name, type_name, qos_profiles, type_hash)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one message, see `BagWriter.write`."""
        size = len(data) + _MESSAGE
        if size > LARGEST_MESSAGE:
            most = LARGEST_MESSAGE - _MESSAGE
            raise ValueError(f'a message must have at most {most} bytes, got {len(data)}')
        for time in (log_time_ns, publish_time_ns):
            if not 0 <= time <= LAST_TIME_NS:
                raise ValueError(f'times must be 0 to {LAST_TIME_NS} ns, got {time}')
        self._take(size + self._new_chunk)
        self._mcap.add_message(self._channels[topic], log_time_ns, data, publish_time_ns)
        self._chunk += size
        self.information.count(topic, log_time_ns)
        if self._chunk >= CHUNK_SIZE:
            self.flush()

    def flush(self) -> None:
        """Hand everything to the operating system. Raises OSError."""
        self._broken = True
        self._mcap.flush()
        self._stream.flush()
        self._broken = False
        self._written, self._chunk = self._stream.tell(), 0

    def write_metadata(self, text: str) -> None:
        """Put the bag's metadata, as YAML, into the file at once. Raises OSError."""
        self._take(3 * (len(text.encode()) + 512))  # now, when it is completed, and beside it
        self._broken = True
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

    @property
    def _new_chunk(self) -> int:
        """What a chunk takes besides its records, if the next record begins one."""
        return 0 if self._chunk else _CHUNK + len(self._channels) * _CHANNEL

    def _take(self, more: int) -> None:
        """Make sure that `more` bytes can be written and the file completed. Raises OSError."""
        if self._final + more > self._reserved:
            room = self._final + more + RESERVE - self._reserved
            os.posix_fallocate(self._stream.fileno(), self._reserved, room)
            self._reserved += room
        self._final += more
