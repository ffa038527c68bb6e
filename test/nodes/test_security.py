# SPDX-License-Identifier: Apache-2.0
"""Who can hear the nodes: this machine, unless one says otherwise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import shutil
import subprocess
import sys
import time
from typing import Any

import psutil
import pytest

ROOT = Path(__file__).resolve().parents[2]
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'


@pytest.mark.parametrize(('given', 'expected'), [(None, 'LOCALHOST'), ('OFF', 'OFF')])
def test_herd_keeps_its_children_on_this_machine(
    start: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    given: str | None,
    expected: str,
) -> None:
    """Unless the user has chosen another range."""
    monkeypatch.delenv(RANGE)
    if given:
        monkeypatch.setenv(RANGE, given)
    process = start('herd', '--real-time', '2', '--out', str(tmp_path / 'out'))
    herd = psutil.Process(process.process.pid)
    process.wait_for('output in')
    end = time.monotonic() + 30.0
    # A child that has just been made has no environment yet.
    while sum(RANGE in child.environ() for child in herd.children()) < 3:
        assert time.monotonic() < end, process.log
    assert [child.environ()[RANGE] for child in herd.children()] == [expected] * 3
    if expected == 'LOCALHOST':
        programs = [herd, *herd.children()]
        while not all(len(each.net_connections('udp')) > 2 for each in programs):
            assert time.monotonic() < end, process.log
            time.sleep(0.02)
        sockets = [socket for each in programs for socket in each.net_connections('udp')]
        assert {socket.laddr.ip for socket in sockets} == {'127.0.0.1'}
    process.end()


def test_the_environment_of_the_scripts_is_this_machine() -> None:
    script = f'. {ROOT}/scripts/env 2>/dev/null; echo ${RANGE}'
    said = subprocess.run(['bash', '-c', script], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == 'LOCALHOST'


# Two network namespaces with a cable between them; the sim in the one, a stranger in the other.
TWO_MACHINES = """
set -e
ip link set lo up
ip link add here type veth peer name there
unshare -n sleep 100 & other=$!
until [ "$(readlink /proc/$other/ns/net)" != "$(readlink /proc/self/ns/net)" ]; do sleep 0.01; done
on_the_other() { nsenter -t $other -n "$@"; }
ip link set there netns $other
ip addr add 10.9.9.1/24 dev here
ip link set here up
ip route add default dev here
on_the_other ip link set lo up
on_the_other ip addr add 10.9.9.2/24 dev there
on_the_other ip link set there up
on_the_other ip route add default dev there
"$PYTHON" -m herding_ros.nodes.sim 2>"$LOG" & sim=$!
until grep -q 'herding 30 sheep' "$LOG"; do sleep 0.1; done
export ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET
unset FASTRTPS_DEFAULT_PROFILES_FILE
ROS_STATIC_PEERS=10.9.9.1 on_the_other "$PYTHON" -c "$STRANGER"
PATIENCE=60 "$PYTHON" -c "$STRANGER"
kill $sim
wait $sim
kill $other
"""
STRANGER = """
import os, time, rclpy
from std_srvs.srv import SetBool
rclpy.init()
node = rclpy.create_node('stranger')
client = node.create_client(SetBool, 'sim/pause')
answer = None
end = time.monotonic() + float(os.environ['PATIENCE'])
while time.monotonic() < end and not (answer and answer.done()):
    if answer is None and client.service_is_ready():
        answer = client.call_async(SetBool.Request(data=True))
    rclpy.spin_once(node, timeout_sec=0.05)
print('answered' if answer and answer.done() else 'seen' if answer else 'not seen')
"""


def can_have_two_machines() -> bool:
    """Whether this user may make networks of his own."""
    if not all(shutil.which(program) for program in ('unshare', 'nsenter', 'ip')):
        return False
    make = ['unshare', '-rn', 'ip', 'link', 'add', 'here', 'type', 'veth', 'peer', 'name', 'there']
    return subprocess.run(make, capture_output=True, check=False).returncode == 0


@pytest.mark.skipif(not can_have_two_machines(), reason='needs the right to make a network')
@pytest.mark.parametrize(
    ('reach', 'patience', 'what'), [('LOCALHOST', 5, 'not seen'), ('SUBNET', 60, 'answered')]
)
def test_another_machine_reaches_the_nodes_only_on_request(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, reach: str, patience: int, what: str
) -> None:
    """Not even if it knows the address. The answer on SUBNET shows that there is a way.

    A node with the range SUBNET on this machine reaches them in any case.
    """
    monkeypatch.setenv(RANGE, reach)
    monkeypatch.setenv('PYTHON', sys.executable)
    monkeypatch.setenv('STRANGER', STRANGER)
    monkeypatch.setenv('PATIENCE', str(patience))
    monkeypatch.setenv('LOG', str(tmp_path / 'sim.log'))
    command = ['unshare', '-rn', 'bash', '-c', TWO_MACHINES]
    said = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120.0)
    assert said.stdout.splitlines() == [what, 'answered'], said.stderr
