# SPDX-License-Identifier: Apache-2.0
"""Faults of a robot's worst day, with our sim and our controller as processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
import random
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from herding_ros.control.closed_loop import closed_loop
from herding_ros.control.parameters import Control, Horizon, Mapping, Sensor
from herding_ros.model.crowd import Crowd
from herding_ros.model.flock import distance, spread
from herding_ros.model.simulation import World
from herding_ros.nodes import messages
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
FACTOR = 5.0
DOGS = 5
# Five dogs bring 20 sheep home in a minute or so, whatever happened. With three dogs, or eight
# sheep, a flock that was left alone for a while may take minutes, or never come.
FAR = {'goal': '[1.0, 1.0]'}
SIM = {'sheep': 20, 'dogs': DOGS, 'real_time_factor': FACTOR, 'stop_on_arrival': True, **FAR}
CONTROLLER = {'dogs': DOGS, 'use_sim_time': True, 'lead': 4.0, 'mapping__paths': 20, **FAR}

SLACK = 10.0
"""Where commands are compared, no busy machine shall make the controller stop the dogs [s]."""


def seconds(message: Any) -> float:
    return messages.nanoseconds(message.header.stamp) * 1e-9


class Meadow:
    """Watches what a sim and a controller do."""

    def __init__(self, peer: Any, dogs: int = DOGS) -> None:
        self.peer = peer
        self.diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
        self.plans = peer.listen(MultiDOFJointTrajectory, 'plan', LATCHED)
        self.truth = [peer.listen(Odometry, f'truth/dog_{m + 1}/odom') for m in range(dogs)]
        self.clock = peer.listen(Clock, '/clock')

    def said(self, name: str) -> dict[str, str]:
        """The newest status of this name; its summary is under ''."""
        for message in reversed(self.diagnostics):
            for status in message.status:
                if status.name == name:
                    return {'': status.message, **{p.key: p.value for p in status.values}}
        return {}

    def now(self) -> float:
        return messages.nanoseconds(self.clock[-1].clock) * 1e-9 if self.clock else -math.inf

    def speed(self) -> float:
        """Largest speed of a dog in its newest odometry."""
        twists = [heard[-1].twist.twist.linear for heard in self.truth]
        return max(math.hypot(v.x, v.y) for v in twists)

    def dogs_run(self) -> bool:
        return all(self.truth) and self.speed() > 0.01

    def dogs_stand(self) -> bool:
        return all(self.truth) and self.speed() == 0.0

    def arrived(self) -> bool:
        return self.said('sim: herd').get('arrived') == 'True'

    def run_until(self, condition: Callable[[], object]) -> None:
        self.peer.spin_until(condition, 100.0)


@pytest.mark.slow
def test_killed_controller_in_lockstep_is_replaced_by_a_new_one(
    start: Callable[..., Any], peer: Any
) -> None:
    limit = 120.0  # lockstep is thirty times faster than time
    meadow = Meadow(peer, dogs=2)
    start('sim', lockstep=True, sheep=20, dogs=2, time_limit=limit)
    mine = {'lockstep': True, 'dogs': 2, 'mapping__standard_error': 0.0}
    first = start('controller', **mine)
    meadow.run_until(lambda: meadow.now() > 1.0)
    first.process.kill()
    first.process.wait()
    peer.spin_for(0.5)
    stood = meadow.now()
    peer.spin_for(0.5)
    assert meadow.now() == stood < limit
    start('controller', **mine)
    meadow.run_until(lambda: meadow.said('sim: herd').get('finished') == 'True')
    assert float(meadow.said('sim: herd')['time_s']) == limit


def last_run(odometry: list[Odometry]) -> float:
    """Time of the last message in which the dog moves [s]."""
    velocities = [(message, message.twist.twist.linear) for message in odometry]
    return max(seconds(message) for message, v in velocities if math.hypot(v.x, v.y) > 0.0)


def test_killed_controller_stops_the_dogs_and_a_new_one_brings_them_home(
    start: Callable[..., Any], peer: Any
) -> None:
    start('sim', command_timeout=0.5, **SIM)
    first = start('controller', **CONTROLLER)
    meadow = Meadow(peer)
    commands = Commands(peer, meadow)
    meadow.run_until(lambda: meadow.dogs_run() and all(commands.heard))
    first.process.kill()
    first.process.wait()
    meadow.run_until(meadow.dogs_stand)
    # The last command may have been on its way for a tick of the sim or two.
    for told, heard in zip(commands.heard, meadow.truth, strict=True):
        last = seconds(told[-1])
        assert last_run(heard) - last <= 0.5 + 0.3
    stood = meadow.now()
    meadow.plans.clear()
    start('controller', **CONTROLLER)
    meadow.run_until(lambda: meadow.plans)
    assert seconds(meadow.plans[0]) >= stood
    meadow.run_until(meadow.arrived)


def test_time_set_back_starts_afresh(start: Callable[..., Any], peer: Any) -> None:
    """After a reset of the sim the old plan is dropped, and the flock is herded again."""
    start('sim', **SIM)
    start('controller', **CONTROLLER)
    meadow = Meadow(peer)
    # Long enough for a busy machine to make a plan that starts before that time comes again.
    meadow.run_until(
        lambda: len(meadow.plans) >= 2 and meadow.now() > seconds(meadow.plans[1]) + 20.0
    )
    before, old = meadow.now(), len(meadow.plans)
    assert peer.call(Trigger, 'sim/reset', Trigger.Request()).success
    meadow.run_until(lambda: any(seconds(plan) < before for plan in meadow.plans[old:]))
    assert seconds(meadow.plans[-1]) <= meadow.now() + CONTROLLER['lead'] + 0.2
    meadow.run_until(lambda: meadow.now() < before and meadow.dogs_run())
    meadow.run_until(meadow.arrived)
    assert meadow.said('controller: state')['plans_failed'] == '0'


@pytest.mark.slow
def test_paused_sim_goes_on_where_it_was(start: Callable[..., Any], peer: Any) -> None:
    start('sim', **SIM)
    # So much lead that no plan is late for other reasons.
    start('controller', **{**CONTROLLER, 'lead': 6.0})
    meadow = Meadow(peer)
    meadow.run_until(meadow.dogs_run)
    assert peer.call(SetBool, 'sim/pause', SetBool.Request(data=True)).success
    meadow.run_until(lambda: meadow.said('sim: herd').get('') == 'paused')
    peer.spin_for(0.2)
    paused, plans = meadow.now(), len(meadow.plans)
    peer.spin_for(3.0)  # more than all timeouts
    assert meadow.now() == paused
    assert len(meadow.plans) <= plans + 1  # the one that was being made
    assert peer.call(SetBool, 'sim/pause', SetBool.Request(data=False)).success
    meadow.run_until(lambda: meadow.now() > paused and meadow.dogs_run())
    meadow.run_until(meadow.arrived)
    assert meadow.said('controller: state')['deadlines_missed'] == '0'


class Relay:
    """Passes on what it hears on a topic to another, unless `lose` says otherwise."""

    def __init__(
        self, peer: Any, kind: Any, source: str, target: str, lose: Callable[[], bool]
    ) -> None:
        self.passed = self.lost = 0
        publisher = peer.node.create_publisher(kind, target, 1000)

        def pass_on(data: bytes) -> None:
            if lose():
                self.lost += 1
            else:
                self.passed += 1
                publisher.publish(data)

        peer.node.create_subscription(kind, source, pass_on, 1000, raw=True)


@pytest.mark.slow
def test_lost_messages_do_not_keep_the_flock_from_home(
    start: Callable[..., Any], peer: Any
) -> None:
    """A fifth of all observations of the sheep and of all commands is lost."""
    generator = random.Random(1)

    def unlucky() -> bool:
        return generator.random() < 0.2

    relays = [Relay(peer, PointCloud2, 'sheep', 'lossy/sheep', unlucky)]
    renamed = ['--ros-args']
    for m in range(1, DOGS + 1):
        relays.append(
            Relay(peer, TwistStamped, f'lossy/dog_{m}/cmd_vel', f'dog_{m}/cmd_vel', unlucky)
        )
        renamed += ['-r', f'dog_{m}/cmd_vel:=lossy/dog_{m}/cmd_vel']
    start('sim', **SIM)
    start('controller', *renamed, '-r', 'sheep:=lossy/sheep', **CONTROLLER)
    meadow = Meadow(peer)
    meadow.run_until(meadow.arrived)
    for relay in relays:
        assert 0.1 < relay.lost / (relay.lost + relay.passed) < 0.3


@pytest.mark.statistics
@pytest.mark.parametrize('does', ['stands', 'runs off'])
def test_dog_that_does_not_obey_leaves_it_to_the_others(
    does: str, start: Callable[..., Any], peer: Any
) -> None:
    dogs = DOGS + 1
    start('sim', **{**SIM, 'dogs': dogs}, time_limit=400.0)
    own_will = peer.node.create_publisher(TwistStamped, 'dog_2/cmd_vel', 10)
    meadow = Meadow(peer, dogs)

    def follow_own_will() -> None:
        if not meadow.clock:
            return
        away = messages.command(np.array([-0.05, 0.0]), 0.0, 2, round(meadow.now() * 1e9))
        own_will.publish(away)

    if does == 'runs off':
        peer.node.create_timer(0.02, follow_own_will)
    start(
        'controller', '--ros-args', '-r', 'dog_2/cmd_vel:=nowhere', **{**CONTROLLER, 'dogs': dogs}
    )
    meadow.run_until(lambda: meadow.said('sim: herd').get('finished') == 'True')
    assert meadow.arrived()


class Commands:
    """What the dogs were told, and by which plan."""

    def __init__(self, peer: Any, meadow: Meadow) -> None:
        self.heard = [peer.listen(TwistStamped, f'dog_{m + 1}/cmd_vel') for m in range(DOGS)]
        self.meadow = meadow

    def at(self) -> list[tuple[float, np.ndarray]]:
        """Times [s] and velocities (M, 2) [m/s], as far as all dogs were told."""
        told = [{seconds(c): (c.twist.linear.x, c.twist.linear.y) for c in heard}
                for heard in self.heard]  # fmt: skip
        times = sorted(set(told[0]).intersection(*told[1:]))
        return [(t, np.array([each[t] for each in told])) for t in times]

    def planned(self, t: float, plans: list[Any]) -> np.ndarray:
        """What the newest of the plans that have begun says for t; zero after its end."""
        plan = max((p for p in plans if seconds(p) <= t + 1e-6), key=seconds)
        k = math.floor((t - seconds(plan) + 1e-6) / 0.1)
        if k >= len(plan.points):
            return np.zeros((DOGS, 2))
        return np.array([(v.linear.x, v.linear.y) for v in plan.points[k].velocities])


def test_each_plan_begins_exactly_at_its_window(start: Callable[..., Any], peer: Any) -> None:
    meadow = Meadow(peer)
    commands = Commands(peer, meadow)
    # A solve takes a tenth of the 1.6 s that it is given.
    short = {'horizon__length': 4.0, 'horizon__accepted': 2.0, 'lead': 1.6}
    short['horizon__feedback'] = 2.0  # none
    short['state_timeout'] = SLACK
    short |= {'bodies__separation': 0.0, 'bodies__ramp': 0.0}  # commands as planned
    start('sim', **{**SIM, 'stop_on_arrival': False, 'real_time_factor': 1.0})
    start('controller', **{**CONTROLLER, **short})
    meadow.run_until(lambda: meadow.now() > 14.0)
    begins = [seconds(plan) for plan in meadow.plans]
    assert len(begins) >= 5
    assert np.diff(begins) == pytest.approx(2.0, abs=1e-6)
    # Commands may have been heard before plans were.
    told = [(t, u) for t, u in commands.at() if t > begins[0] - 1e-6]
    assert len(told) > 80
    for t, u in told:
        assert np.array_equal(u, commands.planned(t, meadow.plans))
    state = meadow.said('controller: state')
    assert state['deadlines_missed'] == state['plans_failed'] == '0'


def test_filter_in_lockstep_is_that_of_the_loop_without_ros(
    start: Callable[..., Any], peer: Any
) -> None:
    noise = {'position_noise': 0.05, 'velocity_noise': 0.05}
    control = Control(
        horizon=Horizon(length=4.0, accepted=2.0),
        mapping=Mapping(paths=20),
        sensor=Sensor(**noise),
    )
    world = World(sheep=8, dogs=2, seed=3, **noise)
    expected = closed_loop(Crowd(), world, control, np.array([0.5, 0.5]), 5.0)
    meadow = Meadow(peer, dogs=2)
    start('sim', lockstep=True, sheep=8, dogs=2, seed=3, time_limit=5.0, **noise)
    start(
        'controller', lockstep=True, dogs=2, seed=3, mapping__paths=20, horizon__length=4.0,
        horizon__accepted=2.0, sensor__position_noise=0.05, sensor__velocity_noise=0.05,
    )  # fmt: skip
    meadow.run_until(lambda: meadow.said('sim: herd').get('finished') == 'True')
    sim = meadow.said('sim: herd')
    assert float(sim['time_s']) == expected.t[-1]
    goal = np.array([0.5, 0.5])
    assert sim['distance_m'] == f'{distance(expected.x[-1], goal):.6g}'
    assert sim['spread_m'] == f'{spread(expected.x[-1]):.6g}'
    unfiltered = closed_loop(Crowd(), world, replace(control, sensor=Sensor()), goal, 5.0)
    assert sim['distance_m'] != f'{distance(unfiltered.x[-1], goal):.6g}'
