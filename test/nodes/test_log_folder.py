# SPDX-License-Identifier: Apache-2.0
"""What a node needs of its environment before it starts."""

from __future__ import annotations

import os
from pathlib import Path
import tempfile

from herding_ros.nodes.middleware import find_log_folder
import pytest


@pytest.fixture(autouse=True)
def no_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    monkeypatch.setenv('ROS_LOG_DIR', '')
    monkeypatch.delenv('ROS_HOME', raising=False)


@pytest.mark.parametrize('home', ['/proc/nowhere', None])
def test_without_a_home_logs_go_to_a_temporary_folder(
    home: str | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if home is None:
        monkeypatch.delenv('HOME')
    else:
        monkeypatch.setenv('HOME', home)
    find_log_folder()
    assert Path(os.environ['ROS_LOG_DIR']).is_dir()
    assert 'set ROS_LOG_DIR' in capsys.readouterr().err


@pytest.mark.parametrize('variable', ['HOME', 'ROS_HOME'])
def test_a_home_that_can_be_written_is_left_to_ros(
    variable: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(variable, str(tmp_path))
    find_log_folder()
    assert not os.environ['ROS_LOG_DIR']
    folder = tmp_path / ('log' if variable == 'ROS_HOME' else '.ros/log')
    assert list(folder.iterdir()) == []
