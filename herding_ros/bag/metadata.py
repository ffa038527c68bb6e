# SPDX-License-Identifier: Apache-2.0
"""The metadata of a rosbag2 bag, version 9: one YAML map, kept in two places.

rosbag2 writes the same map to `metadata.yaml` beside the data and into the data files themselves,
from which `ros2 bag reindex` restores the former. The layout is that of rosbag2_storage's
yaml.hpp and qos.cpp in ROS 2 Jazzy.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath
import textwrap
from typing import Any

import yaml

VERSION = 9
"""From this version on, policies are written by name and offered profiles as a sequence."""

FILE_NAME = 'metadata.yaml'
"""Name of the file in the bag's folder."""

ROOT_KEY = 'rosbag2_bagfile_information'
"""The only key of metadata.yaml; the map under it is what a data file keeps."""

RECORD_NAME = 'rosbag2'
"""Name of the metadata records in a data file."""

RECORD_KEY = 'serialized_metadata'
"""Key of such a record under which the map is, as YAML."""

PROFILES_KEY = 'offered_qos_profiles'
"""Key of a channel's QoS profiles, as YAML."""

HASH_KEY = 'topic_type_hash'
"""Key of the hash of a channel's type."""

ROS_DISTRO = 'jazzy'
"""Release of ROS 2 whose format and messages are written."""

MOST_CHARACTERS = 4_000_000
"""No longer YAML is read."""

_MOST_EVENTS = 100_000
_DEEPEST = 32


@dataclass
class FileInformation:
    """One data file.

    path: its name within the bag's folder; topics: what the bag's map says of each, by name;
    counts: their messages; message_count: of all topics; first_ns, last_ns: the first and last of
    the log times [ns].
    """

    path: str
    topics: dict[str, dict[str, Any]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    message_count: int = 0
    first_ns: int = 0
    last_ns: int = 0

    def add_topic(
        self, name: str, type_name: str, profiles: Sequence[Mapping[str, Any]], type_hash: str
    ) -> None:
        """Add a topic, unless it is there already."""
        topic = {
            'name': name,
            'type': type_name,
            'serialization_format': 'cdr',
            'offered_qos_profiles': [dict(profile) for profile in profiles],
            'type_description_hash': type_hash,
        }
        self.topics.setdefault(name, topic)
        self.counts[name] += 0

    def count(self, topic: str, log_time_ns: int) -> None:
        """Take note of one message."""
        first = self.message_count == 0
        self.first_ns = log_time_ns if first else min(self.first_ns, log_time_ns)
        self.last_ns = log_time_ns if first else max(self.last_ns, log_time_ns)
        self.message_count += 1
        self.counts[topic] += 1


def total_counts(files: Sequence[FileInformation]) -> Counter[str]:
    """Return the number of messages of each topic, also of those without any."""
    counts: Counter[str] = Counter()
    for file in files:
        counts.update(file.counts)
    return counts


def bag_map(files: Sequence[FileInformation], said: Mapping[str, Any]) -> dict[str, Any]:
    """Return the map that describes a bag of these files.

    What does not follow from them is as in the map `said`: custom data, release of ROS 2, and what
    rosbag2 itself compressed.
    """
    topics: dict[str, dict[str, Any]] = {}
    for file in files:
        topics = {**file.topics, **topics}
    counts = total_counts(files)
    full = [file for file in files if file.message_count]
    first_ns = min((file.first_ns for file in full), default=0)
    last_ns = max((file.last_ns for file in full), default=0)
    return {
        'version': VERSION,
        'storage_identifier': 'mcap',
        **_times(first_ns, last_ns),
        'message_count': counts.total(),
        'topics_with_message_count': [
            {'topic_metadata': topics[name], 'message_count': count}
            for name, count in counts.items()
        ],
        'compression_format': said.get('compression_format', ''),
        'compression_mode': said.get('compression_mode', ''),
        'relative_file_paths': [file.path for file in files],
        'files': [
            {
                'path': file.path,
                **_times(file.first_ns, file.last_ns),
                'message_count': file.message_count,
            }
            for file in files
        ],
        'custom_data': said.get('custom_data') or None,
        'ros_distro': said.get('ros_distro') or ROS_DISTRO,
    }


def _times(first_ns: int, last_ns: int) -> dict[str, dict[str, int]]:
    return {
        'duration': {'nanoseconds': last_ns - first_ns},
        'starting_time': {'nanoseconds_since_epoch': first_ns},
    }


def write_metadata(folder: Path, content: Mapping[str, Any]) -> None:
    """Write a bag's map to its metadata.yaml, which appears only when complete.

    Raises OSError.
    """
    partial = folder / (FILE_NAME + '.partial')
    partial.unlink(missing_ok=True)  # a link there would lead out of the folder
    with partial.open('x', encoding='utf-8') as stream:
        stream.write(to_yaml({ROOT_KEY: dict(content)}))
    partial.replace(folder / FILE_NAME)


def advice(folder: Path) -> str:
    """Return what to do about a bag that is not whole."""
    return f'recover it by `ros2 run herding_ros recover {folder}`'


def read_metadata(folder: Path) -> dict[str, Any]:
    """Return the map of a bag, as `read_map` does.

    Raises FileNotFoundError when there is none or the bag has a data file that is not in it,
    ValueError when it does not describe a bag.
    """
    file = folder / FILE_NAME
    if file.is_symlink() or not file.is_file():
        if any(folder.glob('*.mcap')):
            raise FileNotFoundError(
                f'{folder} has not been closed: there is no {FILE_NAME}; {advice(folder)}'
            )
        raise FileNotFoundError(
            f'{folder} is not a bag: there is no {FILE_NAME}{_what_is_meant(folder)}'
        )
    try:
        with file.open(encoding='utf-8') as stream:
            content = _read(from_yaml(stream.read(MOST_CHARACTERS + 1)), {ROOT_KEY: _BAG}, '')
    except ValueError as error:
        raise ValueError(f'{file} does not describe a bag: {error}') from error
    content = content[ROOT_KEY]
    listed = file_names(content)
    unlisted = sorted(path.name for path in folder.glob('*.mcap') if path.name not in listed)
    if unlisted:
        raise FileNotFoundError(
            f'{folder} has not been closed: {FILE_NAME} does not list {", ".join(unlisted)}; '
            f'{advice(folder)}'
        )
    return content


def _what_is_meant(folder: Path) -> str:
    """Return what to give in place of a file of a bag, or of the folder of a run."""
    if folder.is_file():
        return '; give the folder it is in'
    bag = folder / 'bag'
    return f'; give {bag}' if bag.is_dir() else ''


def file_names(content: Mapping[str, Any]) -> list[str]:
    """Return the names of the data files in a bag's map.

    The folders in their paths do not count: a bag is read from its own folder and nowhere else.
    """
    return [PurePath(path).name for path in content['relative_file_paths']]


def string_map(content: object) -> dict[str, str]:
    """Return custom data as strings, nothing if it is not a map."""
    items = content.items() if isinstance(content, Mapping) else ()
    return {str(key): str(value) for key, value in items}


# Reading YAML, whatever a stranger wrote.


class _Dumper(yaml.CSafeDumper):
    """Writes an object that occurs twice twice: rosbag2's readers expect no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def to_yaml(data: Any) -> str:
    """Return data as YAML in block style, keys in their order, no line ever folded."""
    width = 2**31 - 1
    return yaml.dump(data, None, _Dumper, default_flow_style=False, sort_keys=False, width=width)


def from_yaml(string: str) -> Any:
    """Return what is in a string: lists, maps and, for all else, strings; None if it is empty.

    Time and memory are linear in its length. Raises ValueError when it is not YAML, is too long
    or too deep, or has aliases.
    """
    if len(string) > MOST_CHARACTERS:
        raise ValueError(f'must have at most {MOST_CHARACTERS} characters')
    depth = 0
    try:
        for count, event in enumerate(yaml.parse(string, yaml.CBaseLoader)):
            if isinstance(event, yaml.AliasEvent):
                raise ValueError(f'must have no aliases, got one{event.start_mark}')
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST or count > min(_MOST_EVENTS, 10 + len(string) // 6):
                raise ValueError(f'must have fewer values, nested at most {_DEEPEST} deep')
        return yaml.CBaseLoader(string).get_single_data()
    except yaml.YAMLError as error:
        raise ValueError(' '.join(str(error).split())) from error


def read_map(string: str) -> dict[str, Any]:
    """Return the map of a bag from YAML, whatever its version, with the types of version 9.

    Raises ValueError when it does not describe a bag.
    """
    content: dict[str, Any] = _read(from_yaml(string), _BAG, '')
    return content


def read_profiles(content: str | list[Any]) -> list[dict[str, Any]]:
    """Return the QoS profiles of a topic from YAML, in the words of version 9.

    The releases before Jazzy wrote numbers for the policies. Raises ValueError when there is
    anything else.
    """
    listed = from_yaml(content) or [] if isinstance(content, str) else content
    profiles: list[dict[str, Any]] = _read(listed, [_PROFILE], PROFILES_KEY)
    return profiles


def _read(content: Any, form: Any, name: str) -> Any:
    """Return what was read from YAML in its form: maps, lists and what to make of other values.

    Keys that end with a question mark may be missing, and others be there. Raises ValueError.
    """
    if isinstance(form, dict):
        if not isinstance(content, dict):
            raise ValueError(f'{name or "it"} must be a map')
        result = dict(content)
        for key in form:
            word = key.removesuffix('?')
            if word in content:
                result[word] = _read(content[word], form[key], word)
            elif key == word:
                raise ValueError(f'{name or "it"} must have {word}')
        return result
    if isinstance(form, list):
        if not isinstance(content, list):
            raise ValueError(f'{name} must be a list')
        return [_read(each, form[0], name) for each in content]
    try:
        return form(content)
    except (TypeError, ValueError) as error:
        given = textwrap.shorten(str(content), 50)
        raise ValueError(f'{name} cannot be {given!r}') from error


def _text(content: Any) -> str:
    if not isinstance(content, str):
        raise TypeError
    return content


def _boolean(content: Any) -> bool:
    return {'true': True, 'false': False}.get(content, False)


def _policy(*names: str) -> Callable[[Any], str]:
    """Return what makes the name of a policy of its number."""

    def read(content: Any) -> str:
        if not _text(content).isdecimal():
            return _text(content)
        number = int(content)
        return names[number] if number < len(names) else 'unknown'

    return read


_NANOSECONDS = {
    'duration': {'nanoseconds': int},
    'starting_time': {'nanoseconds_since_epoch': int},
}

_LIMIT = {'sec': int, 'nsec': int}

_PROFILE = {
    'history': _policy('system_default', 'keep_last', 'keep_all', 'unknown'),
    'depth': int,
    'reliability': _policy(
        'system_default', 'reliable', 'best_effort', 'unknown', 'best_available'
    ),
    'durability': _policy(
        'system_default', 'transient_local', 'volatile', 'unknown', 'best_available'
    ),
    'deadline': _LIMIT,
    'lifespan': _LIMIT,
    'liveliness': _policy(
        *('system_default', 'automatic', 'manual_by_node', 'manual_by_topic'),
        *('unknown', 'best_available'),
    ),
    'liveliness_lease_duration': _LIMIT,
    'avoid_ros_namespace_conventions': _boolean,
}

_TOPIC = {
    'name': _text,
    'type': _text,
    'serialization_format': _text,
    'offered_qos_profiles?': read_profiles,
    'type_description_hash?': _text,
}

_BAG = {
    'version': int,
    'storage_identifier': _text,
    **_NANOSECONDS,
    'message_count': int,
    'topics_with_message_count': [{'topic_metadata': _TOPIC, 'message_count': int}],
    'compression_format?': _text,
    'compression_mode?': _text,
    'relative_file_paths': [_text],
    'files?': [{'path': _text, **_NANOSECONDS, 'message_count': int}],
    'custom_data?': lambda content: string_map(content) or None,
    'ros_distro?': _text,
}
