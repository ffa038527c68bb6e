# SPDX-License-Identifier: Apache-2.0
"""What the launch files start, by their arguments; checked before anything is started.

Without launch itself, which not every ROS installation has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
import re
import time
from typing import Any

from ament_index_python.packages import (
    get_package_prefix,
    get_package_share_directory,
    PackageNotFoundError,
)
from herding_ros.control.lead import lead_at
from herding_ros.control.parameters import check_lockstep, Control
import yaml

from .configuration import awaited, crowd_of, parameters_of
from .publishing import CLOCK


@dataclass(frozen=True)
class LaunchPlan:
    """Nodes to start, in the order in which they end; all take what they declare of the values.

    The namespace is a full name, or '' for that of whoever includes the launch file.
    """

    nodes: tuple[str, ...]
    namespace: str
    config: Path
    values: Mapping[str, Any]
    log_level: str
    rviz: bool


@dataclass(frozen=True)
class Argument:
    """An argument of a launch file. `read` gives its value, or raises ValueError.

    An empty text is read as None, and leaves the parameter to the parameter file.
    """

    name: str
    default: str
    description: str
    read: Callable[[str], Any]


def _truth(text: str) -> bool:
    value = yaml.safe_load(text)
    if value not in (True, False):  # 1 and 0 as well
        raise ValueError('must be true or false')
    return bool(value)


def _integer(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise ValueError('must be an integer') from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError('must be a number') from None


def _point(text: str) -> list[float]:
    try:
        x, y = (float(word) for word in text.strip().strip('[]').replace(',', ' ').split())
    except ValueError:
        raise ValueError('must be [x, y] in metres') from None
    return [x, y]


def _file(text: str) -> Path:
    path = Path(text).absolute()
    if not path.is_file():
        raise ValueError('must be a parameter file that exists')
    return path


def _level(text: str) -> str:
    levels = ('debug', 'info', 'warn', 'error', 'fatal')
    if text.lower() not in levels:
        raise ValueError(f'must be one of {", ".join(levels)}')
    return text.lower()


def _common(config: str, use_sim_time: str, record: str) -> tuple[Argument, ...]:
    share = Path(get_package_share_directory('herding_ros'))
    bag = time.strftime('herding_%Y_%m_%d-%H_%M_%S')
    return (
        Argument('namespace', '', 'namespace of all nodes and of their clock', str),
        Argument('config', str(share / 'config' / config), 'parameter file of all nodes', _file),
        Argument('dogs', '', 'number of dogs; empty: as in config', _integer),
        Argument('goal', '', 'destination [x, y] in metres; empty: as in config', _point),
        Argument('seed', '', 'seed of all random numbers; empty: as in config', _integer),
        Argument('use_sim_time', use_sim_time, 'time is that of /clock, not the system', _truth),
        Argument('log_level', 'info', 'debug, info, warn, error or fatal', _level),
        Argument('record', record, 'record every topic into a bag', _truth),
        Argument('bag', bag, 'folder of the bag, which must not exist', str),
        Argument('rviz', 'false', 'show it in RViz; its goal tool moves the destination', _truth),
    )


def herd_arguments() -> tuple[Argument, ...]:
    """Return the arguments of herding.launch.py."""
    return (
        *_common('herding.yaml', 'true', 'false'),
        Argument('sheep', '', 'number of sheep; empty: as in config', _integer),
        Argument('lockstep', 'false', 'the sim waits for each command, not for the clock', _truth),
        Argument('real_time_factor', '10.0', 'simulated seconds per second', _number),
        Argument('stop_on_arrival', 'false', 'end when the flock is home and together', _truth),
        Argument('time_limit', '', 'simulated seconds to try; empty: as in config', _number),
    )


def real_dogs_arguments() -> tuple[Argument, ...]:
    """Return the arguments of real_dogs.launch.py."""
    return _common('real_dogs.yaml', 'false', 'true')


def plan_herd(words: Mapping[str, str]) -> LaunchPlan:
    """Return what herding.launch.py starts with these arguments: ValueError if they are bad."""
    values = _read(herd_arguments(), words)
    return _plan(('sim', 'controller'), {**values, 'end_when_finished': True})


def plan_real_dogs(words: Mapping[str, str]) -> LaunchPlan:
    """Return what real_dogs.launch.py starts with these arguments: ValueError if they are bad."""
    return _plan(('controller',), _read(real_dogs_arguments(), words))


def _read(arguments: tuple[Argument, ...], words: Mapping[str, str]) -> dict[str, Any]:
    values = {}
    for argument in arguments:
        text = words[argument.name]
        try:
            values[argument.name] = argument.read(text) if text or argument.default else None
        except (ValueError, yaml.YAMLError) as error:
            raise ValueError(f'{argument.name} {error}, got {text!r}') from None
    values['namespace'] = words['namespace'].strip('/') and f'/{words["namespace"].strip("/")}'
    return values


def _plan(nodes: tuple[str, ...], values: dict[str, Any]) -> LaunchPlan:
    namespace, config, level, record, rviz = (
        values.pop(name) for name in ('namespace', 'config', 'log_level', 'record', 'rviz')
    )
    told = {name: value for name, value in values.items() if value is not None}
    if record:
        nodes = (*nodes, 'recorder')
        if Path(told['bag']).exists():
            raise ValueError(f'bag must be a folder that does not exist, got {told["bag"]!r}')
    written = parameters_of(config)
    told['wait_for'] = awaited(written('recorder', namespace)) if record else ''
    if rviz:
        _require('rviz2', 'rviz:=true')
    if 'lead' not in written('controller', namespace) and 'real_time_factor' in told:
        told['lead'] = lead_at(told['real_time_factor'])
    if 'sim' in nodes and told['lockstep']:
        _check_lockstep(written('sim', namespace), written('controller', namespace))
    return LaunchPlan(nodes, namespace, config, told, level, rviz)


def _check_lockstep(sim: Mapping[str, Any], controller: Mapping[str, Any]) -> None:
    from herding_ros.control.scale import Scale  # it takes a second, and is seldom needed
    from herding_ros.model.simulation import World

    def value(name: str, given: Mapping[str, Any], reference: Control | World) -> Any:
        speed = given.get('max_speed', reference.max_speed)
        defaults = Scale.of(crowd_of(given), speed).apply(reference)
        return given.get(name, defaults.flat()[name])

    check_lockstep(
        value('horizon.control_period', controller, Control()),
        value('dt', sim, World()) * value('substeps', sim, World()),
    )


def _require(package: str, argument: str) -> None:
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        raise ValueError(
            f'{argument} needs the package {package}, which must be installed and sourced: '
            f'sudo apt install ros-jazzy-{package}'
        ) from None


# RViz.


def names_in_namespace(rviz_file: Path) -> list[tuple[str, str]]:
    """Return the remappings with which RViz shows the nodes of its own namespace."""
    topics = re.findall(r'Value: /(\S+)', rviz_file.read_text(encoding='utf-8'))
    return [(f'/{topic}', topic) for topic in dict.fromkeys([CLOCK.strip('/'), *topics])]
