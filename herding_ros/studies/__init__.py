# SPDX-License-Identifier: Apache-2.0
"""The paper's tables and figures, and what goes beyond them: `study --help` (no ROS)."""
