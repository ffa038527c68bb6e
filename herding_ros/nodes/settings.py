# SPDX-License-Identifier: Apache-2.0
"""What the nodes have for parameters besides those of crowd, control and world. No ROS."""

from __future__ import annotations

import dataclasses

from herding_ros.control.lead import FASTEST, SLOWEST
from herding_ros.control.parameters import CONTROLS, Timing
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.motion import MotionModel, MOTIONS
from herding_ros.model.parameters import Parameters, quantity, TINY
from herding_ros.model.scenario import GOAL, MOST_DOGS


@dataclasses.dataclass(frozen=True)
class NodeSettings(Parameters):
    """What sim and controller have in common as ROS nodes."""

    goal: tuple[float, float] = quantity(
        GOAL, 'destination, unless the field has one; goal_pose moves it', 'm'
    )
    field: str = quantity(
        '',
        'fences, obstacles and pens: a file, or the name of a field of the package; empty: none',
    )
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
        'node (a recorder of all topics) to wait for until it is subscribed: its name in the same '
        'namespace, or its full name',
    )

    def __post_init__(self) -> None:
        """Check what goes together."""
        super().__post_init__()
        if self.lockstep and not self.stamped:
            raise ValueError('lockstep needs stamped commands: stamped must be true, got false')


@dataclasses.dataclass(frozen=True)
class SimSettings(NodeSettings):
    """How the sim behaves as a ROS node."""

    real_time_factor: float = quantity(
        1.0,
        'simulated seconds per second when not in lockstep',
        low=SLOWEST,
        high=FASTEST,
        live=True,
    )
    start_from: str = quantity(
        '',
        'CSV file or bag with the positions from which sheep and dogs start; empty: those of '
        'start.*',
    )
    start_at: float = quantity(
        0.0, 'the instant in that file, from its first one on', 's', low=0.0
    )
    command_timeout: float = quantity(
        0.5, 'a dog stops when its last command is older than this', 's', low=TINY
    )
    stop_on_arrival: bool = quantity(False, 'stand still once the flock is home and together')
    time_limit: float = quantity(0.0, 'stand still after this time; 0: never', 's', low=0.0)
    end_when_finished: bool = quantity(False, 'end the node instead of standing still')


@dataclasses.dataclass(frozen=True)
class ControllerSettings(NodeSettings, Timing):
    """How the controller behaves as a ROS node."""

    dogs: int = quantity(5, 'number of dogs', low=1, high=MOST_DOGS)
    most_sheep: int = quantity(
        100_000, 'a message with more sheep than this is refused', low=1, high=1_000_000
    )
    seed: int = quantity(0, 'seed of the Monte Carlo paths', low=0)
    needs_map: bool = quantity(
        False, 'do nothing before there is a map on the topic map, whose walls are kept clear of'
    )
    excite: bool = quantity(
        False,
        'herd nowhere: dogs run to and fro through the flock, so that fit can tell from a '
        'recording how sheep respond; in lockstep only',
    )

    def __post_init__(self) -> None:
        """Check what goes together."""
        super().__post_init__()
        if self.excite and not self.lockstep:
            raise ValueError('excite needs a sim in lockstep: lockstep must be true, got false')


@dataclasses.dataclass(frozen=True)
class RecorderSettings(Parameters):
    """What the recorder writes where."""

    bag: str = quantity(
        'bag_<time>', 'folder of the bag, created at start; it must not exist. ~ is your home'
    )
    topics: tuple[str, ...] = quantity(
        ('',),
        'full names of the topics to record; none, or an empty one: all of the '
        "node's namespace, and what ROS shares between namespaces",
    )
    max_bag_size: int = quantity(
        0, 'size after which the bag goes on in another file; 0: never', 'byte', low=0
    )
    max_bag_duration: int = quantity(
        0, 'time after which the bag goes on in another file; 0: never', 's', low=0
    )


@dataclasses.dataclass(frozen=True)
class ViewSettings(Parameters):
    """Where the view serves its page."""

    host: str = quantity(
        '127.0.0.1',
        'address of the page: that of this machine alone, or 0.0.0.0 for everybody in its '
        'networks, who may then do what the page can',
    )
    port: int = quantity(
        8080, 'port of the page; the next that is free if it is not', low=1, high=65535
    )
    frame: str = quantity('map', 'frame of all positions')
    browser: bool = quantity(True, 'open the page in a browser, where there is a screen')


@dataclasses.dataclass(frozen=True)
class CrowdPreset(Parameters):
    """Where the crowd's defaults come from."""

    preset: str = quantity(
        'cohesive', 'where the defaults of crowd.* come from', choices=tuple(CROWDS)
    )
    length: float = quantity(
        1.0, "so many times as long are the crowd's lengths as those of the preset", low=TINY
    )
    time: float = quantity(
        1.0, "so many times as long are the crowd's times as those of the preset", low=TINY
    )

    @property
    def crowd(self) -> Crowd:
        """The crowd whose values are the defaults."""
        return CROWDS[self.preset].rescaled(self.length, self.time)


@dataclasses.dataclass(frozen=True)
class MotionKind(Parameters):
    """Which motion dogs have; its own parameters are declared with it."""

    kind: str = quantity(
        'holonomic',
        'how dogs move: with the velocity that is commanded at once (holonomic); within what '
        'motion.acceleration allows (accelerating); or ahead and back, and where else only after '
        'turning (unicycle)',
        choices=tuple(MOTIONS),
    )

    @property
    def motion(self) -> MotionModel:
        """The motion with its default values."""
        return MOTIONS[self.kind]


@dataclasses.dataclass(frozen=True)
class ControlPreset(Parameters):
    """Where the controller's defaults come from."""

    preset: str = quantity(
        'default',
        "where the method's defaults come from: paper is the paper's own setting",
        choices=tuple(CONTROLS),
    )
