# SPDX-License-Identifier: Apache-2.0
"""Publishes 0, 1, 2, ... as texts on /numbers, a thousand times a second, until it is told to end.

usage: counter.py TIMES BALLAST

Into the file TIMES goes when each was on its way, as a double [s]. BALLAST is a number of bytes
that each text has besides. It has a process of its own so that it keeps its pace, and starts as
the nodes do, so that a message that got lost on its way is sent again soon.
"""

import os
import struct
import sys
import time

from herding_ros.nodes.middleware import start_ros
import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String

PERIOD = 0.001


def main() -> None:
    times, ballast = os.open(sys.argv[1], os.O_WRONLY | os.O_CREAT), ' ' * int(sys.argv[2])
    start_ros()
    node = rclpy.create_node('counter', start_parameter_services=False)
    publisher = node.create_publisher(String, '/numbers', QoSProfile(depth=1000))
    begin = time.monotonic()
    k = 0
    while True:
        time.sleep(max(0.0, begin + PERIOD * k - time.monotonic()))
        publisher.publish(String(data=f'{k} {ballast}'))
        os.write(times, struct.pack('<d', time.monotonic()))
        k += 1


if __name__ == '__main__':
    main()
