# SPDX-License-Identifier: Apache-2.0
"""The messages in a bag's files as bytes, in the order in which they were written."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
import sqlite3
import struct
from typing import Any, NamedTuple

from mcap.exceptions import McapError
from mcap.reader import make_reader

from .recorded_run import Topic

STORAGES = ('mcap', 'sqlite3')
"""Kinds of files, by rosbag2's names."""


SEVERAL_TYPES = 'several types'
"""Stands for the type of a topic that has more than one."""


class Stored(NamedTuple):
    """A message: its topic and type, when it was logged and published [ns], and its bytes."""

    topic: str
    type: str
    log_ns: int
    publish_ns: int
    data: bytes


def stored_topics(files: Sequence[Path], storage: str) -> tuple[Topic, ...]:
    """Return the topics by name. Raises ValueError when a file is damaged."""
    rows = [row for file in files for row in _TOPICS[storage](file)]
    full = [row for row in rows if row.messages]
    begin = min((row.first_ns for row in full), default=0)
    end = max((row.last_ns for row in full), default=0)
    seconds = (end - begin) * 1e-9
    topics = []
    for name in sorted({row.name for row in rows}):
        types = {row.type for row in rows if row.name == name}
        count = sum(row.messages for row in rows if row.name == name)
        kind = types.pop() if len(types) == 1 else SEVERAL_TYPES
        topics.append(Topic(name, kind, count, count / seconds if seconds > 0.0 else 0.0))
    return tuple(topics)


def stored_messages(
    files: Sequence[Path], storage: str, topics: Collection[str]
) -> Iterator[Stored]:
    """Yield the messages of some topics. Raises ValueError when a file is damaged."""
    for file in files:
        yield from _MESSAGES[storage](file, topics)


class _Row(NamedTuple):
    """A topic in one file, and the first and last log time of that file."""

    name: str
    type: str
    messages: int
    first_ns: int
    last_ns: int


def _mcap_topics(file: Path) -> Iterator[_Row]:
    with _damage_of(file), file.open('rb') as stream:
        summary = make_reader(stream).get_summary()
        if summary is None or summary.statistics is None:
            raise ValueError(f'{file.name} has no summary')
        found = summary.statistics
        for number, channel in summary.channels.items():
            schema = summary.schemas.get(channel.schema_id)
            count = found.channel_message_counts.get(number, 0)
            times = found.message_start_time, found.message_end_time
            yield _Row(channel.topic, schema.name if schema else '', count, *times)


def _mcap_messages(file: Path, topics: Collection[str]) -> Iterator[Stored]:
    with _damage_of(file), file.open('rb') as stream:
        found = make_reader(stream).iter_messages(topics, log_time_order=False)
        for schema, channel, message in found:
            times = message.log_time, message.publish_time
            yield Stored(channel.topic, schema.name if schema else '', *times, message.data)


def _sqlite3_topics(file: Path) -> Iterator[_Row]:
    query = (
        'SELECT name, type, COUNT(timestamp), (SELECT MIN(timestamp) FROM messages), '
        '(SELECT MAX(timestamp) FROM messages) '
        'FROM topics LEFT JOIN messages ON topic_id = topics.id GROUP BY topics.id'
    )
    for name, kind, count, first_ns, last_ns in _rows(file, query):
        yield _Row(str(name), str(kind), count, int(first_ns or 0), int(last_ns or 0))


def _sqlite3_messages(file: Path, topics: Collection[str]) -> Iterator[Stored]:
    query = (
        'SELECT name, type, timestamp, data '
        'FROM messages JOIN topics ON topic_id = topics.id ORDER BY messages.id'
    )
    for name, kind, log_ns, data in _rows(file, query):
        if name in topics:
            yield Stored(name, str(kind), int(log_ns), int(log_ns), bytes(data))


def _rows(file: Path, query: str) -> Iterator[Sequence[Any]]:
    address = f'{file.absolute().as_uri()}?mode=ro'
    with _damage_of(file), closing(sqlite3.connect(address, uri=True)) as database:
        yield from database.execute(query)


@contextmanager
def _damage_of(file: Path) -> Iterator[None]:
    """Turn what the libraries raise on a damaged file into ValueError."""
    try:
        yield
    except (McapError, sqlite3.Error, struct.error, EOFError, RuntimeError, TypeError) as error:
        raise ValueError(f'{file.name} cannot be read: {error}') from error


_TOPICS = {'mcap': _mcap_topics, 'sqlite3': _sqlite3_topics}
_MESSAGES = {'mcap': _mcap_messages, 'sqlite3': _sqlite3_messages}
