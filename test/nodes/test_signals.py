# SPDX-License-Identifier: Apache-2.0
"""Sim and controller end within two seconds of a signal, whatever they are at."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool

SMALL: dict[str, dict[str, Any]] = {'sim': {'sheep': 3, 'dogs': 1}, 'controller': {'dogs': 1}}
SOLE_TOPIC = {'sim': 'truth/sheep', 'controller': 'plan'}

# Whatever takes a signal takes both alike: each node gets one of them.
both_nodes = pytest.mark.parametrize(
    ('name', 'number'), [('sim', signal.SIGINT), ('controller', signal.SIGTERM)]
)


@both_nodes
def test_while_kernels_are_compiled(
    start: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    name: str,
    number: int,
) -> None:
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'empty'))
    process = start(name, afresh=True, **SMALL[name])
    process.wait_for('loading kernels')
    time.sleep(0.5)  # they take many seconds
    assert 'kernels loaded' not in process.log
    process.ends_in_time(number)


@both_nodes
def test_while_another_node_is_in_the_way(
    start: Callable[..., Any], peer: Any, name: str, number: int
) -> None:
    start(name, **SMALL[name])
    peer.spin_until(lambda: peer.node.count_publishers(SOLE_TOPIC[name]))
    process = start(name, **SMALL[name])
    process.wait_for(f'waiting for node /{name} to end')
    process.ends_in_time(number)


@both_nodes
def test_while_nobody_is_there(
    start: Callable[..., Any], peer: Any, name: str, number: int
) -> None:
    process = start(name, lockstep=True, wait_for='recorder', **SMALL[name])
    peer.spin_until(lambda: peer.node.count_publishers(SOLE_TOPIC[name]))
    process.ends_in_time(number)


@pytest.mark.parametrize(
    ('number', 'times'), [(signal.SIGINT, 1), (signal.SIGINT, 3), (signal.SIGTERM, 3)]
)
def test_sim_in_real_time(start: Callable[..., Any], peer: Any, number: int, times: int) -> None:
    heard = peer.listen(PointCloud2, 'truth/sheep')
    process = start('sim', real_time_factor=20.0, **SMALL['sim'])
    peer.spin_until(lambda: len(heard) > 3)
    process.ends_in_time(number, times=times)


def test_sim_that_does_not_keep_up(start: Callable[..., Any], peer: Any) -> None:
    process = start('sim', real_time_factor=1000.0, **{**SMALL['sim'], 'dogs': 20})
    process.wait_for('came too late')
    process.ends_in_time(signal.SIGINT)


def test_sim_that_waits_for_an_answer(start: Callable[..., Any], peer: Any) -> None:
    heard = peer.listen(PointCloud2, 'sheep')
    peer.listen(Odometry, 'dog_1/odom')
    process = start('sim', lockstep=True, **SMALL['sim'])
    peer.talk_to(TwistStamped, 'dog_1/cmd_vel')
    peer.spin_until(lambda: heard)
    process.ends_in_time(signal.SIGTERM)


def test_sim_that_is_paused(start: Callable[..., Any], peer: Any) -> None:
    process = start('sim', **SMALL['sim'])
    assert peer.call(SetBool, 'sim/pause', SetBool.Request(data=True)).success
    process.ends_in_time(signal.SIGINT)


def test_sim_that_has_finished(start: Callable[..., Any]) -> None:
    process = start('sim', real_time_factor=20.0, time_limit=0.5, **SMALL['sim'])
    process.wait_for('did not arrive')
    process.ends_in_time(signal.SIGTERM)


def test_sim_whose_listener_hangs(start: Callable[..., Any], peer: Any, tmp_path: Path) -> None:
    """A listener that acknowledges nothing is waited for, but not for long."""
    clock = peer.listen(Clock, '/clock')
    listener = start('recorder', bag=tmp_path / 'bag')
    process = start('sim', real_time_factor=20.0, **SMALL['sim'])
    peer.spin_until(lambda: peer.node.count_subscribers('truth/sheep') and clock)
    listener.process.send_signal(signal.SIGSTOP)
    try:
        heard = len(clock)
        peer.spin_until(lambda: len(clock) > heard + 10)
        process.ends_in_time(signal.SIGINT)
    finally:
        listener.process.send_signal(signal.SIGCONT)


INTERRUPTED = """
import os, signal, sys
from herding_ros.nodes.signals import note_signals

left = 50


def signal_again(frame, event, argument):
    global left
    if left:
        left -= 1
        os.kill(os.getpid(), signal.SIGTERM)
    return signal_again


noted = note_signals()
sys.settrace(signal_again)
os.kill(os.getpid(), signal.SIGINT)
sys.settrace(None)
print(noted.is_set(), left)
"""


def test_signal_at_any_line_of_the_handler_of_another() -> None:
    done = subprocess.run(
        [sys.executable, '-c', INTERRUPTED],
        capture_output=True, text=True, check=True, timeout=30.0,
    )  # fmt: skip
    noted, left = done.stdout.split()
    assert noted == 'True'
    assert int(left) < 50
