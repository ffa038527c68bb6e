# SPDX-License-Identifier: Apache-2.0
"""Figures, tables and statistics; the report on a recorded run. No rclpy here."""
