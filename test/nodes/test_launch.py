# SPDX-License-Identifier: Apache-2.0
"""The launch file, where there is a ROS installation with launch."""

from __future__ import annotations

from pathlib import Path

import pytest

launch_ros = pytest.importorskip('launch_ros', reason='launch comes with an installed ROS only')


def test_launch_file_describes_our_nodes() -> None:
    from launch import LaunchContext
    from launch.launch_description_sources import get_launch_description_from_python_launch_file

    path = Path(__file__).parents[2] / 'launch' / 'herding.launch.py'
    description = get_launch_description_from_python_launch_file(str(path))
    assert isinstance(LaunchContext(), LaunchContext)
    arguments = {argument.name for argument in description.get_launch_arguments()}
    assert {'config', 'rviz', 'record', 'bag', 'real_time_factor', 'lockstep'} <= arguments
