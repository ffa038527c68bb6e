"""The points of a sensor_msgs/PointCloud2 as a NumPy array, by the message's field table."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FORMATS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
"""NumPy's formats by the constants of sensor_msgs/PointField."""


def points(cloud: Any) -> NDArray[np.void]:
    """Return the points (n,) of a cloud, a structured array with the cloud's own fields.

    The message may come from rclpy or from a bag. Raises ValueError when it contradicts
    itself: unknown types of fields, fields outside a point, fewer bytes than points.
    """
    order = '>' if cloud.is_bigendian else '<'
    fields = [field for field in cloud.fields if field.count == 1]
    unknown = [field.name for field in fields if field.datatype not in _FORMATS]
    if unknown:
        raise ValueError(f'fields {unknown} of the point cloud have no known type')
    rows = np.frombuffer(bytes(cloud.data), np.uint8)
    if cloud.width * cloud.point_step > cloud.row_step or len(rows) < (
        cloud.height * cloud.row_step
    ):
        raise ValueError(
            f'the point cloud has {len(rows)} bytes, too few for {cloud.height} rows of '
            f'{cloud.row_step} bytes with {cloud.width} points of {cloud.point_step} bytes'
        )
    dtype = np.dtype(
        {
            'names': [field.name for field in fields],
            'formats': [order + _FORMATS[field.datatype] for field in fields],
            'offsets': [field.offset for field in fields],
            'itemsize': cloud.point_step,
        }
    )
    rows = rows[: cloud.height * cloud.row_step].reshape(cloud.height, cloud.row_step)
    return np.ascontiguousarray(rows[:, : cloud.width * cloud.point_step]).view(dtype).ravel()
