# SPDX-License-Identifier: Apache-2.0
"""Messages <-> arrays: the only place that depends on what a message looks like. SI units."""

from herding_ros.checks import check_frame, check_stamp

from .diagnostics import diagnostics
from .frames import Frames, LATEST, NoTransformError, Placement
from .received import (
    command_in,
    dog_in,
    goal_in,
    grid_in,
    outline_in,
    Sheep,
    sheep_in,
    twist_in,
)
from .routes import path_in, plan_in
from .sent import cloud, command, odometry, trajectory, twist
from .stamps import dog_frame, nanoseconds, stamp_of, turned
from .visualisation import drawing, marker_array, path, pose

__all__ = [
    'LATEST',
    'Frames',
    'NoTransformError',
    'Placement',
    'Sheep',
    'check_frame',
    'check_stamp',
    'cloud',
    'command',
    'command_in',
    'diagnostics',
    'dog_frame',
    'dog_in',
    'drawing',
    'goal_in',
    'grid_in',
    'marker_array',
    'nanoseconds',
    'odometry',
    'outline_in',
    'path',
    'path_in',
    'plan_in',
    'pose',
    'sheep_in',
    'stamp_of',
    'trajectory',
    'turned',
    'twist',
    'twist_in',
]
