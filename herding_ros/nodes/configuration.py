# SPDX-License-Identifier: Apache-2.0
"""Parameters as files and command lines give them: names and values, before any node has them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
import difflib
from pathlib import Path
import re
from typing import Any

from herding_ros.control.parameters import Control
from herding_ros.model.crowd import Crowd
from herding_ros.model.parameters import check, Parameters
from herding_ros.model.simulation import World
import yaml

from .settings import (
    ControllerSettings,
    ControlPreset,
    CrowdPreset,
    MotionKind,
    RecorderSettings,
    SimSettings,
    ViewSettings,
)

_OF_ROS = ('use_sim_time', 'qos_overrides.')


class _Loader(yaml.SafeLoader):
    """YAML as ROS reads it: 1e-3 is a number."""


_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+'),
    list('-+.0123456789'),
)


def _read(text: str) -> Any:
    return _Loader(text).get_single_data()


def parameters_of(file: Path) -> Callable[[str, str], dict[str, Any]]:
    """Return a function of a node and its namespace that gives what the file tells it, flat.

    Raises ValueError if it is not a parameter file.
    """
    try:
        content = _read(file.read_text(encoding='utf-8'))
        sections = {
            f'/{name.strip("/")}': dict(_flat(section['ros__parameters']))
            for name, section in content.items()
        }
    except (yaml.YAMLError, OSError, ValueError, AttributeError, TypeError, KeyError) as error:
        raise ValueError(
            f'config must be a file of sections /**: ros__parameters: ..., got {file}: {error}'
        ) from None

    def told(node: str, namespace: str) -> dict[str, Any]:
        name = f'{namespace}/{node}'
        return {
            key: value
            for section, values in sections.items()
            if re.fullmatch(_pattern(section), name)
            for key, value in values.items()
        }

    return told


def _pattern(section: str) -> str:
    """Return the regular expression of the names of nodes that a section is for, as in rcl."""
    wild = {'**': '(/[^/]+)*', '*': '/[^/]+'}
    return ''.join(wild.get(word, f'/{re.escape(word)}') for word in section.split('/')[1:])


def _flat(tree: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}', value


def crowd_of(values: Mapping[str, Any]) -> Crowd:
    """Return the crowd of a node that is told these values; ValueError if they are bad."""

    def own(parameters: Parameters) -> dict[str, Any]:
        return {name: values[name] for name in parameters.flat('crowd.') if name in values}

    chosen = CrowdPreset()
    crowd = chosen.with_values(own(chosen), 'crowd.').crowd
    return crowd.with_values(own(crowd), 'crowd.')


def awaited(recorder: Mapping[str, Any]) -> str:
    """Return whom the other nodes wait for, `wait_for`, beside a recorder of these parameters.

    They wait until all that they publish is heard. One that records chosen topics never hears all.
    """
    return '' if any(recorder.get('topics') or ()) else 'recorder'


def assignment(text: str) -> tuple[str, Any]:
    """Return name and value of NAME:=VALUE, where VALUE is YAML, as after a node's -p."""
    name, sign, value = text.partition(':=')
    if not (name and sign):
        raise ValueError(f'a parameter must be given as NAME:=VALUE, got {text!r}')
    try:
        return name, _read(value)
    except yaml.YAMLError as error:
        raise ValueError(f'the value of a parameter must be YAML, got {text!r}: {error}') from None


def checked(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters of our nodes by their names, numbers with a point where they need one.

    Raises ValueError for a name that no node has with this `crowd.preset` and `motion.kind`, since
    ROS would ignore it, and for a value that is not allowed.
    """
    kind = values.get('motion.kind', MotionKind().kind)
    motion = MotionKind(kind).motion
    groups: list[tuple[str, Parameters]] = [
        *(
            ('', each)
            for each in (replace(World(), motion=motion), SimSettings(), RecorderSettings())
        ),
        ('', ViewSettings()),
        *(('', each) for each in (Control(motion=motion), ControlPreset(), ControllerSettings())),
        ('motion.', MotionKind()),
        ('crowd.', CrowdPreset()),
        ('crowd.', crowd_of(values)),
    ]
    fields = {entry.name: entry.field for prefix, group in groups for entry in group.walk(prefix)}
    found = {}
    for name, value in values.items():
        if name.startswith(_OF_ROS):
            found[name] = value
        elif name in fields:
            found[name] = check(f'parameter {name}', value, fields[name])
        else:
            close = difflib.get_close_matches(name, fields, 1)
            hint = f'; did you mean {close[0]}?' if close else ''
            raise ValueError(f'no node has a parameter {name}{hint}')
    return found
