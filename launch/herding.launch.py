# SPDX-License-Identifier: Apache-2.0
"""Starts the simulated flock and its controller, and on request the recorder and RViz."""

from launch import LaunchDescription

from herding_ros.nodes.launch_plan import herd_arguments, plan_herd
from herding_ros.nodes.launching import description


def generate_launch_description() -> LaunchDescription:
    return description(herd_arguments(), plan_herd)
