# SPDX-License-Identifier: Apache-2.0
"""Every parameter file is one that the nodes accept."""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatch
import json
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

from herding_ros.control.parameters import Control, CONTROLS, PAPER
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.parameters import Parameters
from herding_ros.model.simulation import World
from herding_ros.nodes.settings import (
    ControllerSettings,
    ControlPreset,
    CrowdPreset,
    MotionKind,
    SimSettings,
)
import pytest
import yaml

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


CROWD = {
    **CrowdPreset().flat('crowd.'),
    **MotionKind().flat('motion.'),
    **Crowd().flat('crowd.'),
}
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


def values_in(path: Path) -> dict[str, Any]:
    """Return what a file tells all nodes, flat; each takes what it declares."""
    content = yaml.safe_load(path.read_text(encoding='utf-8'))
    return dict(flat(content['/**']['ros__parameters']))


def is_of_type(value: Any, default: Any) -> bool:
    """Whether ROS takes value for a parameter of this default: 1 is no double."""
    if isinstance(default, tuple):
        return isinstance(value, list) and all(type(each) is float for each in value)
    return type(value) is type(default)


def test_there_are_files() -> None:
    assert {path.name for path in FILES} >= {'herding.yaml', 'paper.yaml', 'real_dogs.yaml'}


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_it_applies_in_every_namespace_and_yields_to_the_command_line(path: Path) -> None:
    """A section `sim` is that of /sim alone; that, or one of /**/sim, would win over -p."""
    content = yaml.safe_load(path.read_text(encoding='utf-8'))
    assert list(content) == ['/**']
    assert list(content['/**']) == ['ros__parameters']


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_every_name_and_type_is_one_that_a_node_declares(path: Path) -> None:
    for name, value in values_in(path).items():
        if QOS.fullmatch(name):
            continue
        declared = [{**OF_EVERY_NODE, **node} for node in NODES.values()]
        takers = [node[name] for node in declared if name in node]
        assert takers, f'{path.name} has {name}, which nobody declares'
        for default in takers:
            assert is_of_type(value, default), (
                f'{path.name} has {name}: {value!r}, '
                f'it must be a {type(default).__name__} such as {default!r}'
            )


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_the_values_are_allowed(path: Path) -> None:
    values = values_in(path)
    for defaults in (SimSettings(), World(), ControllerSettings()):
        with_values(defaults, values)
    with_values(CONTROLS[values.get('preset', 'default')], values)
    with_values(CROWDS[values.get('crowd.preset', 'cohesive')], values, 'crowd.')


def test_the_paper_s_setting_is_that_of_the_code() -> None:
    values = values_in(CONFIG / 'paper.yaml')
    assert with_values(CONTROLS[values['preset']], values) == PAPER
    crowd = with_values(CROWDS[values['crowd.preset']], values, 'crowd.')
    assert crowd == CROWDS['cohesive']


def test_the_reference_run_is_that_of_the_defaults() -> None:
    values = values_in(CONFIG / 'herding.yaml')
    assert with_values(World(), values) == World()
    assert with_values(Control(), values) == Control()
    assert with_values(Crowd(), values, 'crowd.') == Crowd()
    judged_at = with_values(SimSettings(), values).goal
    assert judged_at == with_values(ControllerSettings(), values).goal == SimSettings().goal


def published() -> set[str]:
    """Return what the nodes may publish, by the policy that a test holds against them."""
    policy = ElementTree.parse(CONFIG / 'sros2_policy.xml')
    found = policy.iterfind('.//topics[@publish]/topic')
    return {f'/{(each.text or "").lstrip("/")}' for each in found}


def shown(name: str) -> set[str]:
    """Return the topics that a layout shows."""
    text = (CONFIG.parent / name).read_text(encoding='utf-8')
    if name.endswith('.json'):
        panels = json.loads(text)['configById']
        paths = [path['value'].partition('.')[0] for path in panels['Plot!dogs']['paths']]
        summary = panels['DiagnosticSummary!all']['topicToRender']
        return {*panels['3D!herd']['topics'], *paths, summary}
    if name.endswith('.xml'):
        curves = [each.get('name', '') for each in ElementTree.fromstring(text).iter('curve')]
        statuses = '/diagnostics/herding_ros/(sim: herd|controller: plan)/'
        return {
            '/diagnostics' if re.match(statuses, each) else each.partition('/pose')[0]
            for each in curves
        }
    of_others = {'/goal_pose', '/map', '/map_updates'}  # where people click, and a map server's
    return set(re.findall(r'Value: (/\S+)', text)) - of_others


@pytest.mark.parametrize(
    ('name', 'least'),
    [('config/foxglove.json', 10), ('config/plotjuggler.xml', 6), ('rviz/herding.rviz', 10)],
)
def test_layouts_show_what_the_nodes_publish(name: str, least: int) -> None:
    assert len(shown(name)) >= least
    for topic in shown(name):
        assert any(fnmatch(topic, each) for each in published()), topic
