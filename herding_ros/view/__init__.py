# SPDX-License-Identifier: Apache-2.0
"""A herd in the browser, live or from a bag. No rclpy here."""
