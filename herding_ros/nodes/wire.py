# SPDX-License-Identifier: Apache-2.0
"""Messages as the bytes on the wire (CDR), for topics with thousands of messages a second.

rclpy takes 35 µs to send an Odometry and 55 µs to take one, most of it for covariances that are
not used. As bytes it takes 5 each. They are: the encoding (4 bytes), the stamp (8), strings such
as the frame, and at the end, for many types, a fixed number of numbers. So a message equals any
other of its kind but for the stamp and the numbers.
"""

from __future__ import annotations

import array
from collections.abc import Callable
from functools import lru_cache
from operator import attrgetter
import struct
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from .refusals import Refused

_ENCODING = b'\0\1\0\0'
"""CDR, little-endian: a position in a message is counted from here."""

_STAMP = struct.Struct('<iI')
_SECOND = 1_000_000_000
_BYTE_ORDERS = {b'\0\0': '>', b'\0\1': '<'}
"""As in `struct`, by the first two bytes; the next two are options without a meaning here."""

_LAST = 2**31 * _SECOND - 1
"""The last time that fits into a stamp [ns]: early in 2038."""

LONGEST_STRING = 255
"""Bytes of a string such as the name of a frame; longer ones are refused."""


def seconds_and_rest(ns: int) -> tuple[int, int]:
    """Return a time [ns] as seconds and nanoseconds, or the nearest one that fits into a stamp."""
    return divmod(max(-_LAST - 1, min(ns, _LAST)), _SECOND)


_FORMATS = {
    'boolean': '?', 'octet': 'c', 'float': 'f', 'double': 'd', 'int8': 'b', 'uint8': 'B',
    'int16': 'h', 'uint16': 'H', 'int32': 'i', 'uint32': 'I', 'int64': 'q', 'uint64': 'Q',
}  # fmt: skip
"""Formats of `struct` by the names of ROS."""


def serialized(message: Any) -> bytes:
    """Return the bytes of a message, with zeros where numbers are aligned and at its end.

    rclpy leaves what was in memory between the numbers, and Fast DDS, which sends a multiple of
    four bytes, at the end; so equal messages would differ.
    """
    return bytes(_filled_up(_appended(message)))


def _appended(message: Any) -> bytearray:
    data = bytearray(_ENCODING)
    _append(data, message, '')
    return data


def _filled_up(data: bytearray) -> bytearray:
    _align(data, 4)
    return data


def _append(data: bytearray, value: Any, kind: str) -> None:
    """Append a value of a type such as 'double', 'string', 'uint8[4]' or 'sequence<double>'."""
    if kind in _FORMATS:
        number = struct.pack('<' + _FORMATS[kind], value)
        _align(data, len(number))
        data += number
    elif kind == 'string':
        text = value.encode() + b'\0'
        _append(data, len(text), 'uint32')
        data += text
    elif kind.endswith(('>', ']')):  # sequence<KIND> or sequence<KIND, MOST>, KIND[COUNT]
        is_sequence = kind.startswith('sequence<')
        if is_sequence:
            _append(data, len(value), 'uint32')
        if isinstance(value, array.array | np.ndarray):
            if len(value):
                _align(data, value.itemsize)
            data += value.tobytes()
        else:
            kind = kind[9:-1].split(',')[0] if is_sequence else kind[: kind.index('[')]
            for each in value:
                _append(data, each, kind)
    else:
        message_type: Any = type(value)
        doubles = _doubles(message_type)
        if doubles is not None:  # points and the like, of which there are thousands
            _align(data, 8)
            data += doubles(value)
            return
        for name, kind in _fields(message_type):
            _append(data, getattr(value, name), kind)


def _align(data: bytearray, size: int) -> None:
    data += bytes(-(len(data) - len(_ENCODING)) % size)


@lru_cache(maxsize=100)
def _fields(message_type: Any) -> tuple[tuple[str, str], ...]:
    """Return name and type of the fields of a message."""
    return tuple(message_type.get_fields_and_field_types().items())


@lru_cache(maxsize=100)
def _doubles(message_type: Any) -> Callable[[Any], bytes] | None:
    """Return what packs a message of two or more doubles alone; None for other types."""
    fields = _fields(message_type)
    if len(fields) < 2 or any(kind != 'double' for _, kind in fields):
        return None
    numbers = attrgetter(*(name for name, _ in fields))
    pack = struct.Struct(f'<{len(fields)}d').pack
    return lambda message: pack(*numbers(message))


def type_name(message_type: Any) -> str:
    """Return the full name of a type of messages, such as 'std_msgs/msg/Header'."""
    return f'{message_type.__module__.split(".")[0]}/msg/{message_type.__name__}'


class Template:
    """A message that is sent again and again, with another stamp and other numbers.

    `numbers` are those at its end, as a record of a type without gaps; set its fields.
    """

    def __init__(self, message: Any, numbers: DTypeLike) -> None:
        data = _appended(message)
        offset = len(data) - np.dtype(numbers).itemsize
        self._data = _filled_up(data)
        self.numbers: Any = np.ndarray((), numbers, self._data, offset)

    def stamped(self, ns: int) -> bytes:
        """Return the message as it is now, with a stamp [ns]."""
        _STAMP.pack_into(self._data, len(_ENCODING), *seconds_and_rest(ns))
        return bytes(self._data)


class Reader:
    """Reads a message from the front, in either byte order.

    It checks each length against the bytes that are there: rclpy's own deserialisation allocates
    as many fields as a cloud claims to have, and prints a line to stderr for each wrong length.
    Every method raises Refused, kind 'malformed', when the message does not hold what is asked
    for.
    """

    def __init__(self, data: bytes) -> None:
        order = _BYTE_ORDERS.get(data[:2])
        if order is None:
            raise Refused(
                'malformed', f'it must be a CDR message, got {len(data)} bytes, {data[:4]!r} ...'
            )
        self._order = order
        self._data = data
        self._at = len(_ENCODING)

    @property
    def left(self) -> int:
        """Number of bytes that have not been read."""
        return len(self._data) - self._at

    def header(self) -> tuple[int, str]:
        """Return stamp [ns] and frame of a std_msgs/Header."""
        sec, nanosec = self.numbers('iI')
        if nanosec >= _SECOND:
            raise Refused('malformed', f'its stamp must have less than 1e9 ns, got {nanosec}')
        return sec * _SECOND + nanosec, self.string()

    def numbers(self, kinds: str) -> tuple[Any, ...]:
        """Return numbers of the given kinds (as in `struct`), the first of 4 bytes or less."""
        layout = _layout(self._order + kinds)
        self._at += -self._at % 4
        return layout.unpack_from(self._data, self._pass(layout.size))

    def string(self) -> str:
        """Return a string."""
        (length,) = self.numbers('I')
        if length > LONGEST_STRING:
            raise Refused(
                'malformed', f'its strings must have at most {LONGEST_STRING} bytes, got {length}'
            )
        at = self._pass(length)
        return self._data[at : self._at].removesuffix(b'\0').decode(errors='replace')

    def sequence(self) -> memoryview:
        """Return a sequence of bytes."""
        (length,) = self.numbers('I')
        at = self._pass(length)
        return memoryview(self._data)[at : self._at]

    def some_doubles(self, count: int) -> tuple[float, ...]:
        """Return so many doubles."""
        self._at += -(self._at - len(_ENCODING)) % 8
        layout = _layout(f'{self._order}{count}d')
        return layout.unpack_from(self._data, self._pass(layout.size))

    def sequence_of_doubles(self, each: int) -> tuple[float, ...]:
        """Return the numbers of a sequence of messages that have so many doubles each."""
        (count,) = self.numbers('I')
        return self.some_doubles(count * each) if count else ()

    def flag(self) -> bool:
        """Return a boolean."""
        return self._data[self._pass(1)] != 0

    def doubles(self, count: int, wanted: int) -> tuple[float, ...]:
        """Return the first `wanted` of the `count` doubles that the message ends with."""
        at = self._at + -(self._at - len(_ENCODING)) % 8
        if len(self._data) - at != 8 * count:
            raise Refused(
                'malformed',
                f'it must have {at + 8 * count} bytes with its strings, got {len(self._data)}',
            )
        self._at = len(self._data)
        return _layout(f'{self._order}{wanted}d').unpack_from(self._data, at)

    def end_after(self, last: str) -> None:
        """Refuse what does not end; a message may be filled up to a multiple of four bytes."""
        if self.left > 3:
            raise Refused('malformed', f'at most 3 bytes must follow {last}, got {self.left}')

    def _pass(self, size: int) -> int:
        """Skip `size` bytes and return their offset."""
        at = self._at
        self._at = at + size
        if self._at > len(self._data):
            raise Refused('malformed', f'it must hold all its fields, got {len(self._data)} bytes')
        return at


_layout = lru_cache(struct.Struct)
