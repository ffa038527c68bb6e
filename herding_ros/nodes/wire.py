"""Messages as the bytes on the wire (CDR), for those that come by the thousand.

rclpy takes 35 µs to send an Odometry and 55 µs to take one, most of it for covariances that
nobody looks at. As bytes it takes 5 each. They are: which encoding (4 bytes), the stamp (8),
text such as the frame, and at the end, for many types, numbers of which there are always as
many. So a message is one of its own kind with another stamp and other numbers.
"""

from __future__ import annotations

from functools import lru_cache
import struct
from typing import Any

import numpy as np
from numpy.typing import DTypeLike
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Empty

_ENCODING = serialize_message(Empty())[:4]
_STAMP = struct.Struct('=iI')
_HEAD = len(_ENCODING) + _STAMP.size
_SECOND = 1_000_000_000


class Template:
    """A message that is sent again and again, with another stamp and other numbers.

    `numbers` are those at its end, as a record of a type without gaps; set its fields.
    """

    def __init__(self, message: Any, numbers: DTypeLike) -> None:
        self._data = bytearray(serialize_message(message))
        offset = len(self._data) - np.dtype(numbers).itemsize
        self.numbers: Any = np.ndarray((), numbers, self._data, offset)

    def stamped(self, ns: int) -> bytes:
        """Return the message as it is now, with a stamp [ns]."""
        _STAMP.pack_into(self._data, len(_ENCODING), *divmod(ns, _SECOND))
        return bytes(self._data)


def decoded(data: bytes, message_type: Any) -> Any:
    """Return the message in the bytes; ValueError when there is none."""
    try:
        return deserialize_message(data, message_type)
    except RuntimeError as error:
        raise ValueError(f'no message of type {message_type.__name__}: {error}') from None


def read(data: bytes, message_type: Any, numbers: np.dtype[Any]) -> tuple[int, str, Any]:
    """Return stamp [ns], frame and the numbers at the end of a message with a header.

    Raises ValueError when the bytes are no message of this type.
    """
    if data[:4] != _ENCODING:
        data = serialize_message(decoded(data, message_type))
    end = len(data) - numbers.itemsize
    if end < _HEAD:
        raise ValueError(f'{len(data)} bytes are too few for a {message_type.__name__}')
    sec, nanosec = _STAMP.unpack_from(data, len(_ENCODING))
    frame = _frame(data[_HEAD:end], message_type, numbers.itemsize)
    return sec * _SECOND + nanosec, frame, np.ndarray((), numbers, data, end)


@lru_cache(maxsize=1000)
def _frame(text: bytes, message_type: Any, size: int) -> str:
    """Return the frame that a message with this text, and numbers of this size, is in."""
    data = _ENCODING + bytes(_STAMP.size) + text + bytes(size)
    message = decoded(data, message_type)
    if len(serialize_message(message)) != len(data):
        raise ValueError(f'a {message_type.__name__} has bytes at its end that belong to nothing')
    frame: str = message.header.frame_id
    return frame
