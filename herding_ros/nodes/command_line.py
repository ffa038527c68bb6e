# SPDX-License-Identifier: Apache-2.0
"""The command line of a node: help, and a refusal of what is not a ROS argument."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
import sys
from typing import NoReturn

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.utilities import remove_ros_args

from herding_ros.model.parameters import Parameters

from .signals import END_WITH_STDIN, end_with_stdin

Row = tuple[str, str, str]
"""Name, default with its unit, and meaning of a parameter."""


def rows(groups: Iterable[tuple[str, Parameters]], names: Iterable[str]) -> list[Row]:
    """Return the rows of some parameters, by their dotted names after each group's prefix."""
    entries = {entry.name: entry for prefix, group in groups for entry in group.walk(prefix)}
    return [
        (name, f'{_written(entries[name].value)} {meta["unit"]}'.strip(), meta['doc'])
        for name in names
        for meta in [entries[name].field.metadata]
    ]


def read(
    node: str, description: str, topics: str, parameters: list[Row], example: str,
    args: list[str] | None,
) -> None:  # fmt: skip
    """Check the arguments of a node (default: those of the process) before it starts anything.

    Exits with code 0 after printing help, with 2 if there is an argument that is not ROS's.
    """
    parser = _Parser(
        prog=node,
        usage=f'{node} [-h] [{END_WITH_STDIN}] '
        '[--ros-args -p NAME:=VALUE ... --params-file FILE -r FROM:=TO ...]',
        description=description,
        epilog=f'{topics}\n\nsome parameters (`ros2 param describe /{node}` has all):\n'
        + _table(parameters)
        + f'\n\nexample:\n  {example}',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    given = sys.argv[1:] if args is None else args
    try:
        others = remove_ros_args(given)
    except (_rclpy.RCLInvalidROSArgsError, _rclpy.UnknownROSArgsError) as error:
        parser.error(f'bad ROS arguments: {error}')
    parser.add_argument(
        END_WITH_STDIN, action='store_true',
        help='end when the standard input ends, and so with a parent that holds a pipe to it',
    )  # fmt: skip
    if parser.parse_args(others).end_with_stdin:
        end_with_stdin()


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        hint = 'parameters follow --ros-args, as in --ros-args -p dogs:=3'
        self.exit(2, f'{self.prog}: {message}; {hint} (see {self.prog} --help)\n')


def _table(parameters: list[Row]) -> str:
    widths = [max(len(row[i]) for row in parameters) for i in (0, 1)]
    return '\n'.join(
        f'  {name:<{widths[0]}}  {default:<{widths[1]}}  {meaning}'
        for name, default, meaning in parameters
    )


def _written(value: object) -> str:
    if isinstance(value, tuple):
        return f'[{", ".join(map(_written, value))}]'
    return str(value).lower() if isinstance(value, bool) else str(value) or "''"
