# SPDX-License-Identifier: Apache-2.0
"""Parameters of nodes, of the crowd, and of the control, whose defaults presets give.

Apart from parameters.py because the crowd imports compiled kernels, which a recorder does not
need.
"""

from __future__ import annotations

import dataclasses

from rclpy.node import Node

from herding_ros.control.parameters import Control, CONTROLS
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.parameters import Parameters, quantity
from herding_ros.model.scenario import GOAL

from .parameters import declare


@dataclasses.dataclass(frozen=True)
class NodeSettings(Parameters):
    """What sim and controller have in common as ROS nodes."""

    goal: tuple[float, float] = quantity(GOAL, 'destination; goal_pose moves it', 'm')
    frame: str = quantity('map', 'frame of all positions')
    lockstep: bool = quantity(
        False,
        'the sim waits at each control period for the commands that reply to its state: '
        'the controller stamps them as the state is stamped',
    )
    stamped: bool = quantity(
        True,
        'commands are TwistStamped; false: Twist. Where all others on a topic take the other type '
        'at the start, it is that, but for lockstep',
    )
    wait_for: str = quantity(
        '',
        'node (a recorder) to wait for until it is subscribed: its name in the same namespace, '
        'or its full name',
    )

    def __post_init__(self) -> None:
        """Check what goes together."""
        super().__post_init__()
        if self.lockstep and not self.stamped:
            raise ValueError('lockstep needs stamped commands: stamped must be true, got false')


@dataclasses.dataclass(frozen=True)
class Preset(Parameters):
    """Where the crowd's defaults come from."""

    preset: str = quantity(
        'cohesive', 'where the defaults of crowd.* come from', choices=tuple(CROWDS)
    )


def declare_crowd(node: Node) -> Crowd:
    """Declare the crowd: `crowd.preset` gives the defaults of the other `crowd.` parameters."""
    preset = declare(node, Preset(), 'crowd.').preset
    return declare(node, CROWDS[preset], 'crowd.')


@dataclasses.dataclass(frozen=True)
class ControlPreset(Parameters):
    """Where the controller's defaults come from."""

    preset: str = quantity(
        'default',
        "where the method's defaults come from: paper is the paper's own setting",
        choices=tuple(CONTROLS),
    )


def declare_control(node: Node) -> Control:
    """Declare the method of the controller: `preset` gives the defaults of its parameters."""
    return declare(node, CONTROLS[declare(node, ControlPreset()).preset])
