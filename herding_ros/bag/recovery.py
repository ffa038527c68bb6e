"""Making a bag whole again that was cut off or damaged: what is whole in it is copied."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
import fcntl
from functools import partial
import os
from pathlib import Path, PurePath
import re
from typing import Any

from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    McapRecord,
    Message,
    Metadata,
    Schema,
)
from mcap.writer import CompressionType, Writer

from .inspection import inspect, Inspection, topic_information
from .metadata import (
    bag_map,
    FILE_NAME,
    FileInformation,
    from_yaml,
    read_metadata,
    RECORD_KEY,
    RECORD_NAME,
    ROS_DISTRO,
    to_yaml,
    write_metadata,
)
from .scan import records_of, whole_records

Progress = Callable[[str, int, int], None]
"""Is told what is being done to how many bytes, and how many are done."""

BROKEN = '.broken'
"""What the name of a file ends with that was replaced by a whole one."""

_PARTIAL = '.partial'
_CHUNK_SIZE = 1024 * 1024
_COMPRESSIONS = {'lz4': CompressionType.LZ4, 'zstd': CompressionType.ZSTD}


@dataclass(frozen=True)
class Result:
    """What became of one data file.

    faults: what was wrong with it, nothing if it was whole and left alone; lost_bytes: of the
    broken one that were of no use; lost_messages: those whose topic is nowhere in the file; kept:
    where the broken one is now.
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


def recover(folder: Path, progress: Progress = lambda what, size, done: None) -> Recovery:
    """Make the bag in a folder whole, in bounded memory. Nothing in it is ever overwritten.

    A data file that is not whole is copied as far as it is, and then keeps its content under a
    name that ends with `.broken`. Links are not followed, and nothing outside of the folder is
    read or written.

    Raises ValueError when the folder holds no bag in mcap, or one that is being recorded, and
    OSError when it cannot be read or written.
    """
    inspections = [
        inspect(path, partial(progress, f'reading {path.name}', path.stat().st_size))
        for path in _data_files(folder)
    ]
    try:
        old = read_metadata(folder)
    except (FileNotFoundError, ValueError):
        old = {}
    broken = [one.path for one in inspections if one.faults]
    _check_names_are_free([*broken, folder / FILE_NAME] if broken else [])
    keeping = _Keeping.of(inspections, old)
    results: list[Result] = []
    for one in inspections:
        earlier = [result.information for result in results]
        results.append(
            _rewrite(one, earlier, keeping, progress) if one.faults else Result(one.information())
        )
    content = keeping.bag_map([result.information for result in results])
    is_new = not _is_same(old, content)
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
        raise ValueError(f'{folder} is no bag in mcap: it has no .mcap file')
    for path in paths:
        if path.is_symlink() or not path.is_file():
            raise ValueError(f'{path} is no file but leads elsewhere; recover the bag there')
        with path.open('rb') as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ValueError(f'{path} is being recorded; end the recorder first') from None
            except OSError:  # a disk that knows no locks
                pass
    return paths


def _number(path: Path) -> tuple[int, str]:
    match = re.search(r'_([0-9]+)\.mcap$', path.name)
    return (int(match[1]) if match else -1), path.name


def _check_names_are_free(paths: Sequence[Path]) -> None:
    for path in paths:
        kept = path.with_name(path.name + BROKEN)
        if kept.exists():
            raise FileExistsError(f'{kept} exists already and is not overwritten; move it away')


@dataclass(frozen=True)
class _Keeping:
    """What of a bag's metadata its data files do not tell by themselves."""

    custom_data: dict[str, str]
    ros_distro: str
    compression: tuple[str, str]

    @classmethod
    def of(cls, files: Sequence[Inspection], old: dict[str, Any]) -> _Keeping:
        """Return what the last map says that is kept in a file, or else metadata.yaml."""
        for text in [file.metadata for file in reversed(files) if file.metadata]:
            with suppress(TypeError, ValueError):
                return cls._in(dict(from_yaml(text)))
        with suppress(TypeError, ValueError):
            return cls._in(old)
        return cls._in({})

    @classmethod
    def _in(cls, content: dict[str, Any]) -> _Keeping:
        custom_data = dict(content.get('custom_data') or {})
        return cls(
            {str(key): str(value) for key, value in custom_data.items()},
            str(content.get('ros_distro') or ROS_DISTRO),
            (
                str(content.get('compression_format') or ''),
                str(content.get('compression_mode') or ''),
            ),
        )

    def bag_map(self, files: Sequence[FileInformation]) -> dict[str, Any]:
        return bag_map(files, self.custom_data, self.ros_distro, self.compression)


def _is_same(old: dict[str, Any], new: dict[str, Any]) -> bool:
    """Whether two maps list the same files with as many messages."""
    names = [PurePath(path).name for path in old.get('relative_file_paths', [])]
    return names == new['relative_file_paths'] and old.get('message_count') == new['message_count']


def _rewrite(
    broken: Inspection, earlier: Sequence[FileInformation], keeping: _Keeping, progress: Progress
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
        size = path.stat().st_size
        with path.open('rb') as source:
            for _, end, record in whole_records(source, []):
                if isinstance(record, DataEnd):
                    break
                for each in records_of(record, []) if isinstance(record, Chunk) else (record,):
                    copy.add(each)
                progress(f'copying {path.name}', size, end)
        copy.add_topics()
        content = keeping.bag_map([*earlier, copy.information])
        mcap.add_metadata(RECORD_NAME, {RECORD_KEY: to_yaml(content)})
        mcap.finish()
        target.flush()
        os.fsync(target.fileno())
    kept = _keep(path)
    unfinished.rename(path)
    return Result(
        copy.information,
        broken.faults,
        broken.lost_bytes,
        copy.lost,
        kept,
    )


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
        self._schemas = dict(source.schemas)
        self._channels = dict(source.channels)
        self._new_schemas: dict[int, int] = {}  # number there -> number here
        self._new_channels: dict[int, tuple[int, str]] = {}  # number there -> here, topic

    def add(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            self._schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            self._channels.setdefault(record.id, record)
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
        for number in self._channels:
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
        if number in self._new_channels:
            return self._new_channels[number]
        channel = self._channels.get(number)
        schema = self._schemas.get(channel.schema_id) if channel else None
        if channel is None or schema is None:
            return None
        if schema.id not in self._new_schemas:
            self._new_schemas[schema.id] = self._mcap.register_schema(
                schema.name, schema.encoding, schema.data
            )
        new = self._mcap.register_channel(
            channel.topic,
            channel.message_encoding,
            self._new_schemas[schema.id],
            channel.metadata,
        )
        topic = topic_information(channel, schema)
        self.information.topics.setdefault(topic.name, topic)
        self._new_channels[number] = new, topic.name
        return self._new_channels[number]
