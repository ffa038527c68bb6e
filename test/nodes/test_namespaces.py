# SPDX-License-Identifier: Apache-2.0
"""Two herds side by side on one domain, each in a namespace with a clock of its own."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rosbags.highlevel import AnyReader
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config' / 'herding.yaml'
SHARED = {'/diagnostics', '/rosout', '/parameter_events'}
SMALL: dict[str, Any] = {'dogs': 2, 'crowd__noise': 0.0, 'goal': '[0.05, 0.05]'}
ENDS = {'sheep': 3, 'stop_on_arrival': True, 'end_when_finished': True}
FACTORS = {'/east': 10.0, '/west': 8.0}


def test_two_herds_arrive_and_each_bag_holds_one(
    start: Callable[..., Any], peer: Any, tmp_path: Path
) -> None:
    """By the parameter file that is shipped, and by the sims' time, which differs."""
    said: dict[str, dict[str, str]] = {}

    def listen(message: DiagnosticArray) -> None:
        for status in message.status:
            said[status.name] = {pair.key: pair.value for pair in status.values}

    peer.node.create_subscription(DiagnosticArray, '/diagnostics', listen, 1000)
    nodes = []
    for namespace, factor in FACTORS.items():
        place = ['--ros-args', '-r', f'__ns:={namespace}', '-r', '/clock:=clock']
        place += ['--params-file', str(CONFIG)]
        shared = {**SMALL, 'wait_for': 'recorder'}
        bag = tmp_path / namespace[1:]
        nodes += [
            start('recorder', *place, bag=bag),
            start('controller', *place, **shared, lead=5.0),
            start('sim', *place, **shared, **ENDS, real_time_factor=factor),
        ]
    names = [f'{namespace[1:]}/sim: herd' for namespace in FACTORS]
    peer.spin_until(lambda: all(said.get(name, {}).get('finished') == 'True' for name in names))
    assert [said[name]['arrived'] for name in names] == ['True', 'True']
    for node in reversed(nodes):
        code = node.wait() if node in nodes[2::3] else node.end()  # the sims end by themselves
        assert code == 0, node.log

    for namespace in FACTORS:
        check_bag(tmp_path / namespace[1:], namespace)


def check_bag(bag: Path, namespace: str) -> None:
    """It holds one namespace, in the time of its own clock, and the parameters of its nodes."""
    with AnyReader([bag]) as reader:
        own = {topic for topic in reader.topics if topic.startswith(f'{namespace}/')}
        assert set(reader.topics) <= own | SHARED
        assert {f'{namespace}/{topic}' for topic in ('clock', 'truth/sheep', 'plan')} <= own
        connections = [c for c in reader.connections if c.topic == f'{namespace}/clock']
        for connection, log_ns, data in reader.messages(connections):
            tick: Any = reader.deserialize(data, connection.msgtype)
            assert log_ns == tick.clock.sec * 10**9 + tick.clock.nanosec
    custom_data = yaml.safe_load((bag / 'metadata.yaml').read_text())
    custom_data = custom_data['rosbag2_bagfile_information']['custom_data']
    names = {f'{namespace}/{node}' for node in ('sim', 'controller', 'recorder')}
    assert set(json.loads(custom_data['parameters'])) == names
