# SPDX-License-Identifier: Apache-2.0
"""Making a bag whole that was cut off or damaged: what is whole in it is copied."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
import fcntl
import json
import os
from pathlib import Path
import re
from typing import Any

from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, Metadata
from mcap.writer import CompressionType, Writer

from .inspection import inspect, Inspection, Open, open_file
from .metadata import (
    bag_map,
    FILE_NAME,
    file_names,
    FileInformation,
    read_metadata,
    RECORD_KEY,
    RECORD_NAME,
    ROS_DISTRO,
    string_map,
    topic_information,
    VERSION,
    write_metadata,
)
from .plain_yaml import from_yaml, to_yaml
from .records import DamageError, records, records_in

BROKEN = '.broken'
"""What the name of a file ends with that was replaced by a whole one."""

_PARTIAL = '.partial'
_CHUNK_SIZE = 1024 * 1024
_COMPRESSIONS = {'lz4': CompressionType.LZ4, 'zstd': CompressionType.ZSTD}


@dataclass(frozen=True)
class Result:
    """What became of one data file.

    faults: what was wrong with it, nothing if it was whole and left alone; lost_bytes: of its
    data that were of no use; lost_messages: those whose topic is nowhere in the file; kept: where
    the broken file is now.
    """

    information: FileInformation
    faults: Sequence[str] = ()
    lost_bytes: int = 0
    lost_messages: int = 0
    kept: Path | None = None


@dataclass(frozen=True)
class Recovery:
    """What became of a bag: its files, in their order, and whether metadata.yaml is new."""

    results: Sequence[Result]
    new_metadata: bool

    @property
    def was_whole(self) -> bool:
        """Whether there was nothing to do."""
        return not self.new_metadata and not any(result.faults for result in self.results)


def recover(folder: Path, opening: Open = open_file) -> Recovery:
    """Make the bag in a folder whole, in bounded memory. Nothing in it is ever overwritten.

    A data file that is not whole is copied up to where its records end, without the chunks that
    are damaged, and then keeps its content under a name that ends with `.broken`. Links are not
    followed, and nothing outside of the folder is read or written.

    Raises ValueError when the folder does not hold a bag in mcap, or one that is being recorded,
    and OSError when it cannot be read or written.
    """
    inspections = [inspect(path, opening) for path in _data_files(folder)]
    try:
        old = read_metadata(folder)
    except (FileNotFoundError, ValueError):
        old = {}
    broken = [one.path for one in inspections if one.faults]
    _check_names_are_free([*broken, folder / FILE_NAME] if broken else [])
    remark = _Remark.of(inspections, old)
    results: list[Result] = []
    for one in inspections:
        earlier = [result.information for result in results]
        results.append(
            _rewrite(one, earlier, remark, opening) if one.faults else Result(one.information())
        )
    content = remark.bag_map([result.information for result in results])
    is_new = not _describes_the_same(old, content)
    if is_new:
        if (folder / FILE_NAME).exists():
            _check_names_are_free([folder / FILE_NAME])
            _keep(folder / FILE_NAME)
        write_metadata(folder, content)
    return Recovery(results, is_new)


def _data_files(folder: Path) -> list[Path]:
    """Return the data files of a bag in the order of their numbers; raises ValueError."""
    if not folder.is_dir():
        what = 'is a file; give the folder it is in' if folder.is_file() else 'does not exist'
        raise ValueError(f'{folder} {what}')
    for broken in (*folder.glob('*.mcap' + BROKEN), *folder.glob(FILE_NAME + BROKEN)):
        original = broken.with_name(broken.name.removesuffix(BROKEN))
        if not original.exists():  # an earlier recovery was ended half-way
            broken.rename(original)
    paths = sorted(folder.glob('*.mcap'), key=_number)
    if not paths:
        raise ValueError(f'{folder} is not a bag in mcap: it has no .mcap file')
    for path in paths:
        if path.is_symlink() or not path.is_file():
            raise ValueError(f'{path} must be a file in the bag; recover the bag that it is in')
        with path.open('rb') as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ValueError(f'{path} is being recorded; end the recorder first') from None
            except OSError:  # a disk without locks
                pass
    return paths


def _number(path: Path) -> tuple[int, str]:
    match = re.search(r'_([0-9]{1,9})\.mcap$', path.name)
    return (int(match[1]) if match else -1), path.name


def _check_names_are_free(paths: Sequence[Path]) -> None:
    for path in paths:
        kept = path.with_name(path.name + BROKEN)
        if kept.exists():
            raise FileExistsError(f'{kept} exists already and is not overwritten; move it away')


@dataclass(frozen=True)
class _Remark:
    """What a bag's map says that need not follow from the records of its data files."""

    custom_data: dict[str, str]
    ros_distro: str
    compression: tuple[str, str]
    type_hashes: dict[str, str]  # by topic

    @classmethod
    def of(cls, files: Sequence[Inspection], old: dict[str, Any]) -> _Remark:
        """Return it from the last map that is kept in a file, or else from metadata.yaml."""
        content = old
        for file in files:
            with suppress(TypeError, ValueError):
                content = dict(from_yaml(file.metadata)) if file.metadata else content
        hashes: dict[str, str] = {}
        with suppress(AttributeError, KeyError, TypeError):
            for each in content['topics_with_message_count']:
                topic = each['topic_metadata']
                hashes[str(topic['name'])] = str(topic.get('type_description_hash', ''))
        return cls(
            string_map(content.get('custom_data')),
            str(content.get('ros_distro') or ROS_DISTRO),
            (
                str(content.get('compression_format') or ''),
                str(content.get('compression_mode') or ''),
            ),
            hashes,
        )

    def bag_map(self, files: Sequence[FileInformation]) -> dict[str, Any]:
        """Return the map of a bag of these files."""
        for topic in [topic for file in files for topic in file.topics.values()]:
            topic.type_hash = topic.type_hash or self.type_hashes.get(topic.name, '')
        return bag_map(files, self.custom_data, self.ros_distro, self.compression)


def _describes_the_same(old: dict[str, Any], new: dict[str, Any]) -> bool:
    """Whether a map says what the new one says; older versions say it in other words."""
    try:
        if old['version'] == VERSION:
            return _sorted(old) == _sorted(new)
        return (
            1 <= old['version'] < VERSION
            and all(old[key] == new[key] for key in ('storage_identifier', 'message_count'))
            and all(old[key] == new[key] for key in ('starting_time', 'duration'))
            and file_names(old) == file_names(new)
            and _counts(old) == _counts(new)
        )
    except (KeyError, TypeError):
        return False


def _sorted(content: dict[str, Any]) -> dict[str, Any]:
    """Return a map with its topics in the order of their names."""
    topics = content.get('topics_with_message_count')
    in_order = sorted(json.dumps(topic, sort_keys=True) for topic in topics or [])
    return {**content, 'topics_with_message_count': in_order}


def _counts(content: dict[str, Any]) -> dict[tuple[str, str, str], int]:
    """Return the number of messages by name, type and format of the topic."""
    counts = {}
    for each in content['topics_with_message_count']:
        topic = each['topic_metadata']
        if not isinstance(topic['offered_qos_profiles'], str) and content['version'] < VERSION:
            raise TypeError('before version 9 the profiles are a string')
        counts[topic['name'], topic['type'], topic['serialization_format']] = each['message_count']
    return counts


def _rewrite(
    broken: Inspection, earlier: Sequence[FileInformation], remark: _Remark, opening: Open
) -> Result:
    """Replace a file by a copy of what is whole in it."""
    path = broken.path
    unfinished = path.with_name(path.name + _PARTIAL)
    with _new_file(unfinished) as target:
        mcap = Writer(
            target,
            chunk_size=_CHUNK_SIZE,
            compression=_COMPRESSIONS.get(broken.compression, CompressionType.NONE),
        )
        mcap.start(profile=broken.profile, library='herding_ros recover')
        copy = _Copy(mcap, broken)
        with opening(path) as source, suppress(DamageError):
            for found in records(source):
                if isinstance(found.record, DataEnd):
                    break
                copy.add(found.record)
        copy.add_topics()
        content = remark.bag_map([*earlier, copy.information])
        mcap.add_metadata(RECORD_NAME, {RECORD_KEY: to_yaml(content)})
        mcap.finish()
        target.flush()
        os.fsync(target.fileno())
    kept = _keep(path)
    unfinished.rename(path)
    return Result(copy.information, broken.faults, broken.lost_bytes, copy.lost, kept)


@contextmanager
def _new_file(path: Path) -> Iterator[Any]:
    """Open a file that is removed when something goes wrong."""
    path.unlink(missing_ok=True)
    with path.open('xb') as stream:
        try:
            yield stream
        except BaseException:
            path.unlink()
            raise


def _keep(path: Path) -> Path:
    kept = path.with_name(path.name + BROKEN)
    path.rename(kept)
    return kept


class _Copy:
    """Takes the records of a file, and writes them into another one."""

    def __init__(self, mcap: Writer, source: Inspection) -> None:
        self.information = FileInformation(source.path.name)
        self.lost = 0
        self._mcap = mcap
        self._source = source
        self._schemas: dict[int, int] = {}  # number there -> number here
        self._channels: dict[int, tuple[int, str] | None] = {}  # number there -> here, topic

    def add(self, record: McapRecord) -> None:
        """Copy a record of the data section, of a chunk what is in it, if that is whole."""
        if isinstance(record, Chunk):
            with suppress(DamageError):
                for found in records_in(record):
                    self.add(found.record)
        elif isinstance(record, Message):
            self._add_message(record)
        elif isinstance(record, Metadata) and record.name != RECORD_NAME:
            self._mcap.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self._mcap.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )

    def add_topics(self) -> None:
        """Add those without messages as well."""
        for number in self._source.channels:
            self._channel(number)

    def _add_message(self, message: Message) -> None:
        channel = self._channel(message.channel_id)
        if channel is None:
            self.lost += 1
            return
        number, topic = channel
        self._mcap.add_message(
            number, message.log_time, message.data, message.publish_time, message.sequence
        )
        self.information.count(topic, message.log_time)

    def _channel(self, number: int) -> tuple[int, str] | None:
        """Return the number and the topic of a channel here; None if it is unknown."""
        if number not in self._channels:
            self._channels[number] = self._new_channel(self._source.channels.get(number))
        return self._channels[number]

    def _new_channel(self, channel: Channel | None) -> tuple[int, str] | None:
        schema = self._source.schemas.get(channel.schema_id) if channel else None
        if channel is None or schema is None:
            return None
        try:
            topic = topic_information(channel, schema)
        except ValueError:  # its QoS profiles cannot be read
            metadata = {**channel.metadata, 'offered_qos_profiles': ''}
            channel = replace(channel, metadata=metadata)
            topic = topic_information(channel, schema)
        if schema.id not in self._schemas:
            self._schemas[schema.id] = self._mcap.register_schema(
                schema.name, schema.encoding, schema.data
            )
        self.information.topics.setdefault(topic.name, topic)
        number = self._mcap.register_channel(
            *(channel.topic, channel.message_encoding),
            *(self._schemas[schema.id], channel.metadata),
        )
        return number, topic.name
