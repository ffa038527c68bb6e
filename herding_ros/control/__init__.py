# SPDX-License-Identifier: Apache-2.0
"""What decides: optimal control, space mapping and the receding horizon (no ROS)."""
