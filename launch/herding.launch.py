# SPDX-License-Identifier: Apache-2.0
"""Starts the simulated flock and its controller, and on request the recorder and RViz."""

from datetime import datetime

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import (
    EnvironmentVariable,
    LaunchConfiguration,
    PathJoinSubstitution,
    PythonExpression,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from herding_ros.control.lead import lead_at


def generate_launch_description() -> LaunchDescription:
    share = FindPackageShare('herding_ros')
    config = LaunchConfiguration('config')
    record = LaunchConfiguration('record')
    lockstep = ParameterValue(LaunchConfiguration('lockstep'), value_type=bool)
    # Nothing moves before the recorder, if there is one, listens to every topic.
    wait_for = ParameterValue(
        PythonExpression(["'recorder' if '", record, "' == 'true' else ''"]), value_type=str
    )

    arguments = [
        DeclareLaunchArgument(
            'config',
            default_value=PathJoinSubstitution([share, 'config', 'herding.yaml']),
            description='Parameter file of all nodes',
        ),
        DeclareLaunchArgument(
            'lockstep',
            default_value='false',
            choices=['true', 'false'],
            description='Let the simulation wait for every command instead of the clock',
        ),
        DeclareLaunchArgument(
            'real_time_factor',
            default_value='10.0',
            description='Simulated seconds per second, unless in lockstep',
        ),
        DeclareLaunchArgument(
            'record',
            default_value='false',
            choices=['true', 'false'],
            description='Record every topic into a bag',
        ),
        DeclareLaunchArgument(
            'bag',
            default_value=f'herding_{datetime.now():%Y_%m_%d-%H_%M_%S}',
            description='Folder of the bag, which must not exist',
        ),
        DeclareLaunchArgument(
            'rviz',
            default_value='false',
            choices=['true', 'false'],
            description='Show it in RViz; its goal tool moves the destination',
        ),
    ]

    def controller(context: LaunchContext) -> list[Node]:
        factor = float(LaunchConfiguration('real_time_factor').perform(context))
        return [
            Node(
                package='herding_ros',
                executable='controller',
                name='controller',
                output='screen',
                parameters=[
                    {'lead': lead_at(factor)},  # unless the parameter file has another
                    config,
                    {'lockstep': lockstep, 'wait_for': wait_for, 'use_sim_time': True},
                ],
            )
        ]

    nodes = [
        Node(
            package='herding_ros',
            executable='sim',
            name='sim',
            output='screen',
            parameters=[
                config,
                {
                    'lockstep': lockstep,
                    'real_time_factor': ParameterValue(
                        LaunchConfiguration('real_time_factor'), value_type=float
                    ),
                    'wait_for': wait_for,
                },
            ],
        ),
        OpaqueFunction(function=controller),
        Node(
            package='herding_ros',
            executable='recorder',
            name='recorder',
            output='screen',
            parameters=[
                config,
                {
                    'bag': ParameterValue(LaunchConfiguration('bag'), value_type=str),
                    'use_sim_time': True,
                },
            ],
            condition=IfCondition(record),
        ),
        Node(
            package='rviz2',
            executable='rviz2',
            name='rviz2',
            arguments=['-d', PathJoinSubstitution([share, 'rviz', 'herding.rviz'])],
            parameters=[{'use_sim_time': True}],
            condition=IfCondition(LaunchConfiguration('rviz')),
        ),
    ]
    # Traffic stays on this machine, unless the variable is set.
    network = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
    stay = SetEnvironmentVariable(network, EnvironmentVariable(network, default_value='LOCALHOST'))
    return LaunchDescription([stay, *arguments, *nodes])
