# SPDX-License-Identifier: Apache-2.0
"""The command line of a node: help, and a refusal of what is not a ROS argument."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
import shutil
import sys
import textwrap
from typing import NoReturn

from herding_ros.control.parameters import Control
from herding_ros.model.crowd import Crowd
from herding_ros.model.parameters import Parameters
from herding_ros.model.simulation import World

from .settings import ControllerSettings, RecorderSettings, SimSettings, ViewSettings
from .signals import END_WITH_STDIN, end_with_stdin

_SHORTEST_MEANING = 30
"""Least room for the meanings in a table of parameters [columns]."""

_Row = tuple[str, str, str]
"""Name, default with its unit, and meaning of a parameter."""


@dataclass(frozen=True)
class _Node:
    """What the help of a node says; parameters are some of those in the groups."""

    description: str
    topics: str
    groups: tuple[tuple[str, Parameters], ...]
    parameters: tuple[str, ...]
    example: str


_NODES = {
    'sim': _Node(
        'Moves the herd, and publishes what sensors would observe of it.',
        'publishes: sheep, dog_<i>/odom, dogs, the same below truth/, /clock, markers, '
        '/diagnostics\nsubscribes to: dog_<i>/cmd_vel, goal_pose\nservices: ~/reset, ~/pause',
        (('', SimSettings()), ('', World()), ('crowd.', Crowd())),
        (
            *('sheep', 'dogs', 'seed', 'goal', 'crowd.noise', 'position_noise', 'velocity_noise'),
            *('max_speed', 'lockstep', 'real_time_factor', 'stop_on_arrival', 'time_limit'),
        ),
        'sim --ros-args -p sheep:=20 -p dogs:=3 -p real_time_factor:=10.0',
    ),
    'controller': _Node(
        'Herds by space-mapping receding-horizon control: commands for the dogs from '
        'observations of sheep and dogs.',
        'publishes: dog_<i>/cmd_vel, plan, herd/goal, herd/path, herd/markers, dog_<i>/path, '
        '/diagnostics\n'
        'subscribes to: sheep, dog_<i>/odom, goal_pose, map, field/obstacle',
        (('', ControllerSettings()), ('', Control()), ('crowd.', Crowd())),
        (
            *('dogs', 'goal', 'seed', 'crowd.noise', 'max_speed', 'horizon.length'),
            *('horizon.accepted', 'lockstep', 'lead', 'state_timeout', 'mapping.paths', 'stamped'),
        ),
        'controller --ros-args -p dogs:=3 -p use_sim_time:=true -p lead:=5.0',
    ),
    'recorder': _Node(
        'Records every topic, as it is on the wire, into a rosbag2 bag (mcap).',
        'publishes: /diagnostics\nsubscribes to: all topics\nservices: ~/pause, ~/resume',
        (('', RecorderSettings()),),
        tuple(RecorderSettings().flat()),
        'recorder --ros-args -p bag:=my_bag -p use_sim_time:=true',
    ),
    'view': _Node(
        'Shows a herd, its plans and its controls in the browser, or plays a recorded run.',
        'publishes: goal_pose, /diagnostics\nsubscribes to: truth/sheep, truth/dog_<i>/odom (or '
        'sheep, dog_<i>/odom where there is no truth), plan, herd/path, herd/goal, /diagnostics, '
        '/parameter_events\ncalls: sim/pause, sim/reset, set_parameters of sim and controller',
        (('', ViewSettings()),),
        tuple(ViewSettings().flat()),
        'view --ros-args -p port:=9000',
    ),
}


def answer_help(node: str) -> None:
    """Print the help of a node and exit with 0 if the process is asked for it.

    That needs neither ROS nor compiled code.
    """
    _parser(node).parse_known_args([*takewhile('--ros-args'.__ne__, sys.argv[1:])])


def read(node: str, args: list[str] | None) -> argparse.Namespace:
    """Return the arguments of a node (default: those of the process) that are not ROS's.

    Exits with code 0 after printing help, with 2 if there is an argument that is not ROS's.
    """
    parser = _parser(node)
    given = sys.argv[1:] if args is None else args
    options = parser.parse_args(_without_ros_args(given, parser.error))
    if options.end_with_stdin:
        end_with_stdin()
    return options


def _parser(node: str) -> _Parser:
    said = _NODES[node]
    parser = _Parser(
        prog=node,
        usage=f'{node} [-h] [--ros-args -p NAME:=VALUE ... --params-file FILE -r FROM:=TO ...]',
        description=said.description,
        epilog='\n'.join(map(_wrapped, said.topics.splitlines()))
        + '\n\n'
        + _wrapped(f'some parameters (`ros2 param describe /{node}` has all):')
        + f'\n{_table(_rows(said))}\n\nexample:\n  {said.example}',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        END_WITH_STDIN, action='store_true',
        help='end when the standard input ends, and so with a parent that holds a pipe to it',
    )  # fmt: skip
    if node == 'view':
        parser.add_argument(
            'bag', nargs='?', type=Path, metavar='BAG', help='folder of a rosbag2 bag to play'
        )
    return parser


def _rows(node: _Node) -> list[_Row]:
    entries = {entry.name: entry for prefix, group in node.groups for entry in group.walk(prefix)}
    return [
        (name, f'{_written(entries[name].value)} {meta["unit"]}'.strip(), meta['doc'])
        for name in node.parameters
        for meta in [entries[name].field.metadata]
    ]


def _without_ros_args(given: list[str], refuse: Callable[[str], NoReturn]) -> list[str]:
    from rclpy.impl.implementation_singleton import rclpy_implementation as rclpy  # not for help
    from rclpy.utilities import remove_ros_args

    try:
        return list(remove_ros_args(given))
    except (rclpy.RCLInvalidROSArgsError, rclpy.UnknownROSArgsError) as error:
        refuse(f'bad ROS arguments: {error}')


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        hint = 'parameters follow --ros-args, as in --ros-args -p dogs:=3'
        self.exit(2, f'{self.prog}: {message}; {hint} (see {self.prog} --help)\n')


def _table(parameters: list[_Row]) -> str:
    """Return a table; where there is no room for one, the meanings are below the names."""
    widths = [max(len(row[i]) for row in parameters) for i in (0, 1)]
    start = sum(widths) + 6
    if start + _SHORTEST_MEANING <= _width():
        return '\n'.join(
            _wrapped(meaning, f'  {name:<{widths[0]}}  {default:<{widths[1]}}  ', start * ' ')
            for name, default, meaning in parameters
        )
    return '\n'.join(
        f'  {name}  {default}\n' + _wrapped(meaning, 6 * ' ', 6 * ' ')
        for name, default, meaning in parameters
    )


def _wrapped(text: str, first: str = '', others: str = 4 * ' ') -> str:
    """Return a text in lines that fit the terminal, with indents; no word is broken."""
    return textwrap.fill(
        text, _width(), initial_indent=first, subsequent_indent=others, break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip


def _width() -> int:
    return shutil.get_terminal_size().columns


def _written(value: object) -> str:
    if isinstance(value, tuple):
        return f'[{", ".join(map(_written, value))}]'
    return str(value).lower() if isinstance(value, bool) else str(value) or "''"
