# SPDX-License-Identifier: Apache-2.0
"""rosbag2 bags: writing one, and reading one back into arrays. No rclpy here."""
