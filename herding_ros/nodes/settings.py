"""What sim and controller have in common: parameters of the node, and the crowd's.

Apart from parameters.py, since the crowd brings compiled kernels along, which a recorder does not
need.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

from rclpy.node import Node

from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.parameters import Parameters, quantity
from herding_ros.model.scenario import GOAL

from .parameters import declare

LIVE_NOISE = ('crowd.noise', 'crowd.common_noise', 'crowd.noise_field.')
"""What of the crowd may change while sim and controller run."""


@dataclasses.dataclass(frozen=True)
class NodeSettings(Parameters):
    """What sim and controller have in common as ROS nodes."""

    goal: tuple[float, float] = quantity(GOAL, 'destination; goal_pose moves it', 'm')
    frame: str = quantity('map', 'frame of all positions')
    lockstep: bool = quantity(
        False,
        'the sim waits at each control period for the commands that answer its state, '
        'which the controller stamps as the state is stamped',
    )
    stamped: bool = quantity(True, 'commands are TwistStamped; false: Twist')
    wait_for: str = quantity('', 'name of a node (a recorder) that must hear everything first')

    def __post_init__(self) -> None:
        """Check what goes together."""
        super().__post_init__()
        if self.lockstep and not self.stamped:
            raise ValueError('lockstep needs stamped commands: set stamped to true')


@dataclasses.dataclass(frozen=True)
class _Preset(Parameters):
    preset: str = quantity(
        'cohesive', 'where the defaults of crowd.* come from', choices=tuple(CROWDS)
    )


def declare_crowd(node: Node, live: Sequence[str] = ()) -> Crowd:
    """Declare the crowd: `crowd.preset` gives the defaults of the other `crowd.` parameters."""
    preset = declare(node, _Preset(), 'crowd.').preset
    return declare(node, CROWDS[preset], 'crowd.', live)
