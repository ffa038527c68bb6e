# SPDX-License-Identifier: Apache-2.0
"""The definition of a message type with those of all types it uses, as a bag keeps it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re

from ament_index_python.packages import get_package_share_directory, PackageNotFoundError

_TYPE_NAME = re.compile(r'(\w+)/(?:msg/)?(\w+)')

# A field's type at the start of a line; a bounded string (string<=8) is not a type of its own.
_FIELD_TYPE = re.compile(r'^[ \t]*([a-zA-Z][\w/]*)(?:\[[^\]]*\])?[ \t]', re.MULTILINE)

_PRIMITIVE_TYPES = {
    *('bool', 'byte', 'char', 'float32', 'float64', 'string', 'wstring'),
    *('int8', 'uint8', 'int16', 'uint16', 'int32', 'uint32', 'int64', 'uint64'),
}


def message_text(type_name: str) -> str:
    """Return the .msg file of a type, from the share folder of the type's package.

    Raises ValueError when the name is not that of a message type or the file is not there.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise ValueError(f'a message type must be package/msg/Type, got {type_name!r}')
    package, name = match.groups()
    try:
        share = Path(get_package_share_directory(package))
    except (PackageNotFoundError, OSError) as error:
        raise ValueError(
            f'no definition of {type_name!r}: no package {package!r} on AMENT_PREFIX_PATH; '
            'source the workspace that provides it'
        ) from error
    try:
        return (share / 'msg' / f'{name}.msg').read_text(encoding='utf-8')
    except OSError as error:
        raise ValueError(f'no definition of {type_name!r}: {error}') from error


def message_definition(type_name: str, text_of: Callable[[str], str] = message_text) -> str:
    """Return the definition of a type, followed by those of the types it uses, each once.

    Each of the latter comes after a line of 80 equal signs and a line `MSG: package/Type`:
    the encoding `ros2msg` of rosbag2. `text_of` gives the definition of a single type.

    Raises what `text_of` raises.
    """
    seen: set[str] = set()

    def full_text(name: str) -> str:
        text = text_of(name)
        result = text
        for used in sorted(_used_types(text, package=name.split('/')[0])):
            if used not in seen:
                seen.add(used)
                result += f'\n{"=" * 80}\nMSG: {used}\n{full_text(used)}'
        return result

    return full_text(type_name)


def _used_types(text: str, package: str) -> set[str]:
    names = set(_FIELD_TYPE.findall(text)) - _PRIMITIVE_TYPES
    return {name if '/' in name else f'{package}/{name}' for name in names}
