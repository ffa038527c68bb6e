"""The metadata of a rosbag2 bag, version 9: one YAML map, kept in two places.

rosbag2 writes the same map to `metadata.yaml` beside the data and into the data file itself,
from which `ros2 bag reindex` restores the former. The layout is that of rosbag2_storage's
yaml.hpp and qos.cpp in ROS 2 Jazzy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

VERSION = 9
"""From this version on, policies are written by name and offered profiles as a sequence."""

FILE_NAME = 'metadata.yaml'
"""Name of the file in the bag's folder."""

ROOT_KEY = 'rosbag2_bagfile_information'
"""The only key of metadata.yaml; the map under it is what the data file keeps."""

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


def bag_map(file: FileInformation, custom_data: Mapping[str, str]) -> dict[str, Any]:
    """Return the map that describes a bag of one file."""
    start = {'nanoseconds_since_epoch': file.first_ns}
    duration = {'nanoseconds': file.last_ns - file.first_ns}
    return {
        'version': VERSION,
        'storage_identifier': 'mcap',
        'duration': duration,
        'starting_time': start,
        'message_count': file.message_count,
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
            for topic in file.topics.values()
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file.path],
        'files': [
            {
                'path': file.path,
                'starting_time': start,
                'duration': duration,
                'message_count': file.message_count,
            }
        ],
        'custom_data': dict(custom_data) or None,
        'ros_distro': ROS_DISTRO,
    }


class _Dumper(yaml.SafeDumper):
    """Writes an object that occurs twice twice: rosbag2's readers expect no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def to_yaml(data: Any) -> str:
    """Return data as YAML in block style, keys in their order, no line ever folded."""
    return yaml.dump(
        data, Dumper=_Dumper, default_flow_style=False, sort_keys=False, width=float('inf')
    )


def read_metadata(folder: Path) -> dict[str, Any]:
    """Return the map of a bag.

    Raises FileNotFoundError when there is none, ValueError when it cannot be understood.
    """
    file = folder / FILE_NAME
    if not file.is_file():
        what = 'has not been closed' if any(folder.glob('*.mcap')) else 'is no bag'
        raise FileNotFoundError(f'{folder} {what}: there is no {FILE_NAME}')
    try:
        content = yaml.safe_load(file.read_text(encoding='utf-8'))
        return dict(content[ROOT_KEY])
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f'{file} does not describe a bag: {error}') from error
