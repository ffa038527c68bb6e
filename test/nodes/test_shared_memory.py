"""What ended and killed nodes leave in /dev/shm, with the real Fast DDS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import os
from pathlib import Path
import signal
import time
from typing import Any

import pytest
from trajectory_msgs.msg import MultiDOFJointTrajectory

from herding_ros.nodes.shared_memory import remove_half_made_ports

FOLDER = Path('/dev/shm')
HALF_MADE = bytes(52_400)
MADE = (2).to_bytes(4, 'little') + HALF_MADE[4:]


def ports(domain: int) -> list[Path]:
    """The files of the first ports of a domain, numbered as DDSI-RTPS says."""
    return [FOLDER / f'fastrtps_port{7400 + 250 * domain + k}' for k in range(30)]


def age(file: Path) -> None:
    long_ago = time.time() - 60.0
    os.utime(file, (long_ago, long_ago))


@pytest.fixture
def half_made(domain: int) -> Iterator[list[Path]]:
    files = [file for file in ports(domain) if not file.exists()]
    for file in files:
        file.write_bytes(HALF_MADE)
        age(file)
    yield files
    for file in files:
        file.unlink(missing_ok=True)


def test_half_made_ports_stop_nobody(half_made: list[Path], start: Callable[..., Any]) -> None:
    """Without care this hangs before the first word of the node."""
    assert half_made
    process = start('sim', sheep=3, dogs=1)
    process.wait_for('herding 3 sheep')
    assert process.end() == 0


def test_ports_are_what_we_take_for_made(domain: int, start: Callable[..., Any]) -> None:
    process = start('sim', sheep=3, dogs=1)
    process.wait_for('herding 3 sheep')
    used = [file for file in ports(domain) if file.exists()]
    assert used
    for file in used:
        age(file)
    remove_half_made_ports()
    assert [file for file in ports(domain) if file.exists()] == used
    assert process.end() == 0


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGKILL])
def test_who_comes_after_another_hears_all(
    number: int, start: Callable[..., Any], peer: Any
) -> None:
    """The next node gets the ports of the one that has gone, which the sim still knows."""
    start('sim', sheep=3, dogs=1, real_time_factor=10.0).wait_for('herding 3 sheep')
    plans = peer.listen(MultiDOFJointTrajectory, '/plan')
    for _ in range(3):
        plans.clear()
        controller = start('controller', dogs=1, use_sim_time=True)
        peer.spin_until(lambda: len(plans) > 1)
        controller.end(number)


def test_only_what_is_half_made_goes(tmp_path: Path) -> None:
    files = {
        'fastrtps_port8000': HALF_MADE,
        'fastrtps_port8001': b'',
        'fastrtps_port8002': (1).to_bytes(4, 'little') + HALF_MADE[4:],
        'fastrtps_port8003': MADE,
        'fastrtps_port8004': HALF_MADE,  # is young
        'fastrtps_port8000_el': b'',
        'fastrtps_portal': b'',
        'fastrtps_a0b1': HALF_MADE,
        'other': b'',
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        if name != 'fastrtps_port8004':
            age(tmp_path / name)
    remove_half_made_ports(tmp_path)
    gone = {'fastrtps_port8000', 'fastrtps_port8001', 'fastrtps_port8002'}
    assert {file.name for file in tmp_path.iterdir()} == set(files) - gone
    remove_half_made_ports(tmp_path / 'nowhere')
