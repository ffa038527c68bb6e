# SPDX-License-Identifier: Apache-2.0
"""How messages travel: not by shared memory, where who is killed takes others along."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
import signal
from typing import Any

import pytest
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


def test_nodes_have_no_lock_in_common(
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


def test_strangers_are_spoken_with_as_they_want_to_be(
    start: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By shared memory, if the middleware is left as it comes."""
    with monkeypatch.context() as without:
        without.delenv('FASTRTPS_DEFAULT_PROFILES_FILE')
        stranger = start('stranger', program=Path(__file__).with_name('stranger.py'))
    start('sim', sheep=3, dogs=1, real_time_factor=3.0)
    controller = start('controller', **CONTROLLER)
    stranger.wait_for('heard a plan')
    assert shared_ports(controller.process.pid) != set()


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
