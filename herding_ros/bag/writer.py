"""Writing a rosbag2 bag that a stock ROS 2 Jazzy lists, plays and reindexes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import os
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, Writer

from .metadata import bag_map, FILE_NAME, FileInformation, ROOT_KEY, to_yaml, TopicInformation

CHUNK_SIZE = 64 * 1024
"""Size of a chunk [byte]. A kill loses the chunk being filled, so it is small."""


class BagWriter:
    """A new rosbag2 bag: the folder `path` with one mcap file and metadata.yaml.

    To be used in a `with` statement. Each full chunk is handed to the operating system at
    once, so that a killed process loses the last chunk at most; metadata.yaml is written by
    `close()`.
    """

    def __init__(
        self, path: str | os.PathLike[str], custom_data: Mapping[str, str] | None = None
    ) -> None:
        """Create the folder and start the file.

        `custom_data` are texts kept in the bag's metadata.

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
        self._custom_data = dict(custom_data or {})
        self._file = FileInformation(f'{self.path.name}_0.mcap')
        self._stream = open(self.path / self._file.path, 'xb')  # noqa: SIM115, closed in close()
        self._mcap = Writer(self._stream, chunk_size=CHUNK_SIZE, compression=CompressionType.NONE)
        self._mcap.start(profile='ros2', library='herding_ros')
        self._schemas: dict[str, int] = {}  # message type -> id in the file
        self._channels: dict[str, int] = {}  # topic -> id in the file
        self._closed = False

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
    def message_count(self) -> int:
        """Number of messages written."""
        return self._file.message_count

    @property
    def size(self) -> int:
        """Size of the data file [byte]."""
        return (self.path / self._file.path).stat().st_size

    @property
    def topics(self) -> dict[str, int]:
        """Number of messages written, by topic."""
        return {name: topic.message_count for name, topic in self._file.topics.items()}

    def add_topic(
        self,
        name: str,
        type_name: str,
        definition: str,
        qos_profiles: Sequence[Mapping[str, Any]],
        type_hash: str,
    ) -> None:
        """Add a topic, before its first message.

        `type_name` is of the form package/msg/Type, `definition` its text with those of the
        types it uses (see `definitions.message_definition`), `qos_profiles` as in
        `TopicInformation`, `type_hash` of the form RIHS01_<hexadecimal digits>.

        Raises ValueError when the topic is there already.
        """
        if name in self._channels:
            raise ValueError(f'topic {name!r} is in the bag {self.path} already')
        if type_name not in self._schemas:
            self._schemas[type_name] = self._mcap.register_schema(
                type_name, 'ros2msg', definition.encode()
            )
        topic = TopicInformation(name, type_name, qos_profiles, type_hash)
        self._channels[name] = self._mcap.register_channel(
            name,
            'cdr',
            self._schemas[type_name],
            {
                'offered_qos_profiles': to_yaml([dict(profile) for profile in qos_profiles]),
                'topic_type_hash': type_hash,
            },
        )
        self._file.topics[name] = topic

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one message in CDR, with its times [ns].

        Raises KeyError when the topic has not been added, OSError when the disk refuses.
        """
        self._mcap.add_message(self._channels[topic], log_time_ns, data, publish_time_ns)
        self._stream.flush()  # costs nothing while the chunk fills
        self._file.count(topic, log_time_ns)

    def set_custom_data(self, custom_data: Mapping[str, str]) -> None:
        """Replace the texts kept in the bag's metadata.

        They go into the file at once: so they are there even if the bag is never closed.
        """
        self._custom_data = dict(custom_data)
        self._write_metadata_record()
        self._stream.flush()

    def close(self) -> None:
        """Complete the file and write metadata.yaml. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        with self._stream:
            self._write_metadata_record()
            self._mcap.finish()
        # Under its final name only when complete: a half-written map stops every reader.
        partial = self.path / (FILE_NAME + '.partial')
        partial.write_text(to_yaml({ROOT_KEY: self._bag_map()}), encoding='utf-8')
        partial.replace(self.path / FILE_NAME)

    def _bag_map(self) -> dict[str, Any]:
        return bag_map(self._file, self._custom_data)

    def _write_metadata_record(self) -> None:
        # Readers take the last record of this name; rosbag2 too writes several.
        self._mcap.add_metadata('rosbag2', {'serialized_metadata': to_yaml(self._bag_map())})
