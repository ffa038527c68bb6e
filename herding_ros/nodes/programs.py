# SPDX-License-Identifier: Apache-2.0
"""The programs sim, controller and recorder: help at once; the node is loaded to run it."""

from __future__ import annotations

import gc
from importlib import import_module

from herding_ros.control.parameters import Control
from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import World

from . import command_line
from .settings import ControllerSettings, RecorderSettings, SimSettings


def sim(args: list[str] | None = None) -> int:
    """Run the sim, or print help; returns the exit code."""
    groups = [('', SimSettings()), ('', World()), ('crowd.', Crowd())]
    names = (
        'sheep', 'dogs', 'seed', 'goal', 'crowd.noise', 'position_noise', 'velocity_noise',
        'max_speed', 'lockstep', 'real_time_factor', 'stop_on_arrival', 'time_limit',
    )  # fmt: skip
    command_line.read(
        'sim',
        'Moves the herd, and publishes what sensors would observe of it.',
        'publishes: sheep, dog_<i>/odom, truth/sheep, truth/dog_<i>/odom, /clock, markers, '
        '/diagnostics\nsubscribes to: dog_<i>/cmd_vel, goal_pose\nservices: ~/reset, ~/pause',
        command_line.rows(groups, names),
        'sim --ros-args -p sheep:=20 -p dogs:=3 -p real_time_factor:=10.0',
        args,
    )
    return _run('sim', args)


def controller(args: list[str] | None = None) -> int:
    """Run the controller, or print help; returns the exit code."""
    groups = [('', ControllerSettings()), ('', Control()), ('crowd.', Crowd())]
    names = (
        'dogs', 'goal', 'seed', 'crowd.noise', 'max_speed', 'horizon.length', 'horizon.accepted',
        'lockstep', 'lead', 'state_timeout', 'mapping.paths', 'stamped',
    )  # fmt: skip
    command_line.read(
        'controller',
        'Herds by space-mapping receding-horizon control: commands for the dogs from '
        'observations of sheep and dogs.',
        'publishes: dog_<i>/cmd_vel, plan, herd/path, dog_<i>/path, /diagnostics\n'
        'subscribes to: sheep, dog_<i>/odom, goal_pose',
        command_line.rows(groups, names),
        'controller --ros-args -p dogs:=3 -p use_sim_time:=true -p lead:=5.0',
        args,
    )
    return _run('controller', args)


def recorder(args: list[str] | None = None) -> int:
    """Run the recorder, or print help; returns the exit code."""
    settings = RecorderSettings()
    command_line.read(
        'recorder',
        'Records every topic, as it is on the wire, into a rosbag2 bag (mcap).',
        'publishes: /diagnostics\nsubscribes to: all topics\nservices: ~/pause, ~/resume',
        command_line.rows([('', settings)], settings.flat()),
        'recorder --ros-args -p bag:=my_bag -p use_sim_time:=true',
        args,
    )
    return _run('recorder', args)


def _run(name: str, args: list[str] | None) -> int:
    gc.disable()  # what is loaded stays: to look for garbage in it takes a tenth of the start
    main = import_module(f'.{name}', __package__).main
    gc.enable()
    return int(main(args))
