# SPDX-License-Identifier: Apache-2.0
"""Two sims or two controllers on one domain, by mistake: one of them goes and says why."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
from types import SimpleNamespace
from typing import Any

from herding_ros.nodes import duplicates
from herding_ros.nodes.running import CannotGoOnError
import pytest
from rosgraph_msgs.msg import Clock

BLIND = Path(__file__).with_name('blind.py')
SMALL: dict[str, dict[str, Any]] = {'sim': {'sheep': 3, 'dogs': 1}, 'controller': {'dogs': 1}}
SOLE_TOPIC = {'sim': 'truth/sheep', 'controller': 'plan'}
MOVES = {'sim': 'sheep', 'controller': 'dog_1/cmd_vel'}


def is_active(peer: Any, name: str) -> Callable[[], object]:
    return lambda: peer.node.count_publishers(SOLE_TOPIC[name])


@pytest.mark.parametrize(
    ('name', 'how'),
    [('controller', {}), ('sim', {'wait_for': 'recorder'})],
    ids=['plain', 'wait_for'],
)
def test_second_one_is_refused(
    start: Callable[..., Any], peer: Any, name: str, how: dict[str, Any]
) -> None:
    first = start(name, **SMALL[name], **how)
    peer.spin_until(is_active(peer, name))
    second = start(name, **SMALL[name], **how)
    while second.process.poll() is None:
        peer.spin_for(0.02)
        assert peer.node.count_publishers(MOVES[name]) == 1
    assert second.wait() == 2
    assert (
        f'cannot start: node /{name} publishes /{SOLE_TOPIC[name]} already; end it, or give this '
        'one a namespace or another ROS_DOMAIN_ID'
    ) in second.log
    assert 'Traceback' not in second.log
    assert first.process.poll() is None, first.log


def test_second_clock_is_refused_with_the_remedy(start: Callable[..., Any], peer: Any) -> None:
    """Namespaces share /clock, unless they are told not to."""
    peer.node.create_publisher(Clock, '/clock', 1)
    second = start('sim', '--ros-args', '-r', '__ns:=/west', **SMALL['sim'])
    assert second.wait() == 2
    assert (
        'cannot start: node /peer publishes /clock already; end it, or give all nodes of this '
        'herd a clock of their own, by a namespace and -r /clock:=clock, or another ROS_DOMAIN_ID'
    ) in second.log


def test_of_two_active_ones_the_first_stays(start: Callable[..., Any], peer: Any) -> None:
    name = 'sim'
    one = start(name, **SMALL[name])
    peer.spin_until(is_active(peer, name))
    peer.spin_for(duplicates.CLAIM + 1.0)
    other = start(name, name, program=BLIND, **SMALL[name])
    peer.spin_until(lambda: other.process.poll() is not None)
    assert other.wait() == 2
    assert re.search(
        f'ending: node /{name} publishes /({SOLE_TOPIC[name]}|clock) as well', other.log
    )
    assert 'Traceback' not in other.log
    peer.spin_for(2.0 * duplicates.CLAIM)
    assert one.process.poll() is None, one.log
    assert peer.node.count_publishers(MOVES[name]) == 1


@pytest.mark.parametrize(
    ('name', 'program'), [('sim', BLIND), ('controller', None)], ids=['both active', 'as it comes']
)
def test_of_two_that_start_together_one_stays(
    start: Callable[..., Any], peer: Any, name: str, program: Path | None
) -> None:
    words = [name] if program else []
    nodes = [start(name, *words, program=program, **SMALL[name]) for _ in range(2)]
    peer.spin_until(lambda: any(node.process.poll() is not None for node in nodes))
    stays, gone = sorted(nodes, key=lambda node: node.process.poll() is not None)
    assert gone.wait() == 2, gone.log
    assert re.search(
        f'publishes /({SOLE_TOPIC[name]}|clock) {"as well" if program else ""}', gone.log
    )
    peer.spin_until(is_active(peer, name))
    peer.spin_for(3.0 * duplicates.CLAIM)
    assert stays.process.poll() is None, stays.log
    assert peer.node.count_publishers(MOVES[name]) == 1


def test_killed_one_is_replaced_at_once(start: Callable[..., Any], peer: Any) -> None:
    name = 'controller'
    first = start(name, **SMALL[name])
    peer.spin_until(is_active(peer, name))
    first.process.kill()
    first.process.wait()
    second = start(name, **SMALL[name])
    second.wait_for('ready to herd')
    assert 'waiting' not in second.log


def test_one_that_is_ending_is_waited_for(start: Callable[..., Any], peer: Any) -> None:
    name = 'sim'
    first = start(name, **SMALL[name])
    peer.spin_until(is_active(peer, name))
    second = start(name, **SMALL[name])
    second.wait_for(f'waiting for node /{name} to end')
    assert first.end() == 0
    second.wait_for('herding')


class Clockwork:
    """Stands for time and for a node that sees a rival from `begin` [s] on."""

    def __init__(self, rival: list[int], begin: float) -> None:
        self.now = 0.0
        self._rival = rival
        self._begin = begin

    def monotonic(self) -> float:
        return self.now

    def get_publishers_info_by_topic(self, _: str) -> list[SimpleNamespace]:
        gids = [[5]] + ([self._rival] if self.now >= self._begin else [])
        return [
            SimpleNamespace(endpoint_gid=gid, node_namespace='/', node_name='n') for gid in gids
        ]


@pytest.mark.parametrize(
    ('rival', 'begin', 'patience'),
    [([4], 1.0, 0), ([6], 1.0, 1), ([4], 10.0, 2), ([6], 10.0, 3)],
    ids=['newcomer', 'newcomer with the lower number', 'first', 'first with the lower number'],
)
def test_who_was_first_waits_longest(
    monkeypatch: pytest.MonkeyPatch, rival: list[int], begin: float, patience: int
) -> None:
    """No two duplicates have the same patience, so that one of them always stays."""
    world = Clockwork(rival, begin)
    monkeypatch.setattr(duplicates, 'time', world)
    watch = duplicates._Watch(world, '/plan', [5], 'go')  # type: ignore[arg-type]

    def look_on() -> None:
        while world.now < 100.0:
            world.now += duplicates.WATCH_PERIOD
            watch.check()

    with pytest.raises(CannotGoOnError):
        look_on()
    waited = world.now - begin - patience * duplicates.CLAIM
    assert 0.0 < waited <= 2.0 * duplicates.WATCH_PERIOD


@pytest.mark.slow
def test_second_herd_says_why_it_ends_and_leaves_the_first_alone(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    first = start('herd', '--goal', '3', '3', '--real-time', '2', '--out', str(tmp_path / 'one'))
    first.wait_for('to go')
    second = start('herd', '--real-time', '2', '--out', str(tmp_path / 'two'))
    assert second.wait() == 3
    assert 'died (exit code 2)' in second.log
    # Rarely one learns of the other's topics only after DISCOVERY; then it has published a little.
    assert re.search('publishes .* (already|as well); end it, or give this one a', second.log)
    assert first.process.poll() is None, first.log
    assert first.end() == 130
