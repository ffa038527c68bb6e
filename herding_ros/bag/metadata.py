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

ROS_DISTRO = 'jazzy'
"""Release of ROS 2 whose format and messages are written."""


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
    messages; that of the chunks within a file is none of the map's business.
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


class _Dumper(yaml.CSafeDumper):
    """Writes an object that occurs twice twice: rosbag2's readers expect no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def to_yaml(data: Any) -> str:
    """Return data as YAML in block style, keys in their order, no line ever folded."""
    return yaml.dump(
        data, Dumper=_Dumper, default_flow_style=False, sort_keys=False, width=2**31 - 1
    )


def from_yaml(text: str) -> Any:
    """Return plain data from YAML: maps, lists, texts and numbers, whatever the text asks for.

    Raises ValueError when it asks for more, or is no YAML.
    """
    try:
        return yaml.safe_load(text)  # not in C: that crashes on text nested 100,000 deep
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(str(error)) from error


def write_metadata(folder: Path, content: Mapping[str, Any]) -> None:
    """Write a bag's map to its metadata.yaml, which appears only when complete.

    Raises OSError.
    """
    partial = folder / (FILE_NAME + '.partial')
    partial.unlink(missing_ok=True)  # a link there would lead the text out of the folder
    with partial.open('x', encoding='utf-8') as stream:
        stream.write(to_yaml({ROOT_KEY: dict(content)}))
    partial.replace(folder / FILE_NAME)


def advice(folder: Path) -> str:
    """Say what to do about a bag that is not whole."""
    return f'recover it by `ros2 run herding_ros recover {folder}`'


def read_metadata(folder: Path) -> dict[str, Any]:
    """Return the map of a bag.

    Raises FileNotFoundError when there is none or the bag has a data file that is not in it,
    ValueError when it cannot be understood.
    """
    file = folder / FILE_NAME
    if not file.is_file():
        if any(folder.glob('*.mcap')):
            raise FileNotFoundError(
                f'{folder} has not been closed: there is no {FILE_NAME}; {advice(folder)}'
            )
        raise FileNotFoundError(f'{folder} is no bag: there is no {FILE_NAME}')
    try:
        content = dict(from_yaml(file.read_text(encoding='utf-8'))[ROOT_KEY])
        listed = {PurePath(path).name for path in content['relative_file_paths']}
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f'{file} does not describe a bag: {error}') from error
    unlisted = sorted(path.name for path in folder.glob('*.mcap') if path.name not in listed)
    if unlisted:
        raise FileNotFoundError(
            f'{folder} has not been closed: {FILE_NAME} does not list {", ".join(unlisted)}; '
            f'{advice(folder)}'
        )
    return content
