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
from herding_ros.nodes import messages
from herding_ros.nodes.drawing import Drawing
from herding_ros.nodes.settings import (
    ControllerSettings,
    ControlPreset,
    CrowdPreset,
    MotionKind,
    SimSettings,
)
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker
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


def panels_of_foxglove() -> dict[str, Any]:
    """Return what its layout says of each panel."""
    panels: dict[str, Any] = json.loads((CONFIG / 'foxglove.json').read_text(encoding='utf-8'))
    return panels['configById']


def shown(name: str) -> set[str]:
    """Return the topics that a layout shows."""
    text = (CONFIG.parent / name).read_text(encoding='utf-8')
    if name.endswith('.json'):
        panels = panels_of_foxglove()
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


def test_foxglove_draws_sheep_and_dogs_in_colours_of_their_own() -> None:
    """Where no field is named it takes z, and the colours of a map instead of those told."""
    topics = panels_of_foxglove()['3D!herd']['topics']
    told = [topics['/truth/sheep'], topics['/truth/dogs']]
    one = np.zeros((1, 2))
    cloud = deserialize_message(messages.cloud(one, one, 0, 'map'), PointCloud2)
    assert {each['colorField'] for each in told} <= {field.name for field in cloud.fields}
    assert [each['colorMode'] for each in told] == ['flat', 'flat']
    assert told[0]['flatColor'] != told[1]['flatColor']


def test_foxglove_shows_dogs_and_not_balls_around_them() -> None:
    """What RViz draws as pale discs are opaque balls there, and the dogs are inside."""
    nothing = np.zeros((0, 2))
    drawn = messages.drawing(
        Drawing(nothing, nothing, np.zeros((1, 2)), 0.1, nothing.reshape(0, 3, 2), 0.01), 0, 'map'
    )
    balls = {each.ns for each in drawn.markers if each.type == Marker.SPHERE_LIST}
    spaces = panels_of_foxglove()['3D!herd']['topics']['/herd/markers']['namespaces']
    assert balls
    assert {name for name, told in spaces.items() if not told['visible']} == balls


def test_foxglove_shows_the_titles_of_plots() -> None:
    """It does not read `title`, and its fork Lichtblick has a name of its own for them."""
    plots = [v for k, v in panels_of_foxglove().items() if k.startswith('Plot!')]
    assert plots
    for plot in plots:
        assert 'title' not in plot
        assert plot['foxglovePanelTitle'] == plot['lichtblickPanelTitle'] != ''
