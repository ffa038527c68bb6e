# SPDX-License-Identifier: Apache-2.0
"""Making a bag whole that was cut off or damaged: what is whole in it is copied."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
import fcntl
import json
import os
from pathlib import Path
import re
from typing import Any, BinaryIO

from mcap.records import Attachment, Chunk, DataEnd, McapRecord, Message, Metadata
from mcap.writer import CompressionType, Writer

from .inspection import inspect, Inspection, Open, open_file
from .metadata import (
    bag_map,
    FILE_NAME,
    offered_profiles,
    PROFILES_KEY,
    read_metadata,
    RECORD_KEY,
    RECORD_NAME,
    ROS_DISTRO,
    string_map,
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
class Recovery:
    """What became of a bag.

    files: what was found in the data files, in their order; those with faults were replaced;
    new_metadata: whether metadata.yaml is new.
    """

    files: Sequence[Inspection]
    new_metadata: bool

    @property
    def was_whole(self) -> bool:
        """Whether there was nothing to do."""
        return not self.new_metadata and not any(file.faults for file in self.files)


def recover(folder: Path, opening: Open = open_file) -> Recovery:
    """Make the bag in a folder whole, in bounded memory. Nothing in it is ever overwritten.

    A data file that is not whole is copied up to where its records end, without the chunks that
    are damaged, and then keeps its content under a name that ends with `.broken`. Links are not
    followed, and nothing outside of the folder is read or written.

    Raises ValueError when the folder does not hold a bag in mcap, or one that is being recorded,
    and OSError when it cannot be read or written.
    """
    files = [inspect(path, opening) for path in _data_files(folder)]
    try:
        old = read_metadata(folder)
    except (FileNotFoundError, ValueError):
        old = {}
    broken = [file for file in files if file.faults]
    _check_names_are_free([*(file.path for file in broken), folder / FILE_NAME] if broken else [])
    content = _bag_map(files, old)
    for file in broken:
        _rewrite(file, to_yaml(content), opening)
    is_new = not _describes_the_same(old, content)
    if is_new:
        if (folder / FILE_NAME).exists():
            _check_names_are_free([folder / FILE_NAME])
            _keep(folder / FILE_NAME)
        write_metadata(folder, content)
    return Recovery(files, is_new)


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


def _bag_map(files: Sequence[Inspection], old: dict[str, Any]) -> dict[str, Any]:
    """Return the map of a bag of these files.

    What does not follow from their records is taken from the last map that is kept in a file, or
    else from the old metadata.yaml.
    """
    said = old
    for file in files:
        with suppress(TypeError, ValueError):
            said = dict(from_yaml(file.metadata)) if file.metadata else said
    hashes: dict[str, str] = {}
    with suppress(AttributeError, KeyError, TypeError):
        for each in said['topics_with_message_count']:
            topic = each['topic_metadata']
            hashes[topic['name']] = str(topic.get('type_description_hash', ''))
    listed = [file.information for file in files]
    for topic in [topic for file in listed for topic in file.topics.values()]:
        topic.type_hash = topic.type_hash or hashes.get(topic.name, '')
    keys = ('compression_format', 'compression_mode')
    return bag_map(
        listed,
        string_map(said.get('custom_data')),
        str(said.get('ros_distro') or ROS_DISTRO),
        (str(said.get(keys[0]) or ''), str(said.get(keys[1]) or '')),
    )


def _describes_the_same(old: dict[str, Any], new: dict[str, Any]) -> bool:
    """Whether a map says what the new one says.

    Those of versions before this one have other words for the same; of them it is enough that
    they list the same files with as many messages.
    """
    if old.get('version') == VERSION:
        return _in_order(old) == _in_order(new)
    keys = ('storage_identifier', 'relative_file_paths', 'message_count', 'starting_time')
    return old.get('version') in range(1, VERSION) and all(old.get(k) == new[k] for k in keys)


def _in_order(content: dict[str, Any]) -> dict[str, Any]:
    """Return a map with its topics in the order of their names, each as JSON."""
    topics = content.get('topics_with_message_count') or []
    in_order = sorted(json.dumps(topic, sort_keys=True) for topic in topics)
    return {**content, 'topics_with_message_count': in_order}


def _rewrite(file: Inspection, metadata: str, opening: Open) -> None:
    """Replace a file by a copy of what is whole in it."""
    unfinished = file.path.with_name(file.path.name + _PARTIAL)
    with _new_file(unfinished) as target:
        mcap = Writer(
            target,
            chunk_size=_CHUNK_SIZE,
            compression=_COMPRESSIONS.get(file.compression, CompressionType.NONE),
        )
        mcap.start(profile=file.profile, library='herding_ros recover')
        with opening(file.path) as source:
            _copy(file, source, mcap)
        mcap.add_metadata(RECORD_NAME, {RECORD_KEY: metadata})
        mcap.finish()
        target.flush()
        os.fsync(target.fileno())
    _keep(file.path)
    unfinished.rename(file.path)


def _copy(file: Inspection, source: BinaryIO, mcap: Writer) -> None:
    """Copy what is whole in a data section."""
    schemas = {
        number: mcap.register_schema(schema.name, schema.encoding, schema.data)
        for number, schema in file.schemas.items()
    }
    channels = {
        number: mcap.register_channel(
            channel.topic,
            channel.message_encoding,
            schemas[channel.schema_id],
            {**channel.metadata, PROFILES_KEY: to_yaml(offered_profiles(channel, strict=False))},
        )
        for number, channel in file.known_channels.items()
    }
    for record in _whole_records(source):
        if isinstance(record, Message) and record.channel_id in channels:
            mcap.add_message(
                *(channels[record.channel_id], record.log_time, record.data),
                *(record.publish_time, record.sequence),
            )
        elif isinstance(record, Metadata) and record.name != RECORD_NAME:
            mcap.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            mcap.add_attachment(
                *(record.create_time, record.log_time, record.name),
                *(record.media_type, record.data),
            )


def _whole_records(source: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of a data section up to the damage, those of whole chunks one by one."""
    with suppress(DamageError):
        for _, _, record in records(source):
            if isinstance(record, DataEnd):
                return
            if isinstance(record, Chunk):
                with suppress(DamageError):
                    yield from [found.record for found in records_in(record)]
            else:
                yield record


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


def _keep(path: Path) -> None:
    path.rename(path.with_name(path.name + BROKEN))
