# SPDX-License-Identifier: Apache-2.0
"""Starts the controller and the recorder, and on request RViz, for dogs and sheep of your own."""

from herding_ros.nodes.launch_plan import plan_real_dogs, real_dogs_arguments
from herding_ros.nodes.launching import description
from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    return description(real_dogs_arguments(), plan_real_dogs)
