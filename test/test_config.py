# SPDX-License-Identifier: Apache-2.0
"""Every parameter file is one that the nodes accept."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import re
from typing import Any

import pytest
import yaml

from herding_ros.control.parameters import Control, CONTROLS, PAPER
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.parameters import Parameters
from herding_ros.model.simulation import World
from herding_ros.nodes.settings import ControllerSettings, ControlPreset, SimSettings

CONFIG = Path(__file__).resolve().parents[1] / 'config'
FILES = sorted(CONFIG.glob('*.yaml'))
OF_EVERY_NODE = {'use_sim_time': False}
QOS = re.compile(
    r'qos_overrides\./[\w/]+\.(publisher|subscription)\.(reliability|depth|history|durability)'
)


def flat(tree: dict[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the dotted names and the values of nested parameters, as ROS does."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, f'{prefix}{key}.')
        else:
            yield prefix + key, value


def with_values(parameters: Parameters, values: dict[str, Any], prefix: str = '') -> Any:
    """Return a set of parameters with those of the values that are its own; it validates them."""
    own = parameters.flat(prefix)
    return parameters.with_values({k: v for k, v in values.items() if k in own}, prefix)


CROWD = {'crowd.preset': 'cohesive', **Crowd().flat('crowd.')}
NODES: dict[str, dict[str, Any]] = {
    'sim': {**CROWD, **World().flat(), **SimSettings().flat()},
    'controller': {
        **CROWD,
        **ControlPreset().flat(),
        **Control().flat(),
        **ControllerSettings().flat(),
    },
    'recorder': {'bag': '', 'topics': ['']},
}


def sections(path: Path) -> dict[str, dict[str, Any]]:
    """Return the flat parameters of each section of a file."""
    content = yaml.safe_load(path.read_text(encoding='utf-8'))
    for name, section in content.items():
        assert list(section) == ['ros__parameters'], f'{path.name}: {name} lacks ros__parameters'
    return {name: dict(flat(section['ros__parameters'])) for name, section in content.items()}


def values_for(path: Path, node: str) -> dict[str, Any]:
    """Return what a node takes of a file: its own section over the common one."""
    content = sections(path)
    return {**content.get('/**', {}), **content.get(node, {})}


def is_of_type(value: Any, default: Any) -> bool:
    """Whether ROS takes value for a parameter of this default: 1 is no double."""
    if isinstance(default, tuple):
        return isinstance(value, list) and all(type(each) is float for each in value)
    return type(value) is type(default)


def test_there_are_files() -> None:
    assert {path.name for path in FILES} >= {'herding.yaml', 'paper.yaml', 'real_dogs.yaml'}


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_every_name_and_type_is_one_that_a_node_declares(path: Path) -> None:
    for section, values in sections(path).items():
        assert section in {'/**', *NODES}, f'{path.name} has a section {section}'
        nodes = list(NODES.values()) if section == '/**' else [NODES[section]]
        for name, value in values.items():
            if QOS.fullmatch(name):
                continue
            declared = [{**OF_EVERY_NODE, **node} for node in nodes]
            takers = [node[name] for node in declared if name in node]
            assert takers, f'{path.name}: {section} has {name}, which nobody declares'
            for default in takers:
                assert is_of_type(value, default), (
                    f'{path.name}: {section} has {name}: {value!r}, '
                    f'it must be a {type(default).__name__} such as {default!r}'
                )


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_the_values_are_allowed(path: Path) -> None:
    sim, controller = values_for(path, 'sim'), values_for(path, 'controller')
    with_values(SimSettings(), sim)
    with_values(World(), sim)
    with_values(ControllerSettings(), controller)
    with_values(CONTROLS[controller.get('preset', 'default')], controller)
    for values in (sim, controller):
        with_values(CROWDS[values.get('crowd.preset', 'cohesive')], values, 'crowd.')


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_sim_and_controller_are_told_the_same(path: Path) -> None:
    """What both of them declare stands under /** if both are in the file."""
    content = sections(path)
    if 'sim' not in content:
        return
    shared = set(NODES['sim']) & set(NODES['controller'])
    assert not shared & (set(content['sim']) | set(content.get('controller', {})))


def test_the_paper_s_setting_is_that_of_the_code() -> None:
    values = values_for(CONFIG / 'paper.yaml', 'controller')
    assert with_values(CONTROLS[values['preset']], values) == PAPER
    crowd = with_values(CROWDS[values['crowd.preset']], values, 'crowd.')
    assert crowd == CROWDS['cohesive']


def test_the_reference_run_is_that_of_the_defaults() -> None:
    path = CONFIG / 'herding.yaml'
    sim, controller = values_for(path, 'sim'), values_for(path, 'controller')
    assert with_values(World(), sim) == World()
    assert with_values(Control(), controller) == Control()
    assert with_values(Crowd(), sim, 'crowd.') == Crowd()
    judged_at = with_values(SimSettings(), sim).goal
    assert judged_at == with_values(ControllerSettings(), controller).goal == SimSettings().goal
