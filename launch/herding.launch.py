# SPDX-License-Identifier: Apache-2.0
"""Starts the simulated flock and its controller, and on request the recorder and RViz."""

from herding_ros.nodes.launch_plan import herd_arguments, plan_herd
from herding_ros.nodes.launching import description
from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    return description(herd_arguments(), plan_herd)
