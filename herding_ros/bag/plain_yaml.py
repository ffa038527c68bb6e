# SPDX-License-Identifier: Apache-2.0
"""YAML as bags contain it: maps, lists, strings and numbers, whatever a stranger wrote."""

from __future__ import annotations

import re
from typing import Any

import yaml
from yaml.constructor import SafeConstructor
from yaml.cyaml import CParser  # type: ignore[attr-defined]
from yaml.resolver import BaseResolver

MOST_CHARACTERS = 4_000_000
"""No longer string is read."""

MOST_EVENTS = 200_000
"""No string with more values and brackets is read."""

DEEPEST = 32
"""No deeper nesting is read."""


class _Loader(CParser, SafeConstructor, BaseResolver):  # type: ignore[misc]
    """Reads the numbers that rosbag2 writes; dates, octals and the like remain strings."""

    def __init__(self, stream: str) -> None:
        CParser.__init__(self, stream)
        SafeConstructor.__init__(self)
        BaseResolver.__init__(self)


for _tag, _pattern, _first in (
    ('null', r'~|null|', ['~', 'n', '']),
    ('bool', 'true|false', list('tf')),
    ('int', '-?(0|[1-9][0-9]{0,30})', list('-0123456789')),
    ('float', r'-?[0-9]+\.[0-9]*(e[-+]?[0-9]+)?', list('-0123456789')),
):
    _Loader.add_implicit_resolver(
        f'tag:yaml.org,2002:{_tag}', re.compile(f'(?:{_pattern})$'), _first
    )

_loader: Any = _Loader


class _Dumper(yaml.CSafeDumper):
    """Writes an object that occurs twice twice: rosbag2's readers expect no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def to_yaml(data: Any) -> str:
    """Return data as YAML in block style, keys in their order, no line ever folded."""
    return yaml.dump(
        data, Dumper=_Dumper, default_flow_style=False, sort_keys=False, width=2**31 - 1
    )


def from_yaml(string: str) -> Any:
    """Return the plain data in a string, in time and memory linear in its length.

    Raises ValueError when it is not YAML, is too long or too deep, or has aliases or tags.
    """
    if len(string) > MOST_CHARACTERS:
        raise ValueError(f'must have at most {MOST_CHARACTERS} characters, got {len(string)}')
    depth = 0
    try:
        for count, event in enumerate(yaml.parse(string, _loader)):
            if isinstance(event, yaml.AliasEvent) or getattr(event, 'tag', None):
                raise ValueError(f'must have neither aliases nor tags, got one{event.start_mark}')
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST or count > MOST_EVENTS:
                raise ValueError(
                    f'must have at most {MOST_EVENTS} values, nested at most {DEEPEST} deep'
                )
        return _loader(string).get_single_data()
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error
