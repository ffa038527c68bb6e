# SPDX-License-Identifier: Apache-2.0
"""Every parameter of every node, by the services that `ros2 param` uses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import dataclasses
from functools import cache
import math
import re
from typing import Any

from geometry_msgs.msg import TwistStamped
from herding_ros.control.parameters import Bodies, Control, Weights
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.motion import Unicycle
from herding_ros.model.noise_field import NoiseField
from herding_ros.model.parameters import describe_limits, Entry, Parameters
from herding_ros.model.potentials import Harmonic
from herding_ros.model.simulation import Simulation, World
from herding_ros.nodes import messages
from herding_ros.nodes.herding_node import HerdingNode
from herding_ros.nodes.middleware import start_ros
from herding_ros.nodes.parameters import _declare_entry, declare_crowd, declare_scaled
from herding_ros.nodes.settings import (
    ControllerSettings,
    ControlPreset,
    RecorderSettings,
    SimSettings,
)
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterDescriptor, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
import rclpy
from rclpy.parameter import Parameter, parameter_value_to_python
from sensor_msgs.msg import PointCloud2

Field = dataclasses.Field[Any]


def fields(parameters: Parameters, prefix: str = '') -> dict[str, Field]:
    return {entry.name: entry.field for entry in parameters.walk(prefix)}


CROWD = fields(Crowd(), 'crowd.')
FIELDS: dict[str, dict[str, Field]] = {
    'sim': {**CROWD, **fields(World()), **fields(SimSettings())},
    'controller': {
        **CROWD,
        **fields(ControlPreset()),
        **fields(Control()),
        **fields(ControllerSettings()),
    },
    'recorder': fields(RecorderSettings()),
}
NOISE = {name for name in CROWD if name.startswith(('crowd.noise', 'crowd.common_noise'))}
LIVE = {
    'sim': {'real_time_factor', *NOISE},
    'controller': {
        *(f'weights.{field.name}' for field in dataclasses.fields(Weights)),
        *(
            f'bodies.{field.name}'
            for field in dataclasses.fields(Bodies)
            if field.name != 'radius'
        ),
        *NOISE,
        *('horizon.length', 'horizon.accepted', 'horizon.feedback', 'max_speed'),
    },
    'recorder': set(),
}


class Asker:
    """Asks a node about its parameters, as `ros2 param` does."""

    def __init__(self, peer: Any, node: str) -> None:
        self._peer = peer
        self._node = node

    def call(self, kind: Any, **request: Any) -> Any:
        name = kind.__name__
        service = ''.join(f'_{letter.lower()}' if letter.isupper() else letter for letter in name)
        return self._peer.call(kind, f'{self._node}/{service[1:]}', kind.Request(**request))

    def names(self) -> list[str]:
        return list(self.call(ListParameters).result.names)

    def describe(self, names: list[str]) -> dict[str, ParameterDescriptor]:
        answer = self.call(DescribeParameters, names=names).descriptors
        assert [descriptor.name for descriptor in answer] == names
        return dict(zip(names, answer, strict=True))

    def values(self, names: list[str]) -> dict[str, Any]:
        answer = self.call(GetParameters, names=names).values
        return dict(zip(names, map(parameter_value_to_python, answer), strict=True))

    def refusal(self, name: str, value: Any) -> str:
        """Set one parameter; return the reason when it is refused, else nothing."""
        (result,) = self.call(SetParameters, parameters=[message(name, value)]).results
        assert result.successful == (not result.reason)
        return str(result.reason)

    def refusal_of_all(self, **values: Any) -> str:
        """Set several at once; `__` stands for a dot."""
        changes = [message(name.replace('__', '.'), value) for name, value in values.items()]
        result = self.call(SetParametersAtomically, parameters=changes).result
        assert result.successful == (not result.reason)
        return str(result.reason)


def message(name: str, value: Any) -> ParameterMessage:
    return Parameter(name, value=value).to_parameter_msg()


@pytest.fixture(scope='module')
def asked(
    start_for_all: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Asker]:
    """Return a function that starts a node, once for all tests, and returns somebody to ask it."""

    @cache
    def ask(name: str) -> Asker:
        bag = tmp_path_factory.mktemp('recorded') / 'bag'
        return Asker(
            start_for_all(name, **{'bag': bag} if name == 'recorder' else {'dogs': 1}), name
        )

    return ask


every_node = pytest.mark.parametrize('name', list(FIELDS))
sim_and_controller = pytest.mark.parametrize('name', ['sim', 'controller'])


@every_node
def test_every_parameter_is_described(asked: Callable[[str], Asker], name: str) -> None:
    node = asked(name)
    found = node.describe(node.names())
    assert set(FIELDS[name]) <= set(found)
    for parameter, descriptor in found.items():
        assert descriptor.description, f'{parameter} has no description'
        assert descriptor.type != ParameterType.PARAMETER_NOT_SET
        assert not descriptor.dynamic_typing
        assert descriptor.read_only == (parameter not in LIVE[name]), parameter
    for parameter, field in FIELDS[name].items():
        meta, descriptor = field.metadata, found[parameter]
        unit = f' [{meta["unit"]}]' if meta['unit'] else ''
        assert descriptor.description == meta['doc'] + unit
        assert descriptor.additional_constraints == describe_limits(field)
        ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
        assert len(ranges) == (meta['low'] is not None or meta['high'] is not None), parameter
        for each in ranges:
            assert each.from_value == meta['low']
            assert each.to_value == meta['high'] or (meta['high'] is None and each.to_value > 1e18)


@every_node
def test_what_is_fixed_cannot_be_set(asked: Callable[[str], Asker], name: str) -> None:
    """Not even to what it is."""
    node = asked(name)
    fixed = sorted(set(node.names()) - LIVE[name])
    for parameter, value in node.values(fixed).items():
        reason = node.refusal(parameter, value)
        assert 'read-only' in reason
        assert parameter in reason


def wrong_values(field: Field) -> list[Any]:
    """Return what a field refuses; a number without a point is none where one has a point."""
    low, high = field.metadata['low'], field.metadata['high']
    kind = type(field.default)
    wrong: list[Any] = [[1.5, 2.5, 3.5]]
    if kind is not str or field.metadata['choices']:
        wrong.append('lions')
    if kind is not bool:
        wrong.append(True)
    wrong.append(1.0 if kind is int else 1)
    if kind is float:
        wrong += [math.nan, math.inf, -math.inf]
    if kind is tuple:
        wrong += [[1.0], [1, 2], [math.nan, 0.0], [0.0, math.inf]]
    wrong += [] if low is None else [low - 1]
    wrong += [] if high is None else [high + 1]
    return wrong


def refusal_of(name: str, value: Any) -> re.Pattern[str]:
    return re.compile(rf'parameter {re.escape(name)} must be .*, got {re.escape(repr(value))}')


@sim_and_controller
def test_wrong_values_are_refused_while_it_runs(asked: Callable[[str], Asker], name: str) -> None:
    node = asked(name)
    names = sorted(LIVE[name])
    before = node.values(names)
    for parameter in names:
        for value in [*wrong_values(FIELDS[name][parameter]), None]:
            reason = node.refusal(parameter, value)
            assert refusal_of(parameter, value).search(reason), reason
    assert node.values(names) == before
    assert node.refusal('nonsense', 1.0) == f'{name} has no parameter nonsense'


def written(value: Any) -> str:
    """Return a value as one writes it in a command."""
    if isinstance(value, list):
        return f'[{", ".join(map(written, value))}]'
    if isinstance(value, float) and not math.isfinite(value):
        return f'{value}'.replace('nan', '.nan').replace('inf', '.inf')
    return str(value).lower()


@every_node
def test_wrong_values_are_refused_at_the_start(domain: int, name: str) -> None:
    """All of them, in this process: what a node does with the reason is tested with the node.

    A node is given a wrong value for each parameter, and refuses them one by one.
    """
    wrong = {parameter: list(writable(field)) for parameter, field in FIELDS[name].items()}
    start_ros([], domain_id=domain)
    try:
        for k in range(max(map(len, wrong.values()))):
            given = {parameter: values[k] for parameter, values in wrong.items() if values[k:]}
            words = [
                word
                for parameter, value in given.items()
                for word in ('-p', f'{parameter}:={written(value)}')
            ]
            node = HerdingNode(name, cli_args=['--ros-args', *words])
            for parameter, value in given.items():
                field = FIELDS[name][parameter]
                with pytest.raises(ValueError, match=refusal_of(parameter, value)):
                    _declare_entry(node, Entry(parameter, field.default, field))
            node.destroy_node()
    finally:
        rclpy.shutdown()


def writable(field: Field) -> Iterator[Any]:
    """Yield what a field refuses and a command can say: lists of numbers of one type."""
    for value in wrong_values(field):
        if not isinstance(value, list) or len({type(each) for each in value}) == 1:
            yield value


def test_a_preset_brings_the_parameters_of_its_own_potentials(domain: int) -> None:
    given = ['crowd.preset:=independent', 'crowd.dog.reach:=0.6']
    start_ros(['--ros-args', *(part for each in given for part in ('-p', each))], domain_id=domain)
    node = HerdingNode('sim')
    try:
        preset = CROWDS['independent']
        assert declare_crowd(node) == dataclasses.replace(preset, dog=Harmonic(reach=0.6))
        assert not node.has_parameter('crowd.dog.repulsion')
    finally:
        node.destroy_node()
        rclpy.shutdown()


def test_a_motion_brings_its_own_parameters_at_the_scale_of_the_herd(domain: int) -> None:
    given = ['motion.kind:=unicycle', 'motion.turn_rate:=0.7', 'max_speed:=0.8']
    start_ros(['--ros-args', *(part for each in given for part in ('-p', each))], domain_id=domain)
    node = HerdingNode('sim')
    try:
        crowd = Crowd().rescaled(16.0, 1.0)
        motion = declare_scaled(node, World(), crowd).motion
        assert motion == Unicycle(turn_rate=0.7, ahead=1.6)
        assert not node.has_parameter('motion.acceleration')
    finally:
        node.destroy_node()
        rclpy.shutdown()


def test_what_does_not_go_together_is_refused(asked: Callable[[str], Asker]) -> None:
    node = asked('controller')
    names = ['horizon.length', 'horizon.accepted', 'weights.centre']
    before = node.values(names)
    too_long = node.refusal('horizon.accepted', 30.0)
    assert 'Horizon.accepted' in too_long
    assert 'at most the length' in too_long
    assert 'at most the length' in node.refusal('horizon.length', 5.0)
    assert 'multiple of control_period' in node.refusal('horizon.length', 20.05)
    assert too_long == node.refusal_of_all(weights__centre=1.0, horizon__accepted=30.0)
    assert 'read-only' in node.refusal_of_all(weights__centre=1.0, dogs=1)
    assert node.values(names) == before
    assert node.refusal_of_all(horizon__length=5.0, horizon__accepted=4.0) == ''
    assert node.values(names) == {**before, 'horizon.length': 5.0, 'horizon.accepted': 4.0}
    assert 'Horizon.accepted' in node.refusal('horizon.length', 3.0)


def test_what_was_refused_is_not_taken_with_the_next(asked: Callable[[str], Asker]) -> None:
    node = asked('controller')
    before = node.values(['horizon.accepted'])
    assert node.refusal('horizon.accepted', 30.0)
    assert node.refusal('weights.centre', 2.0) == ''
    assert node.refusal('horizon.length', 10.0) == ''
    assert node.values(['weights.centre']) == {'weights.centre': 2.0}
    assert node.values(['horizon.accepted']) == before


def test_noise_of_the_sim_changes_from_the_next_step_on(
    start: Callable[..., Any], peer: Any
) -> None:
    start('sim', lockstep=True, sheep=3, dogs=1, seed=5)
    node = Asker(peer, 'sim')
    truth = peer.listen(PointCloud2, 'truth/sheep')
    for kind, topic in [(PointCloud2, 'sheep'), (Odometry, 'dog_1/odom')]:
        peer.listen(kind, topic)
    commands = peer.talk_to(TwistStamped, 'dog_1/cmd_vel')
    expected = Simulation(Crowd(), World(sheep=3, dogs=1, seed=5), np.array([0.5, 0.5]))
    for k in range(6):
        peer.spin_until(lambda k=k: len(truth) > k)  # type: ignore[misc]
        seen = np.frombuffer(bytes(truth[k].data), np.float32).reshape(3, -1)[:, 1:3]
        assert np.array_equal(seen, expected.state.x.astype(np.float32))
        if k == 2:
            assert node.refusal('crowd.noise', 0.2) == ''
            expected.crowd = dataclasses.replace(expected.crowd, noise=0.2)
        if k == 3:
            changes = {
                'common_noise': 0.5,
                'noise_field__gust': 0.8,
                'noise_field__slope': [1.0, 0.0],
            }
            assert (
                node.refusal_of_all(**{f'crowd__{n}': value for n, value in changes.items()}) == ''
            )
            field = NoiseField(gust=0.8, slope=(1.0, 0.0))
            expected.crowd = dataclasses.replace(
                expected.crowd, common_noise=0.5, noise_field=field
            )
        command = TwistStamped()
        command.header.stamp = messages.stamp_of(k * 100_000_000)
        command.header.frame_id = messages.dog_frame(1)
        commands.publish(command)
        expected.advance(np.zeros((1, 2)))


@every_node
def test_request_of_no_sense_kills_nobody(asked: Callable[[str], Asker], name: str) -> None:
    node = asked(name)
    names = node.names()
    nonsense = ParameterMessage(name='use_sim_time', value=ParameterValue(type=99))
    assert not node.call(SetParameters, parameters=[nonsense]).results
    assert not node.call(SetParametersAtomically, parameters=[nonsense]).result.successful
    assert not node.call(SetParametersAtomically, parameters=[]).result.reason
    assert not node.call(DescribeParameters, names=['nonsense']).descriptors
    assert not node.call(GetParameters, names=['nonsense', '']).values
    assert set(names) <= set(node.names())  # subscriptions may have come with theirs
