# SPDX-License-Identifier: Apache-2.0
"""Making a bag whole that was cut off or damaged: what is whole in it is copied."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import fcntl
import json
import os
from pathlib import Path
import re
from typing import Any, NamedTuple

from mcap.records import Message
from mcap.writer import CompressionType, Writer

from .inspection import inspect, Inspection, Open, open_file, records
from .metadata import (
    bag_map,
    FILE_NAME,
    PROFILES_KEY,
    read_map,
    read_metadata,
    RECORD_KEY,
    RECORD_NAME,
    to_yaml,
    write_metadata,
)

BROKEN = '.broken'
"""What the name of a file ends with that was replaced by a whole one."""


class Recovery(NamedTuple):
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
    is_new = not _says_the_same(old, content)
    if is_new:
        if os.path.lexists(folder / FILE_NAME):
            _check_names_are_free([folder / FILE_NAME])
            _keep(folder / FILE_NAME)
        write_metadata(folder, content)
    return Recovery(files, is_new)


def _data_files(folder: Path) -> list[Path]:
    """Return the data files of a bag in the order of their numbers; raises ValueError."""
    if not folder.is_dir():
        what = 'is a file; give the folder it is in' if folder.exists() else 'does not exist'
        raise ValueError(f'{folder} {what}')
    for broken in (*folder.glob('*.mcap' + BROKEN), *folder.glob(FILE_NAME + BROKEN)):
        original = broken.with_name(broken.name.removesuffix(BROKEN))
        if not os.path.lexists(original):  # an earlier recovery was ended half-way
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
        if os.path.lexists(kept):
            raise FileExistsError(f'{kept} exists already and is not overwritten; move it away')


def _bag_map(files: Sequence[Inspection], old: dict[str, Any]) -> dict[str, Any]:
    """Return the map of a bag of these files.

    What does not follow from their records is taken from the last map that is kept in a file, or
    else from the old metadata.yaml.
    """
    said = old
    for file in files:
        with suppress(ValueError):
            said = read_map(file.metadata) if file.metadata else said
    hashes = {
        each['topic_metadata']['name']: each['topic_metadata'].get('type_description_hash', '')
        for each in said.get('topics_with_message_count', ())
    }
    for topic in [topic for file in files for topic in file.information.topics.values()]:
        topic['type_description_hash'] = (
            topic['type_description_hash'] or hashes.get(topic['name'], '')
        )  # fmt: skip
    return bag_map([file.information for file in files], said)


def _says_the_same(old: dict[str, Any], new: dict[str, Any]) -> bool:
    """Whether a map of any version says what the new one says; the older ones say less."""
    return bool(old) and _in_order({**new, **old, 'version': new['version']}) == _in_order(new)


def _in_order(content: dict[str, Any]) -> dict[str, Any]:
    """Return a map with its topics in the order of their names, each as JSON."""
    topics = [
        {**each, 'topic_metadata': {'type_description_hash': '', **each['topic_metadata']}}
        for each in content['topics_with_message_count']
    ]
    in_order = sorted(json.dumps(topic, sort_keys=True) for topic in topics)
    return {**content, 'topics_with_message_count': in_order}


def _rewrite(file: Inspection, metadata: str, opening: Open) -> None:
    """Replace a file by a copy of what is whole in it."""
    unfinished = file.path.with_name(file.path.name + '.partial')
    unfinished.unlink(missing_ok=True)  # a link there would lead out of the folder
    try:
        with unfinished.open('xb') as target:
            known = CompressionType.__members__
            compression = known.get(file.compression.upper(), CompressionType.NONE)
            mcap = Writer(target, compression=compression, enable_data_crcs=True)
            mcap.start(profile=file.profile, library='herding_ros recover')
            _copy(file, mcap, opening)
            mcap.add_metadata(RECORD_NAME, {RECORD_KEY: metadata})
            mcap.finish()
            target.flush()
            os.fsync(target.fileno())
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
    _keep(file.path)
    unfinished.rename(file.path)


def _copy(file: Inspection, mcap: Writer, opening: Open) -> None:
    """Copy all topics, and then the messages that are whole."""
    schemas = {
        number: mcap.register_schema(schema.name, schema.encoding, schema.data)
        for number, schema in file.schemas.items()
    }
    channels = {
        number: mcap.register_channel(
            channel.topic,
            channel.message_encoding,
            schemas[channel.schema_id],
            {**channel.metadata, PROFILES_KEY: to_yaml(file.profiles[number])},
        )
        for number, channel in file.channels.items()
    }
    with opening(file.path) as source:
        for record in records(source, []):
            content = record.content
            if isinstance(content, Message) and content.channel_id in channels:
                mcap.add_message(
                    *(channels[content.channel_id], content.log_time, content.data),
                    *(content.publish_time, content.sequence),
                )


def _keep(path: Path) -> None:
    path.rename(path.with_name(path.name + BROKEN))
