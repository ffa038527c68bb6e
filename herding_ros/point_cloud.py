# SPDX-License-Identifier: Apache-2.0
"""The points of a sensor_msgs/PointCloud2 as a NumPy array, by the message's field table."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

SHEEP = ('id', 'x', 'y', 'vx', 'vy')
"""The fields that are read of a cloud of sheep."""

_FORMATS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
"""NumPy's formats by the constants of sensor_msgs/PointField."""


def points(cloud: Any, names: tuple[str, ...] = SHEEP) -> NDArray[np.void]:
    """Return the points (n,) of a cloud: a structured array of those of the fields that it has.

    The message may come from rclpy or from a bag. Its other fields may be anything. A field's
    count of 0, the message's default, stands for 1, and a row_step of 0 for rows without padding.
    Raises ValueError when what is read contradicts itself: fields that are there twice, of
    several numbers, of unknown types or outside a point; more or fewer bytes than the rows.
    """
    fields = tuple(
        (f.name, f.offset, f.datatype, f.count) for f in cloud.fields if f.name in names
    )
    rows = np.frombuffer(cloud.data, np.uint8)
    used = cloud.width * cloud.point_step
    row_step = cloud.row_step or used
    if used > row_step or len(rows) != cloud.height * row_step:
        raise ValueError(
            f'the point cloud must have {cloud.height} rows of {row_step} bytes, each with '
            f'{cloud.width} points of {cloud.point_step} bytes, got {len(rows)} bytes in all'
        )
    dtype = _dtype(fields, cloud.point_step, '>' if cloud.is_bigendian else '<')
    rows = rows.reshape(cloud.height, row_step)[:, :used]
    return np.ascontiguousarray(rows).view(dtype).ravel()


@lru_cache(maxsize=16)
def _dtype(
    fields: tuple[tuple[str, int, int, int], ...], size: int, order: str
) -> np.dtype[np.void]:
    names = [name for name, *_ in fields]
    for name, offset, datatype, count in fields:
        what = f'field {name!r} of the point cloud'
        if names.count(name) > 1:
            raise ValueError(f'{what} must be there once, got it {names.count(name)} times')
        if count > 1:
            raise ValueError(f'{what} must be one number, got a count of {count}')
        if datatype not in _FORMATS:
            raise ValueError(f'{what} must have a datatype from 1 to 8, got {datatype}')
        # NumPy's own check overflows, and then it reads memory that is not the cloud's.
        if offset + np.dtype(_FORMATS[datatype]).itemsize > size:
            raise ValueError(f'{what} must be inside a point of {size} bytes, got offset {offset}')
    return np.dtype(
        {
            'names': names,
            'formats': [order + _FORMATS[datatype] for _, _, datatype, _ in fields],
            'offsets': [offset for _, offset, *_ in fields],
            'itemsize': size,
        }
    )
