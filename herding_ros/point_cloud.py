# SPDX-License-Identifier: Apache-2.0
"""The points of a sensor_msgs/PointCloud2 as a NumPy array, by the message's field table."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

_FORMATS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
"""NumPy's formats by the constants of sensor_msgs/PointField."""


def points(cloud: Any) -> NDArray[np.void]:
    """Return the points (n,) of a cloud, a structured array with the cloud's own fields.

    The message may come from rclpy or from a bag. Raises ValueError when it contradicts
    itself: unknown types of fields, fields outside a point, more or fewer bytes than its rows.
    """
    fields = tuple((f.name, f.offset, f.datatype) for f in cloud.fields if f.count == 1)
    unknown = [name for name, _, datatype in fields if datatype not in _FORMATS]
    if unknown:
        raise ValueError(f'fields {unknown} of the point cloud have no known type')
    rows = np.frombuffer(cloud.data, np.uint8)
    used, size = cloud.width * cloud.point_step, cloud.height * cloud.row_step
    if used > cloud.row_step or len(rows) != size:
        raise ValueError(
            f'the point cloud has {len(rows)} bytes, too {"many" if len(rows) > size else "few"} '
            f'for {cloud.height} rows of {cloud.row_step} bytes with {cloud.width} points of '
            f'{cloud.point_step} bytes'
        )
    dtype = _dtype(fields, cloud.point_step, '>' if cloud.is_bigendian else '<')
    rows = rows.reshape(cloud.height, cloud.row_step)[:, :used]
    return np.ascontiguousarray(rows).view(dtype).ravel()


@lru_cache(maxsize=16)
def _dtype(fields: tuple[tuple[str, int, int], ...], size: int, order: str) -> np.dtype[np.void]:
    formats = [order + _FORMATS[datatype] for _, _, datatype in fields]
    offsets = [offset for _, offset, _ in fields]
    # NumPy's own check overflows, and then it reads memory that is not the cloud's.
    for (name, offset, _), form in zip(fields, formats, strict=True):
        if offset + np.dtype(form).itemsize > size:
            raise ValueError(
                f'field {name!r} of the point cloud, at {offset} bytes, is outside a point, '
                f'which has {size}'
            )
    names = [name for name, _, _ in fields]
    return np.dtype({'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': size})
