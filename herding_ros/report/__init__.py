# SPDX-License-Identifier: Apache-2.0
"""Pictures and numbers from a recorded run. No rclpy here."""
