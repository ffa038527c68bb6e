"""What killed nodes leave in /dev/shm, with the real Fast DDS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import os
from pathlib import Path
import time
from typing import Any

import pytest

from herding_ros.nodes.shared_memory import remove_what_nobody_uses

FOLDER = Path('/dev/shm')


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
        file.write_bytes(bytes(52_400))
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


def test_what_is_used_stays(domain: int, start: Callable[..., Any]) -> None:
    process = start('sim', sheep=3, dogs=1)
    process.wait_for('herding 3 sheep')
    used = [file for file in ports(domain) if file.exists()]
    assert used
    for file in used:
        age(file)
    remove_what_nobody_uses()
    assert [file for file in ports(domain) if file.exists()] == used
    assert process.end() == 0


def test_what_is_no_port_stays(tmp_path: Path) -> None:
    kept = ['fastrtps_portal', 'fastrtps_port1x', 'sem.other', 'psm_12', 'fastrtps_port8000_el']
    gone = ['fastrtps_port8001', 'fastrtps_port8001_el', 'sem.fastrtps_port8001_mutex']
    for name in (*kept, *gone, 'fastrtps_port8002'):
        (tmp_path / name).touch()
        age(tmp_path / name)
    (tmp_path / 'fastrtps_port8002').touch()  # is young
    remove_what_nobody_uses(tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted([*kept, 'fastrtps_port8002'])
