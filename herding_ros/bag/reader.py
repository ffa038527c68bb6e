# SPDX-License-Identifier: Apache-2.0
"""Reading a recorded run back, without rclpy: `read_run(bag)`.

It reads our bags and those of a stock `ros2 bag record`, mcap or sqlite3.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import fields
import json
import os
from pathlib import Path
import re
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader
import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag2 import ReaderError
from rosbags.typesys import get_typestore, Stores

from ..point_cloud import points
from .inspection import inspect
from .metadata import advice, file_names, read_metadata, string_map
from .recorded_run import Array, RecordedRun, Replan, Topic

PLAN_STATUS = 'controller: plan'
"""Name of the diagnostic status of a replan."""

Series = list[tuple[int, Any]]
"""The messages of a topic with their stamps [ns], which never decrease."""


def read_run(path: str | os.PathLike[str]) -> RecordedRun:
    """Read the bag in the folder `path`.

    The states are the true ones where they were recorded, else the observed. When the sim was
    reset, it is the last run that is read. Raises FileNotFoundError when there is no complete
    bag, ValueError when it is damaged or lacks sheep, dogs or destination.
    """
    folder = Path(path)
    metadata = read_metadata(folder)
    _check_files(folder, metadata)
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            return _read(reader, folder, metadata)
    except (AnyReaderError, McapError, ReaderError) as error:
        raise ValueError(f'the bag {folder} is damaged or cut off: {error}') from error


def _check_files(folder: Path, metadata: dict[str, Any]) -> None:
    """Raise ValueError unless all data files are whole.

    AnyReader allocates what a file asks for, and does not report every damage.
    """
    mode = str(metadata.get('compression_mode') or 'none').lower()
    if mode != 'none':
        raise ValueError(
            f'the bag {folder} is compressed by rosbag2, mode {mode}: write it anew without by '
            '`ros2 bag convert`; compression by mcap can be read'
        )
    for file in _files(folder, metadata):
        if file.is_symlink() or not file.is_file():
            raise ValueError(f'the bag {folder} is damaged: {file.name} is missing or not a file')
        faults = inspect(file).faults if metadata.get('storage_identifier') == 'mcap' else []
        if faults:
            raise ValueError(
                f'the bag {folder} is damaged: {file.name}, {faults[0]}; {advice(folder)}'
            )


def _files(folder: Path, metadata: dict[str, Any]) -> list[Path]:
    return [folder / name for name in file_names(metadata)]


def _read(reader: AnyReader, folder: Path, metadata: dict[str, Any]) -> RecordedRun:
    names = sorted(reader.topics)
    sheep = next((name for name in ('/truth/sheep', '/sheep') if name in names), None)
    dogs = _of_each_dog(names, '/truth', 'odom') or _of_each_dog(names, '', 'odom')
    if sheep is None or not dogs:
        raise ValueError(
            f'the bag {folder} has no states: they are in /truth/sheep or /sheep, and in '
            f'/truth/dog_1/odom or /dog_1/odom, but there is only {", ".join(names) or "nothing"}'
        )
    commanded = _of_each_dog(names, '', 'cmd_vel')
    series = _series(reader, [sheep, *dogs, *commanded, '/goal_pose', '/diagnostics'])
    empty = [topic for topic in (sheep, *dogs) if not series[topic]]
    if empty:
        raise ValueError(f'the bag {folder} has no messages of {", ".join(empty)}')

    custom_data = string_map(metadata.get('custom_data'))
    parameters = json.loads(custom_data.get('parameters', '{}'))
    start = series[sheep][0][0]
    times, x, v = _flock(series[sheep], start)
    command_times, commands = _commands([series[topic] for topic in commanded], start)
    return RecordedRun(
        times=times,
        x=x,
        v=v,
        d=np.stack([_track(series[topic], start, times) for topic in dogs], axis=1),
        command_times=command_times,
        commands=commands,
        goal=_goal(series, parameters, folder),
        replans=_replans(series['/diagnostics'], start),
        parameters=parameters,
        version=custom_data.get('herding_ros_version', ''),
        wall_s=_wall_seconds(reader, sheep, folder, metadata),
        topics=_topics(reader),
        messages_lost=_count(custom_data.get('messages_lost', '')),
    )


def _count(text: str) -> int | None:
    return int(text) if re.fullmatch('[0-9]{1,18}', text) else None


def _of_each_dog(names: Iterable[str], prefix: str, suffix: str) -> list[str]:
    """Return the topics of dog 1, dog 2, … in this order."""
    matches = [re.fullmatch(f'{prefix}/dog_([0-9]+)/{suffix}', name) for name in names]
    numbers = sorted(int(match[1]) for match in matches if match)
    return [f'{prefix}/dog_{number}/{suffix}' for number in numbers]


def _series(reader: AnyReader, topics: list[str]) -> dict[str, Series]:
    """Read topics; of each what came after its stamps last jumped back."""
    series: dict[str, Series] = defaultdict(list)
    connections = [connection for connection in reader.connections if connection.topic in topics]
    # Without connections to filter for, AnyReader returns all.
    for connection, log_ns, data in reader.messages(connections) if connections else ():
        message: Any = reader.deserialize(data, connection.msgtype)
        if connection.topic == '/diagnostics' and not _plans(message):
            continue  # the other nodes' stamps may be of other clocks
        stamp = getattr(getattr(message, 'header', None), 'stamp', None)
        ns = log_ns if stamp is None else stamp.sec * 1_000_000_000 + stamp.nanosec
        of_topic = series[connection.topic]
        if of_topic and ns < of_topic[-1][0]:
            of_topic.clear()
        of_topic.append((ns, message))
    return series


def _flock(series: Series, start: int) -> tuple[Array, Array, Array]:
    """Return times (T,) [s], positions (T, N, 2) [m] and velocities (T, N, 2) [m/s]."""
    clouds = [points(message) for _, message in series]
    for cloud in clouds:
        missing = {'id', 'x', 'y', 'vx', 'vy'}.difference(cloud.dtype.names or ())
        if missing:
            raise ValueError(f'the clouds of sheep lack the fields {", ".join(sorted(missing))}')
    clouds = [np.sort(cloud, order='id') for cloud in clouds]
    if any(not np.array_equal(cloud['id'], clouds[0]['id']) for cloud in clouds):
        raise ValueError('the sheep in the bag are not the same at all times')
    x = np.array([np.stack([cloud['x'], cloud['y']], axis=-1) for cloud in clouds], np.float64)
    v = np.array([np.stack([cloud['vx'], cloud['vy']], axis=-1) for cloud in clouds], np.float64)
    return _seconds(series, start), x, v


def _track(series: Series, start: int, times: Array) -> Array:
    """Return the positions (T, 2) [m] of a dog, interpolated at times (T,) [s]."""
    seconds = _seconds(series, start)
    positions = [message.pose.pose.position for _, message in series]
    x = np.interp(times, seconds, [position.x for position in positions])
    y = np.interp(times, seconds, [position.y for position in positions])
    return np.stack([x, y], axis=-1)


def _commands(of_dogs: list[Series], start: int) -> tuple[Array, Array]:
    """Return all times (K,) [s] of commands, and each dog's last (K, M, 2) [m/s] at them."""
    seconds = [_seconds(series, start) for series in of_dogs]
    times = np.unique(np.concatenate([*seconds, np.empty(0)]))
    commands = np.zeros((len(times), len(of_dogs), 2))
    for m, series in enumerate(of_dogs):
        twists: list[Any] = [getattr(message, 'twist', message) for _, message in series]
        sent = np.array([(0.0, 0.0), *((twist.linear.x, twist.linear.y) for twist in twists)])
        commands[:, m] = sent[np.searchsorted(seconds[m], times, side='right')]
    return times, commands


def _seconds(series: Series, start: int) -> Array:
    return np.array([ns - start for ns, _ in series], np.float64) * 1e-9


def _goal(series: dict[str, Series], parameters: dict[str, dict[str, Any]], folder: Path) -> Array:
    """Return the last destination (2,) [m]: from a user, by parameter, or the last plan's."""
    if poses := series['/goal_pose']:
        position = poses[-1][1].pose.position
        return np.array([position.x, position.y])
    goal = parameters.get('/controller', {}).get('goal')
    if goal is not None:
        return np.array(goal, np.float64)
    for _, message in reversed(series['/diagnostics']):
        for values in map(_values, _plans(message)):
            if 'goal_x' in values and 'goal_y' in values:
                return np.array([float(values['goal_x']), float(values['goal_y'])])
    raise ValueError(
        f'the bag {folder} has no destination: there is neither a message on /goal_pose '
        f'nor a parameter goal of /controller, nor a status "{PLAN_STATUS}" that names it'
    )


def _replans(diagnostics: Series, start: int) -> tuple[Replan, ...]:
    replans: dict[int, Replan] = {}  # by number: a status may be published more than once
    for ns, message in diagnostics:
        for status in _plans(message):
            values = _values(status)
            number = int(values.get('replan', len(replans)))
            replans.setdefault(number, _replan((ns - start) * 1e-9, number, values))
    return tuple(replans.values())


def _plans(diagnostics: Any) -> list[Any]:
    return [status for status in diagnostics.status if status.name == PLAN_STATUS]


def _values(status: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def _replan(time: float, number: int, values: dict[str, str]) -> Replan:
    """Return what the controller said of a replan; a number's name is that of its field."""
    status = values.get('status', '')
    names = {field.name for field in fields(Replan)} - {'time', 'number', 'status'}
    return Replan(time, number, status, **{n: float(values.get(n, 'nan')) for n in names})


def _wall_seconds(reader: AnyReader, topic: str, folder: Path, metadata: dict[str, Any]) -> float:
    """Return the time from the first message of a topic to the last.

    Bags in mcap keep when a message was published; the log time may be a simulation's.
    """
    if metadata.get('storage_identifier') == 'mcap':
        published = []
        for file in _files(folder, metadata):
            with file.open('rb') as stream:
                messages = make_reader(stream).iter_messages([topic], log_time_order=False)
                published += [message.publish_time for _, _, message in messages]
    else:
        connections = [c for c in reader.connections if c.topic == topic]
        published = [log_ns for _, log_ns, _ in reader.messages(connections)]
    return (max(published) - min(published)) * 1e-9


def _topics(reader: AnyReader) -> tuple[Topic, ...]:
    seconds = reader.duration * 1e-9
    return tuple(
        Topic(
            name,
            info.msgtype or 'several types',
            info.msgcount,
            info.msgcount / seconds if seconds > 0.0 else 0.0,
        )
        for name, info in sorted(reader.topics.items())
    )
