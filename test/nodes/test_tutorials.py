# SPDX-License-Identifier: Apache-2.0
"""The tutorials that need nodes: their files and their command lines, as the pages give them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import shlex
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Pose, PoseArray, Twist
from herding_ros.nodes.messages import sheep_in
import numpy as np
from page_code import blocks
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2


def nodes_of(page: str) -> dict[str, list[str]]:
    """Return the command lines of nodes on a page, by name."""
    lines = [line for block in blocks(page) for line in block.splitlines()]
    words = [shlex.split(line) for line in lines if ' --ros-args ' in line]
    return {name: rest for name, *rest in words}


def test_a_simulator_of_ones_own(tmp_path: Path, start: Callable[..., Any]) -> None:
    (program,) = blocks('tutorial_simulator.md', 'python')
    assert 'herding_ros' not in program
    path = tmp_path / 'meadow.py'
    path.write_text(program, encoding='utf-8')
    commands = nodes_of('tutorial_simulator.md')
    start('controller', *commands['controller'])
    meadow = start('meadow', program=path)
    assert meadow.wait() == 0, meadow.log
    assert meadow.log.startswith('0.10 m from the goal after ')


def test_robots_of_ones_own(
    tmp_path: Path, start: Callable[..., Any], peer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    (parameters,) = blocks('tutorial_robots.md', 'yaml')
    monkeypatch.chdir(tmp_path)
    Path('my_dogs.yaml').write_text(parameters, encoding='utf-8')
    said = peer.listen(DiagnosticArray, '/diagnostics')
    for name, arguments in nodes_of('tutorial_robots.md').items():
        start(name, *arguments)

    def doing() -> set[str]:
        statuses = [status for message in said for status in message.status]
        return {status.message for status in statuses if status.name == 'controller: state'}

    peer.spin_until(lambda: 'playing a plan' in doing())
    commands = peer.listen(Twist, '/robot_b/cmd_vel')
    peer.spin_until(lambda: any(command.linear.x for command in commands))


def test_a_goal_while_it_runs(tmp_path: Path, start: Callable[..., Any]) -> None:
    (program,) = blocks('running.md', 'python')
    path = tmp_path / 'goal.py'
    path.write_text(program, encoding='utf-8')
    start('sim', sheep=2, dogs=1)
    controller = start('controller', dogs=1)
    assert start('goal', program=path).wait() == 0
    controller.wait_for('the destination is now (1, 0.2)')


def test_a_tracker_of_ones_own(tmp_path: Path, start: Callable[..., Any], peer: Any) -> None:
    (program,) = blocks('tutorial_robots.md', 'python')
    path = tmp_path / 'tracker.py'
    path.write_text(program, encoding='utf-8')
    start('tracker', program=path)
    clouds = peer.listen(PointCloud2, 'sheep')
    poses = PoseArray(poses=[Pose(), Pose(), Pose()])
    poses.header.frame_id, poses.header.stamp.sec = 'field', 7
    places = np.array([[1.0, 2.0], [3.0, 4.0], [np.nan, np.nan]])  # the last one is out of sight
    for pose, (x, y) in zip(poses.poses, places, strict=True):
        pose.position.x, pose.position.y = x, y
    peer.talk_to(PoseArray, '/tracker/poses').publish(poses)
    peer.spin_until(lambda: clouds)
    sheep = sheep_in(serialize_message(clouds[0]), 'field', 10, needs_velocities=False)
    np.testing.assert_array_equal(sheep.x, places[:2])
