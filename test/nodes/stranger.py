# SPDX-License-Identifier: Apache-2.0
"""Somebody else's node, with the middleware as it comes; says when sim and it hear each other."""

import rclpy
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool

rclpy.init()
node = rclpy.create_node('stranger')
node.create_subscription(PointCloud2, 'sheep', lambda _: print('heard the sim', flush=True), 1)
client = node.create_client(SetBool, 'sim/pause')
client.wait_for_service()
rclpy.spin_until_future_complete(node, client.call_async(SetBool.Request(data=False)))
print('was answered', flush=True)
rclpy.spin(node)
