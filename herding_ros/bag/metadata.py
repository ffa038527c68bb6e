# SPDX-License-Identifier: Apache-2.0
"""The metadata of a rosbag2 bag, version 9: one YAML map, kept in two places.

rosbag2 writes the same map to `metadata.yaml` beside the data and into the data files themselves,
from which `ros2 bag reindex` restores the former. The layout is that of rosbag2_storage's
yaml.hpp and qos.cpp in ROS 2 Jazzy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any

from mcap.records import Channel, Schema

from .plain_yaml import from_yaml, to_yaml

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

ROS_DISTRO = 'jazzy'
"""Release of ROS 2 whose format and messages are written."""

_POLICIES = {
    'history': ('system_default', 'keep_last', 'keep_all', 'unknown'),
    'reliability': ('system_default', 'reliable', 'best_effort', 'unknown', 'best_available'),
    'durability': ('system_default', 'transient_local', 'volatile', 'unknown', 'best_available'),
    'liveliness': (
        *('system_default', 'automatic', 'manual_by_node', 'manual_by_topic'),
        *('unknown', 'best_available'),
    ),
}
"""Names of the policies by their numbers, which the releases before Jazzy wrote."""


@dataclass
class TopicInformation:
    """One recorded topic.

    `qos_profiles` holds one map for each publisher that offered the topic, with the keys
    history, depth, reliability, durability, deadline, lifespan, liveliness,
    liveliness_lease_duration (the policies by their names in small letters, the durations as
    {sec, nsec}) and avoid_ros_namespace_conventions.
    """

    name: str
    type: str
    qos_profiles: Sequence[Mapping[str, Any]]
    type_hash: str
    message_count: int = 0


@dataclass
class FileInformation:
    """One data file: its name within the bag's folder and its messages' log times [ns]."""

    path: str
    message_count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    topics: dict[str, TopicInformation] = field(default_factory=dict)

    def count(self, topic: str, log_time_ns: int) -> None:
        """Take note of one message."""
        first = self.message_count == 0
        self.first_ns = log_time_ns if first else min(self.first_ns, log_time_ns)
        self.last_ns = log_time_ns if first else max(self.last_ns, log_time_ns)
        self.message_count += 1
        self.topics[topic].message_count += 1


def topic_information(channel: Channel, schema: Schema) -> TopicInformation:
    """Return a topic by its records in a data file; its messages are not counted."""
    profiles = offered_profiles(channel, strict=False)
    type_hash = channel.metadata.get('topic_type_hash', '')
    return TopicInformation(channel.topic, schema.name, profiles, type_hash)


def offered_profiles(channel: Channel, strict: bool = True) -> list[dict[str, Any]]:
    """Return the QoS profiles of a topic, with policies by name.

    When they cannot be read: raises ValueError, or returns none if not `strict`.
    """
    try:
        profiles = from_yaml(channel.metadata.get(PROFILES_KEY, '')) or []
        if not (isinstance(profiles, list) and all(isinstance(each, dict) for each in profiles)):
            raise ValueError('QoS profiles must be a list of maps')
    except ValueError:
        if strict:
            raise
        return []
    return [_named(profile) for profile in profiles]


def _named(profile: dict[str, Any]) -> dict[str, Any]:
    """Return a QoS profile with its policies by name."""
    for policy, names in _POLICIES.items():
        number = profile.get(policy)
        if isinstance(number, int):
            profile[policy] = names[number] if 0 <= number < len(names) else 'unknown'
    return profile


def all_topics(files: Sequence[FileInformation]) -> dict[str, TopicInformation]:
    """Return the topics of several files, each with the number of its messages in all."""
    topics: dict[str, TopicInformation] = {}
    for file in files:
        for name, topic in file.topics.items():
            count = topic.message_count + (topics[name].message_count if name in topics else 0)
            topics[name] = replace(topics.get(name, topic), message_count=count)
    return topics


def bag_map(
    files: Sequence[FileInformation],
    custom_data: Mapping[str, str],
    ros_distro: str = ROS_DISTRO,
    compression: tuple[str, str] = ('', ''),
) -> dict[str, Any]:
    """Return the map that describes a bag of these files.

    `compression` is the format and the mode of what rosbag2 compresses by itself, whole files or
    messages; that of the chunks within a file is not in the map.
    """
    full = [file for file in files if file.message_count]
    first_ns = min((file.first_ns for file in full), default=0)
    last_ns = max((file.last_ns for file in full), default=0)
    return {
        'version': VERSION,
        'storage_identifier': 'mcap',
        **_times(first_ns, last_ns),
        'message_count': sum(file.message_count for file in files),
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic.name,
                    'type': topic.type,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': [dict(profile) for profile in topic.qos_profiles],
                    'type_description_hash': topic.type_hash,
                },
                'message_count': topic.message_count,
            }
            for topic in all_topics(files).values()
        ],
        'compression_format': compression[0],
        'compression_mode': compression[1],
        'relative_file_paths': [file.path for file in files],
        'files': [
            {
                'path': file.path,
                **_times(file.first_ns, file.last_ns),
                'message_count': file.message_count,
            }
            for file in files
        ],
        'custom_data': dict(custom_data) or None,
        'ros_distro': ros_distro,
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
    """Return the map of a bag.

    Raises FileNotFoundError when there is none or the bag has a data file that is not in it,
    ValueError when it does not describe a bag.
    """
    file = folder / FILE_NAME
    if file.is_symlink() or not file.is_file():
        if any(folder.glob('*.mcap')):
            raise FileNotFoundError(
                f'{folder} has not been closed: there is no {FILE_NAME}; {advice(folder)}'
            )
        raise FileNotFoundError(f'{folder} is not a bag: there is no {FILE_NAME}')
    try:
        content = dict(from_yaml(file.read_text(encoding='utf-8'))[ROOT_KEY])
        listed = file_names(content)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f'{file} does not describe a bag: {error}') from error
    unlisted = sorted(path.name for path in folder.glob('*.mcap') if path.name not in listed)
    if unlisted:
        raise FileNotFoundError(
            f'{folder} has not been closed: {FILE_NAME} does not list {", ".join(unlisted)}; '
            f'{advice(folder)}'
        )
    return content


def file_names(content: Mapping[str, Any]) -> list[str]:
    """Return the names of the data files in a bag's map.

    The folders in their paths do not count: a bag is read from its own folder and nowhere else.
    Raises KeyError or TypeError when they are not there.
    """
    return [PurePath(path).name for path in content['relative_file_paths']]


def string_map(content: object) -> dict[str, str]:
    """Return custom data as strings, nothing if it is not a map."""
    items = content.items() if isinstance(content, Mapping) else ()
    return {str(key): str(value) for key, value in items}
