# SPDX-License-Identifier: Apache-2.0
"""Writing a rosbag2 bag that a stock ROS 2 Jazzy lists, plays and reindexes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import os
from pathlib import Path
import shutil
from types import TracebackType
from typing import Any

from .metadata import (
    all_topics,
    bag_map,
    FileInformation,
    TopicInformation,
    write_metadata,
)
from .part import PartWriter
from .plain_yaml import to_yaml


class BagWriter:
    """A new rosbag2 bag: the folder `path` with mcap files and metadata.yaml.

    To be used in a `with` statement. A killed process loses what came after the last `flush()`,
    and the last 64 KiB at most. metadata.yaml is written when a file is complete and lists those
    that are; `close()` completes the last one. After an OSError nothing more can be written, but
    `close()` still makes what was written a complete bag, if the disk was full.
    """

    _part: PartWriter

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
        self._topics: dict[str, tuple[TopicInformation, str]] = {}  # with their definitions
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
    def topics(self) -> dict[str, int]:
        """Number of messages written, by topic."""
        return {name: topic.message_count for name, topic in all_topics(self._files).items()}

    def add_topic(
        self,
        name: str,
        type_name: str,
        definition: str,
        qos_profiles: Sequence[Mapping[str, Any]],
        type_hash: str,
    ) -> None:
        """Add a topic, before its first message.

        `type_name` is of the form package/msg/Type, `definition` its own with those of the
        types it uses (see `definitions.message_definition`), `qos_profiles` as in
        `TopicInformation`, `type_hash` of the form RIHS01_<hexadecimal digits>.

        Raises ValueError when the topic is there already, OSError when the disk refuses.
        """
        if name in self._topics:
            raise ValueError(f'topic {name!r} is in the bag {self.path} already')
        topic = TopicInformation(name, type_name, qos_profiles, type_hash)
        self._part.add_topic(topic, definition)
        self._topics[name] = topic, definition

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
        part = PartWriter(self.path / f'{self.path.name}_{len(self._files)}.mcap')
        if self._files:
            self._earlier_size += self._part.size
        self._part = part
        self._files.append(part.information)
        for topic, definition in self._topics.values():
            part.add_topic(topic, definition)
        if self._custom_data:
            part.write_metadata(to_yaml(self._bag_map()))

    def _complete_part(self) -> None:
        self._part.finish(to_yaml(self._bag_map()))
        write_metadata(self.path, self._bag_map())

    def _bag_map(self) -> dict[str, Any]:
        return bag_map(self._files, self._custom_data)
