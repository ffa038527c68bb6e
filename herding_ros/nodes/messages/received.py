# SPDX-License-Identifier: Apache-2.0
"""Messages -> arrays, from their bytes.

What is in another frame is taken into ours where `frames` know the way. All raise Refused on
anything that must not move a dog; what is not read (a height, a covariance) may be anything, but
for commands.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from herding_ros.checks import check_finite, check_frame, check_goal, check_size, Refused
from herding_ros.model.state import Array
from herding_ros.nodes.occupancy import Grid
from herding_ros.nodes.wire import Reader
from herding_ros.point_cloud import points
import numpy as np
from numpy.typing import NDArray

from .frames import Frames, LATEST, Placement
from .stamps import dog_frame, level_yaw, turned, yaw

_ODOMETRY_NUMBERS = 7 + 36 + 6 + 36
"""Pose and twist, each with its covariance."""

_TO_VELOCITY = 7 + 36 + 2
"""Those up to the linear velocity along x and y."""

_COLUMNS = ('x', 'y', 'vx', 'vy')
"""What is read of a sheep besides its id."""

_LARGEST_SINGLE = 1e6
"""Single precision resolves 6 cm there [m]: farther out it would not see a sheep move."""

_MOST_CELLS = 10_000_000
"""Cells of a map; 500 m x 500 m in cells of 0.16 m."""

_FINEST, _COARSEST = 1e-3, 1e3
"""Sides of cells of a map [m]: others are mistakes in the unit."""

_OCCUPIED = 65
"""Least per cent at which a cell of a map is occupied, as in map_server."""

_LONGEST_OUTLINE = 100
"""Corners of an obstacle."""

_MOST_FIELDS = 64
"""Fields of a point cloud: each takes room and time, before the points are looked at."""


class Sheep(NamedTuple):
    """The flock at ns: ids (N,), increasing, positions x (N, 2) [m], velocities v [m/s].

    is_velocity_seen: (N,); where it is false v is 0.
    """

    ns: int
    ids: NDArray[np.uint32]
    x: Array
    v: Array
    is_velocity_seen: NDArray[np.bool_]


def sheep_in(
    data: bytes,
    frame: str,
    most: int,
    needs_velocities: bool = True,
    frames: Frames | None = None,
) -> Sheep:
    """Sheep in a PointCloud2, sorted by id; more than `most` are refused unseen.

    Fields x, y, vx, vy must be there as floats, in any order and with any others; vx and vy only
    if `needs_velocities`. An integer field id identifies the sheep; without it their order does.
    In a cloud that says that it is not dense, points that are not finite are sheep out of sight:
    they are left out. Where only the velocity is not finite, and need not be, it is not seen.
    """
    reader = Reader(data)
    ns, given = reader.header()
    place = _placement('sheep', given, frame, ns, frames)
    cloud = _point_cloud_in(reader, most)
    try:
        sheep = points(cloud)
    except ValueError as error:
        raise Refused('malformed', str(error)) from None
    names: tuple[str, ...] = _COLUMNS
    if not needs_velocities and not {'vx', 'vy'} & set(sheep.dtype.names or ()):
        names = _COLUMNS[:2]
    values: Array = np.full((len(sheep), 4), np.nan)
    with np.errstate(invalid='ignore'):  # converting some NaN warns on stderr
        for i, name in enumerate(names):
            values[:, i] = _column(sheep, name, 'f', 'FLOAT32 or FLOAT64')
    ids: NDArray[np.uint32] = np.arange(len(sheep), dtype=np.uint32)
    if 'id' in (sheep.dtype.names or ()):
        ids = _column(sheep, 'id', 'iu', 'integer').astype(np.uint32)
    is_finite = np.isfinite(values)
    if cloud.is_dense and not is_finite[:, : len(names)].all():
        raise Refused(
            'not finite',
            'sheep must be finite in a cloud with is_dense: true, got NaN or infinite values; '
            'with false it may have sheep out of sight',
        )
    in_sight = is_finite[:, : 4 if needs_velocities else 2].all(axis=1)
    if not in_sight.any():
        raise Refused('empty', 'at least one sheep must be in sight, got no finite point')
    is_velocity_seen: NDArray[np.bool_] = np.all(is_finite[:, 2:], axis=1)
    values[~is_velocity_seen, 2:] = 0.0
    if not in_sight.all():
        ids, values, is_velocity_seen = ids[in_sight], values[in_sight], is_velocity_seen[in_sight]
    check_size('sheep positions and velocities', float(values.min()), float(values.max()))
    _check_resolution(sheep.dtype, names, values)
    if place is not None:
        values = np.hstack([place.points(values[:, :2]), place.vectors(values[:, 2:])])
    if not (ids[1:] > ids[:-1]).all():
        order = np.argsort(ids)
        ids, values, is_velocity_seen = ids[order], values[order], is_velocity_seen[order]
        if (ids[1:] == ids[:-1]).any():
            raise Refused('duplicate ids', 'two sheep have the same id; each needs its own')
    return Sheep(ns, ids, values[:, :2], values[:, 2:], is_velocity_seen)


def _check_resolution(dtype: np.dtype[np.void], names: tuple[str, ...], values: Array) -> None:
    """Refuse numbers in single precision where that would not see a sheep move."""
    is_single = [i for i, name in enumerate(names) if dtype[name].itemsize == 4]
    size = float(np.abs(values[:, is_single]).max(initial=0.0))
    if size > _LARGEST_SINGLE:
        raise Refused(
            'too large',
            f'sheep in FLOAT32 must be at most {_LARGEST_SINGLE:g} [m, m/s], got {size:g}, '
            f'which it resolves to {np.spacing(np.float32(size)):g}; send FLOAT64',
        )


def _column(sheep: NDArray[np.void], name: str, kinds: str, allowed: str) -> NDArray[np.generic]:
    if name not in (sheep.dtype.names or ()):
        remedy = ', or sensor.position_noise be set' if name in _COLUMNS[2:] else ''
        raise Refused(
            'wrong fields', f'sheep must have a field {name} of type {allowed}{remedy}', name
        )
    if sheep.dtype[name].kind not in kinds:
        reason = f'field {name} must be of type {allowed}, got {sheep.dtype[name]}'
        raise Refused('wrong fields', reason, name)
    column: NDArray[np.generic] = sheep[name]
    return column


class _Field(NamedTuple):
    name: str
    offset: int
    datatype: int
    count: int  # type: ignore[assignment]


class _PointCloud(NamedTuple):
    height: int
    width: int
    fields: tuple[_Field, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: memoryview
    is_dense: bool


def _point_cloud_in(reader: Reader, most: int) -> _PointCloud:
    """Read what comes after the header of a PointCloud2 with one to `most` points."""
    height, width, field_count = reader.numbers('III')
    if width * height > most:
        raise Refused(
            'too many sheep', f'there must be at most {most} sheep, got {width * height}'
        )
    if not width * height:
        raise Refused('empty', 'sheep must be at least one point, got an empty cloud')
    if field_count > _MOST_FIELDS:
        raise Refused(
            'wrong fields', f'sheep must have at most {_MOST_FIELDS} fields, got {field_count}'
        )
    fields = tuple(_Field(reader.string(), *reader.numbers('IBxxxI')) for _ in range(field_count))
    is_bigendian, point_step, row_step = reader.numbers('?xxxII')
    points_data = reader.sequence()
    is_dense = reader.flag()
    reader.end_after('is_dense')
    return _PointCloud(
        height, width, fields, is_bigendian, point_step, row_step, points_data, is_dense
    )


def dog_in(
    data: bytes, frame: str, frames: Frames | None = None
) -> tuple[int, Array, float, Array]:
    """Time [ns], position (2,) [m], heading [rad] and velocity (2,) [m/s] in an Odometry.

    The velocity is turned from the dog's axes into those of the map; it may be anything, since
    not every motion model needs it.
    """
    reader = Reader(data)
    ns, given = reader.header()
    place = _placement('odometry', given, frame, ns, frames)
    reader.string()  # the child frame
    numbers = reader.doubles(_ODOMETRY_NUMBERS, _TO_VELOCITY)
    d_x, d_y, _, *rotation = numbers[:7]
    check_size('dog position and orientation', d_x, d_y, *rotation)
    position, heading = np.array([d_x, d_y]), yaw(*rotation)
    if place is not None:
        (position,), heading = place.points(position[None]), place.heading(heading)
    velocity = turned(np.array(numbers[-2:]), -heading)
    return ns, position, heading, np.array(velocity)


def command_in(
    data: bytes, m: int, frame: str, max_speed: float, ahead: float | None = None
) -> tuple[int, Array]:
    """Time [ns] and velocity (2,) [m/s], of at most max_speed, of a TwistStamped for dog m.

    It is in the body frame, and so far ahead [m] of a dog that has to turn; None: it need not.
    """
    reader = Reader(data)
    ns, given = reader.header()
    check_frame('command', given, dog_frame(m), frame)
    return ns, _velocity_in(reader, max_speed, ahead)


def twist_in(data: bytes, max_speed: float, ahead: float | None = None) -> Array:
    """Velocity (2,) [m/s], of at most max_speed [m/s], of a Twist; see `command_in`."""
    return _velocity_in(Reader(data), max_speed, ahead)


def _velocity_in(reader: Reader, max_speed: float, ahead: float | None) -> Array:
    """Read the linear and angular velocity at the end of a message.

    Of a dog that has to turn the linear x and the angular z count, of others the linear x and y.
    NaN in any of them refuses all: whatever sent it is out of order.
    """
    values = reader.doubles(6, 6)
    check_finite('command', *values)
    x, y = values[0], values[1] if ahead is None else ahead * values[5]
    if math.hypot(x, y) > max_speed * (1 + 1e-6):  # rounded, and turned into the dog's frame
        raise Refused(
            'too fast',
            f'it must be at most {max_speed:g} m/s'
            + (' at the point that is steered' if ahead is not None else '')
            + f', got {math.hypot(x, y):g} m/s',
        )
    return np.array([x, y])


def goal_in(data: bytes, frame: str, frames: Frames | None = None) -> Array:
    """Destination (2,) [m] in a PoseStamped."""
    reader = Reader(data)
    _, given = reader.header()
    x, y = reader.doubles(7, 2)
    if given == frame or frames is None:
        check_goal(given, x, y, frame)
        return np.array([x, y])
    check_goal(frame, x, y, frame)
    (goal,) = frames.placement('goal', given, LATEST).points(np.array([[x, y]]))
    return goal


def grid_in(data: bytes, frame: str, frames: Frames | None = None) -> Grid:
    """Map in an OccupancyGrid; cells of 65 per cent and more are occupied.

    Unknown cells (-1) are free: a map of a field seldom knows what is behind a fence.
    """
    reader = Reader(data)
    _, given = reader.header()
    place = _placement('map', given, frame, LATEST, frames)
    _, _, resolution, width, height = reader.numbers('iIfII')
    x, y, _, *rotation = reader.some_doubles(7)
    cells = np.frombuffer(reader.sequence(), np.int8)
    reader.end_after('data')
    if not width * height:
        raise Refused('empty', f'a map must have cells, got {width} x {height}')
    if width * height > _MOST_CELLS:
        raise Refused(
            'too large',
            f'a map must have at most {_MOST_CELLS} cells, got {width} x {height}; make it '
            'coarser',
        )
    if len(cells) != width * height:
        raise Refused(
            'malformed',
            f'a map must have as many cells as width x height, {width} x {height}, '
            f'got {len(cells)}',
        )
    check_size('size and place of a map', resolution * max(width, height), x, y, *rotation)
    if not _FINEST <= resolution <= _COARSEST:
        raise Refused(
            'not allowed',
            f'cells of a map must be {_FINEST:g} to {_COARSEST:g} m wide, got {resolution:g} m',
        )
    least, most = int(cells.min()), int(cells.max())
    if least < -1 or most > 100:
        raise Refused(
            'not allowed', f'cells of a map must be from -1 to 100, got {least} to {most}'
        )
    turn = level_yaw('a map', *rotation)
    if place is not None:
        ((x, y),), turn = place.points(np.array([[x, y]])).tolist(), place.heading(turn)
    return Grid(cells.reshape(height, width) >= _OCCUPIED, resolution, x, y, turn)


def outline_in(
    data: bytes, frame: str, frames: Frames | None = None
) -> tuple[tuple[float, float], ...]:
    """Corners [m] of the obstacle in a PolygonStamped; none if there are none."""
    reader = Reader(data)
    _, given = reader.header()
    place = _placement('obstacle', given, frame, LATEST, frames)
    (count,) = reader.numbers('I')
    if count > _LONGEST_OUTLINE:
        raise Refused(
            'too large', f'an obstacle must have at most {_LONGEST_OUTLINE} corners, got {count}'
        )
    numbers = reader.numbers(f'{3 * count}f') if count else ()
    reader.end_after('the points')
    corners = tuple(zip(numbers[::3], numbers[1::3], strict=True))
    check_size('corners of an obstacle', *numbers[::3], *numbers[1::3])
    size = max(map(abs, (*numbers[::3], *numbers[1::3])), default=0.0)
    if size > _LARGEST_SINGLE:
        raise Refused(
            'too large',
            f'corners of an obstacle must be at most {_LARGEST_SINGLE:g} m, got {size:g}: they '
            'come in single precision',
        )
    if place is not None and corners:
        corners = tuple((x, y) for x, y in place.points(np.array(corners)).tolist())
    return corners


def _placement(
    what: str, given: str, frame: str, ns: int, frames: Frames | None
) -> Placement | None:
    """Return where a message's frame lies in ours at a time [ns]; None if it is ours."""
    if given == frame or frames is None:
        check_frame(what, given, frame)
        return None
    return frames.placement(what, given, ns)
