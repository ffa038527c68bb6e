# SPDX-License-Identifier: Apache-2.0
"""What the launch files have in common; needs launch and launch_ros."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ProcessExited, ShutdownProcess
from launch.launch_context import LaunchContext
from launch.launch_description import LaunchDescription
from launch.substitutions import EnvironmentVariable
from launch_ros.actions import Node

from .launch_plan import Argument, LaunchPlan, names_in_namespace

_NETWORK = 'ROS_AUTOMATIC_DISCOVERY_RANGE'

_PATIENCE = '20'
"""Time that a node gets to end by itself [s]."""


def description(
    arguments: tuple[Argument, ...], plan: Callable[[Mapping[str, str]], LaunchPlan]
) -> LaunchDescription:
    """Return the description of what `plan` makes of the arguments.

    As soon as one of our nodes ends, all end, one after the other, the recorder last.
    """

    def start(context: LaunchContext) -> list[Any]:
        given = context.launch_configurations
        return _actions(plan({argument.name: given[argument.name] for argument in arguments}))

    return LaunchDescription(
        [
            # Traffic stays on this machine, unless the variable is set.
            SetEnvironmentVariable(
                _NETWORK, EnvironmentVariable(_NETWORK, default_value='LOCALHOST')
            ),
            *(
                DeclareLaunchArgument(
                    argument.name,
                    default_value=argument.default,
                    description=argument.description,
                )
                for argument in arguments
            ),
            OpaqueFunction(function=start),
        ]
    )


def _actions(plan: LaunchPlan) -> list[Any]:
    nodes = [
        Node(
            package='herding_ros',
            executable=name,
            name=name,
            namespace=plan.namespace,
            output='screen',
            parameters=[str(plan.config), dict(plan.values)],
            remappings=[('/clock', 'clock')],
            ros_arguments=['--log-level', plan.log_level],
            sigterm_timeout=_PATIENCE,
        )
        for name in plan.nodes
    ]
    actions: list[Any] = [*nodes, *_end_together(nodes)]
    if plan.rviz:
        file = Path(get_package_share_directory('herding_ros')) / 'rviz' / 'herding.rviz'
        actions.append(
            Node(
                package='rviz2',
                executable='rviz2',
                name='rviz2',
                namespace=plan.namespace,
                arguments=['-d', str(file)],
                parameters=[{'use_sim_time': plan.values['use_sim_time']}],
                remappings=names_in_namespace(file),
            )
        )
    return actions


def _end_together(nodes: list[Node]) -> list[RegisterEventHandler]:
    """Return what ends the next node when one has ended, and the launch after the last.

    The exit code of the launch is 1 if that of a node is not 0.
    """
    alive, failed = list(nodes), []

    def end_next(event: ProcessExited, context: LaunchContext) -> EmitEvent | Shutdown:
        alive.remove(event.action)
        if event.returncode:
            failed.append(f'{event.process_name} with exit code {event.returncode}')
        if not alive:
            if failed and not context.is_shutdown:
                raise RuntimeError(f'all nodes have ended, {", ".join(failed)}')
            return Shutdown(reason='all nodes have ended')
        return EmitEvent(event=ShutdownProcess(process_matcher=matches_action(alive[0])))

    return [
        RegisterEventHandler(OnProcessExit(target_action=node, on_exit=end_next)) for node in nodes
    ]
