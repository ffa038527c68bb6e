# SPDX-License-Identifier: Apache-2.0
"""How messages travel: by UDP within this machine, and not by shared memory.

There a node that is killed can stop others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import os
from pathlib import Path
import signal
from typing import Any
from xml.etree import ElementTree

from herding_ros.nodes import middleware
from herding_ros.nodes.middleware import start_ros
import psutil
import pytest
from rclpy.context import Context
from trajectory_msgs.msg import MultiDOFJointTrajectory

FOLDER = Path('/dev/shm')
HALF_MADE = bytes(52_400)
CONTROLLER = {
    'dogs': 1, 'use_sim_time': True, 'horizon__length': 4.0, 'horizon__accepted': 2.0,
    'lead': 1.5, 'mapping__paths': 20,
}  # fmt: skip


def shared_ports(pid: int) -> set[str]:
    """The files by which a process talks with others in shared memory."""
    maps = Path(f'/proc/{pid}/maps').read_text().splitlines()
    return {line.split()[-1] for line in maps if '/fastrtps_port' in line}


def udp_addresses(pid: int) -> set[str]:
    """The addresses at which a process takes packets."""
    return {socket.laddr.ip for socket in psutil.Process(pid).net_connections('udp')}


def test_nodes_have_no_lock_in_common_and_no_door_to_other_machines(
    start: Callable[..., Any], wait_until: Callable[..., None], tmp_path: Path
) -> None:
    """Who is killed while holding the lock of a port stops all that send to it for 1 s."""
    recorder = start('recorder', bag=tmp_path / 'bag', topics='["/plan"]')
    sim = start('sim', sheep=3, dogs=1, real_time_factor=3.0)
    controller = start('controller', **CONTROLLER)
    recorder.wait_for('recording into')
    bag = tmp_path / 'bag' / 'bag_0.mcap'
    wait_until(lambda: b'dog_1' in bag.read_bytes())  # all have heard each other
    for node in (sim, controller, recorder):
        assert shared_ports(node.process.pid) == set()
        assert udp_addresses(node.process.pid) == {'127.0.0.1'}


def test_nodes_with_other_settings_are_spoken_with(
    start: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both ways, and by UDP even if they offer shared memory, as Fast DDS does by default."""
    with monkeypatch.context() as theirs:
        theirs.delenv('FASTRTPS_DEFAULT_PROFILES_FILE', raising=False)
        stranger = start('stranger', program=Path(__file__).with_name('stranger.py'))
    sim = start('sim', sheep=3, dogs=1)
    stranger.wait_for('heard the sim')
    stranger.wait_for('was answered')
    assert shared_ports(sim.process.pid) == set()


def test_both_settings_agree_in_all_but_the_network() -> None:
    """Announcements of nodes and heartbeats of publishers are the same in both files."""
    settings = Path(middleware.__file__).parent
    files = [ElementTree.parse(settings / f'fastdds{name}.xml') for name in ('', '_localhost')]
    for shared in ('discovery_config', 'data_writer', 'data_reader'):
        found = [file.iterfind(f'.//{{*}}{shared}//*') for file in files]
        written = [[(each.tag, (each.text or '').strip()) for each in one] for one in found]
        assert written[0] == written[1] != []


@pytest.fixture
def messages_of_start(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Return a function that starts ROS in another environment and returns what it logs."""

    def start(**environment: str) -> str:
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        monkeypatch.chdir(tmp_path)
        before = dict(os.environ)
        context = Context()
        start_ros([], context=context)
        context.shutdown()
        changed = {name for name, value in before.items() if os.environ.get(name) != value}
        assert changed <= {'FASTRTPS_DEFAULT_PROFILES_FILE'}  # children decide for themselves
        return capfd.readouterr().err

    return start


def test_settings_of_the_user_that_replace_the_wall_are_reported(
    messages_of_start: Callable[..., str], tmp_path: Path
) -> None:
    assert messages_of_start() == ''
    assert os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'].endswith('fastdds_localhost.xml')
    assert 'ROS_STATIC_PEERS is ignored' in messages_of_start(ROS_STATIC_PEERS='10.9.9.1')
    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').write_text('<dds/>')  # Fast DDS reads it, too
    assert 'DEFAULT_FASTRTPS_PROFILES.xml replace ours' in messages_of_start()
    assert 'ours' not in messages_of_start(SKIP_DEFAULT_XML_FILE='1')
    their = str(tmp_path / 'mine.xml')
    assert f'{their} replace ours' in messages_of_start(FASTRTPS_DEFAULT_PROFILES_FILE=their)
    assert messages_of_start(ROS_AUTOMATIC_DISCOVERY_RANGE='SUBNET') == ''
    assert os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] == their


@pytest.fixture
def half_made(domain: int) -> Iterator[list[Path]]:
    """Ports that were killed while they were made, numbered as DDSI-RTPS says."""
    files = [FOLDER / f'fastrtps_port{7400 + 250 * domain + k}' for k in range(30)]
    files = [file for file in files if not file.exists()]
    for file in files:
        file.write_bytes(HALF_MADE)
    yield files
    for file in files:
        file.unlink(missing_ok=True)


def test_half_made_ports_stop_nobody(half_made: list[Path], start: Callable[..., Any]) -> None:
    """A node that opens one waits for it to be finished, for ever."""
    assert half_made
    process = start('sim', sheep=3, dogs=1)
    process.wait_for('herding 3 sheep')
    assert process.end() == 0


def test_who_comes_after_another_hears_all(start: Callable[..., Any], peer: Any) -> None:
    """The next node gets the ports of the one that has gone, which the sim still knows."""
    start('sim', sheep=3, dogs=1, real_time_factor=3.0).wait_for('herding 3 sheep')
    plans = peer.listen(MultiDOFJointTrajectory, '/plan')
    for _ in range(2):
        plans.clear()
        controller = start('controller', **CONTROLLER)
        peer.spin_until(lambda: len(plans) > 1)
        controller.end(signal.SIGKILL)
