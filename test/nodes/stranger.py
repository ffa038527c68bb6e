# SPDX-License-Identifier: Apache-2.0
"""Somebody else's node, with the middleware as it comes; says when it has heard a plan."""

import rclpy
from trajectory_msgs.msg import MultiDOFJointTrajectory

rclpy.init()
node = rclpy.create_node('stranger')
node.create_subscription(
    MultiDOFJointTrajectory, 'plan', lambda _: print('heard a plan', flush=True), 1
)
rclpy.spin(node)
