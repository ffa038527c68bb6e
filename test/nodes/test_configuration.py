# SPDX-License-Identifier: Apache-2.0
"""Parameters from files and command lines, before any node has them."""

from pathlib import Path
import re

from herding_ros.model.crowd import CROWDS
from herding_ros.nodes import herd
from herding_ros.nodes.configuration import assignment, checked, crowd_of, parameters_of
import pytest

CONFIG = Path(__file__).parents[2] / 'config'


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('seed:=3', ('seed', 3)),
        ('max_speed:=4.0', ('max_speed', 4.0)),
        ('optimiser.tolerance:=1e-3', ('optimiser.tolerance', 1e-3)),
        ('goal:=[10, -1.5]', ('goal', [10, -1.5])),
        ('frame:=field', ('frame', 'field')),
        ('lockstep:=true', ('lockstep', True)),
        ('bag:=', ('bag', None)),
    ],
)
def test_an_assignment_is_read_as_ros_does(text: str, expected: tuple[str, object]) -> None:
    assert assignment(text) == expected


@pytest.mark.parametrize('text', ['seed=3', ':=3', 'seed', 'goal:=[1, 2'])
def test_what_is_no_assignment_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match='must be'):
        assignment(text)


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'crowd.nois': 0.1}, 'no node has a parameter crowd.nois; did you mean crowd.noise?'),
        ({'crowd.dog.stiffness': 0.1}, 'no node has a parameter crowd.dog.stiffness'),
        ({'max_speed': -1.0}, 'parameter max_speed must be from 1e-09 to 1e+09, got -1.0'),
        ({'goal': 3.0}, 'parameter goal must be 2 numbers from -1e+09 to 1e+09, got 3.0'),
        ({'motion.turn_rate': 0.1}, 'no node has a parameter motion.turn_rate'),
        ({'motion.kind': 'hover'}, 'MotionKind.kind must be holonomic or '),
        ({'crowd.preset': 'wolves'}, 'CrowdPreset.preset must be cohesive or '),
    ],
)
def test_what_no_node_would_take_is_refused(values: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        checked(values)


def test_numbers_get_the_point_that_ros_asks_for() -> None:
    found = checked({'max_speed': 4, 'goal': [10, 10], 'sheep': 7, 'use_sim_time': True})
    assert found == {'max_speed': 4.0, 'goal': (10.0, 10.0), 'sheep': 7, 'use_sim_time': True}
    assert type(found['max_speed']) is float
    assert {type(each) for each in found['goal']} == {float}


def test_a_motion_brings_its_own_parameters() -> None:
    values = {'motion.kind': 'unicycle', 'motion.turn_rate': 1}
    assert checked(values) == {'motion.kind': 'unicycle', 'motion.turn_rate': 1.0}


def test_parameters_belong_to_the_preset() -> None:
    values = {'crowd.preset': 'independent', 'crowd.dog.stiffness': 0.2, 'crowd.length': 2.0}
    assert checked(values) == values
    crowd = crowd_of(values)
    assert crowd.dog.flat() == {'stiffness': 0.2, 'reach': 1.0}
    assert crowd.friction == CROWDS['independent'].friction


@pytest.mark.parametrize('file', sorted(CONFIG.glob('*.yaml')), ids=lambda file: file.stem)
def test_herd_takes_every_parameter_file(file: Path) -> None:
    options = herd._parser().parse_args(['--config', str(file)])
    values = herd._values(options)
    assert values['sim'].items() >= checked(parameters_of(file)('sim', '')).items()


def test_option_counts_more_than_assignment_and_that_more_than_file(tmp_path: Path) -> None:
    one, two = tmp_path / 'one.yaml', tmp_path / 'two.yaml'
    one.write_text('/**: {ros__parameters: {seed: 1, sheep: 10, dogs: 2, goal: [1.0, 1.0]}}')
    two.write_text('/**/sim: {ros__parameters: {sheep: 11, crowd: {noise: 2e-2}}}')
    given = ['--config', str(one), '--config', str(two), '-p', 'dogs:=3', '-p', 'goal:=[2, 2]']
    values = herd._values(herd._parser().parse_args([*given, '--goal', '3', '4']))
    expected = {'seed': 1, 'sheep': 11, 'dogs': 3, 'goal': (3.0, 4.0), 'crowd.noise': 0.02}
    assert values['sim'].items() >= expected.items()
    assert values['controller']['sheep'] == 10
    assert 'crowd.noise' not in values['controller']
    assert values['sim']['time_limit'] == 400.0
