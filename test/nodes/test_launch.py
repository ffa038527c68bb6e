# SPDX-License-Identifier: Apache-2.0
"""What the launch files start; the files themselves where there is a ROS with launch."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import time
from typing import Any

from herding_ros.control.lead import lead_at
from herding_ros.control.parameters import Control
from herding_ros.model.simulation import World
from herding_ros.nodes import launch_plan
from herding_ros.nodes.launch_plan import (
    Argument,
    herd_arguments,
    LaunchPlan,
    names_in_namespace,
    plan_herd,
    plan_real_dogs,
    real_dogs_arguments,
)
from herding_ros.nodes.settings import ControllerSettings, SimSettings
import pytest

ROOT = Path(__file__).parents[2]
DECLARED: dict[str, Any] = {
    **World().flat(),
    **SimSettings().flat(),
    **Control().flat(),
    **ControllerSettings().flat(),
    'bag': '',
    'use_sim_time': False,
}
PLANS: dict[str, tuple[Callable[[], tuple[Argument, ...]], Callable[..., LaunchPlan]]] = {
    'herding': (herd_arguments, plan_herd),
    'real_dogs': (real_dogs_arguments, plan_real_dogs),
}


def plan(name: str = 'herding', **given: str) -> LaunchPlan:
    """Return what is started with the arguments given and the defaults of all others."""
    arguments, make = PLANS[name]
    words = {argument.name: argument.default for argument in arguments()}
    words['config'] = str(ROOT / 'config' / f'{name}.yaml')
    assert set(given) <= set(words)
    return make({**words, **given})


@pytest.fixture(autouse=True)
def _somewhere_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_herd_is_the_sim_the_controller_and_a_recorder_if_asked() -> None:
    assert plan().nodes == ('sim', 'controller')
    assert plan().values['wait_for'] == ''
    for yes in ('true', 'True', 'yes', 'on', '1'):
        recorded = plan(record=yes)
        assert recorded.nodes == ('sim', 'controller', 'recorder')  # which ends last
        assert recorded.values['wait_for'] == 'recorder'
    for no in ('false', 'False', 'no', 'off', '0'):
        assert plan(record=no).nodes == ('sim', 'controller')


@pytest.mark.parametrize('section', ['/**', 'recorder'])
def test_nobody_waits_for_a_recorder_that_hears_chosen_topics_alone(
    tmp_path: Path, section: str
) -> None:
    for topics, awaited in (('[/sheep]', ''), ("['']", 'recorder')):
        file = tmp_path / 'few.yaml'
        file.write_text(f'{section}:\n  ros__parameters: {{topics: {topics}}}\n')
        few = plan('real_dogs', config=str(file))
        assert few.nodes == ('controller', 'recorder')
        assert few.values['wait_for'] == awaited


def test_real_dogs_have_no_sim_and_the_time_of_the_system() -> None:
    real = plan('real_dogs', goal='[3, -1]')
    assert real.nodes == ('controller', 'recorder')
    assert real.values['use_sim_time'] is False
    assert real.values['goal'] == [3.0, -1.0]
    assert 'lead' not in real.values


def test_arguments_become_parameters_of_the_right_type_that_a_node_declares() -> None:
    all_given = plan(
        sheep='3', dogs='2', seed='7', goal='[1, 0.5]', time_limit='20', lockstep='True',
        real_time_factor='4', stop_on_arrival='true', use_sim_time='false', record='true',
    )  # fmt: skip
    values = all_given.values
    assert (values['sheep'], values['dogs'], values['seed']) == (3, 2, 7)
    assert values['goal'] == [1.0, 0.5]
    assert values['time_limit'] == 20.0
    for given in (all_given, plan(), plan('real_dogs')):
        for name, value in given.values.items():
            like = DECLARED[name]
            assert type(value) is (list if isinstance(like, tuple) else type(like)), name


def test_what_is_not_given_is_left_to_the_parameter_file() -> None:
    assert not {'sheep', 'dogs', 'seed', 'goal', 'time_limit'} & set(plan().values)


def test_the_sim_ends_with_its_run() -> None:
    assert plan().values['end_when_finished'] is True


def test_the_lead_follows_the_pace_unless_the_file_has_one(tmp_path: Path) -> None:
    assert plan(real_time_factor='8').values['lead'] == lead_at(8.0)
    for section in ('/**', 'controller', '/**/controller', '/*/controller'):
        file = tmp_path / 'lead.yaml'
        file.write_text(f'{section}:\n  ros__parameters: {{lead: 3.5}}\n')
        namespace = 'east' if '*/' in section else ''
        assert 'lead' not in plan(config=str(file), namespace=namespace).values
        assert ('lead' in plan(config=str(file), namespace='/a/b/').values) == (
            section in ('controller', '/*/controller')
        )


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        ({'config': '/no/such.yaml'}, "config must be a .* file that exists, got '/no/such.yaml'"),
        ({'sheep': 'many'}, "sheep must be an integer, got 'many'"),
        ({'time_limit': 'x'}, "time_limit must be a number, got 'x'"),
        ({'goal': '[1]'}, r"goal must be \[x, y\] in metres, got '\[1\]'"),
        ({'record': 'maybe'}, "record must be true or false, got 'maybe'"),
        ({'lockstep': ''}, "lockstep must be true or false, got ''"),
        ({'log_level': 'loud'}, "log_level must be one of debug, .*, got 'loud'"),
        ({'record': 'true', 'bag': '.'}, "bag must be a folder that does not exist, got '.'"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else '',
)
def test_bad_arguments_are_refused_before_anything_starts(
    given: dict[str, str], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        plan(**given)


@pytest.mark.parametrize('text', ['[', 'sheep: 3', '/**:\n  sheep: 3', '- 1'])
def test_bad_parameter_file_is_refused_before_anything_starts(tmp_path: Path, text: str) -> None:
    file = tmp_path / 'bad.yaml'
    file.write_text(text)
    with pytest.raises(ValueError, match='config must be a file of sections'):
        plan(config=str(file))


def test_missing_rviz_is_said_before_anything_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(package: str) -> str:
        raise launch_plan.PackageNotFoundError(package)

    monkeypatch.setattr(launch_plan, 'get_package_prefix', missing)
    assert not plan().rviz
    with pytest.raises(ValueError, match='rviz:=true needs the package rviz2'):
        plan(rviz='true')


def test_periods_that_do_not_fit_are_refused_before_anything_starts(tmp_path: Path) -> None:
    file = tmp_path / 'odd.yaml'
    file.write_text('/**/sim:\n  ros__parameters: {substeps: 5}\n')
    plan(config=str(file))
    with pytest.raises(ValueError, match=r'control_period .* must be .* 0\.05 s, got 0\.1 s'):
        plan(config=str(file), lockstep='true')


def test_periods_fit_where_they_follow_from_crowd_and_dogs(tmp_path: Path) -> None:
    """On the field of 20 m a command lasts half as long, in both nodes."""
    field = (ROOT / 'config' / 'pasture.yaml').read_text(encoding='utf-8')
    file = tmp_path / 'field.yaml'
    for more, fits in (('', True), ('dt: 0.01', False), ('horizon: {control_period: 0.05}', True)):
        file.write_text(f'{field}    {more}\n')
        if fits:
            plan(config=str(file), lockstep='true')
        else:
            with pytest.raises(ValueError, match=r'control_period .* 0\.1 s, got 0\.05 s'):
                plan(config=str(file), lockstep='true')


def test_rviz_shows_the_topics_of_its_namespace() -> None:
    names = dict(names_in_namespace(ROOT / 'rviz' / 'herding.rviz'))
    assert set(names) >= {
        '/clock',
        '/sheep',
        '/markers',
        '/herd/markers',
        '/map',
        '/goal_pose',
        '/herd/path',
        '/dog_1/path',
    }
    assert all(name == f'/{relative}' for name, relative in names.items())


@pytest.mark.parametrize('name', PLANS)
def test_launch_file_takes_the_arguments_and_starts_the_nodes(name: str) -> None:
    launch = pytest.importorskip('launch', reason='launch comes with an installed ROS only')
    pytest.importorskip('launch_ros', reason='launch_ros comes with an installed ROS only')
    spec = spec_from_file_location(name, ROOT / 'launch' / f'{name}.launch.py')
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    description = module.generate_launch_description()
    taken = {argument.name for argument in description.get_launch_arguments()}
    assert taken == {argument.name for argument in PLANS[name][0]()}
    service = launch.LaunchService(argv=[], noninteractive=True)
    context = service.context
    context.launch_configurations['log_level'] = 'loud'
    service.include_launch_description(description)
    assert service.run() == 1  # refused before anything is started


@pytest.mark.parametrize(
    ('first', 'code'), [('sleep 0.5; exit 0', 0), ('sleep 0.5; exit 3', 1)], ids=['done', 'failed']
)
def test_all_end_with_the_first_and_say_whether_it_failed(first: str, code: int) -> None:
    launch = pytest.importorskip('launch', reason='launch comes with an installed ROS only')
    pytest.importorskip('launch_ros', reason='launch_ros comes with an installed ROS only')
    from herding_ros.nodes.launching import _end_together
    from launch.actions import ExecuteProcess

    patient = 'trap "kill $!; exit 0" INT; sleep 60 & wait'
    nodes = [ExecuteProcess(cmd=['sh', '-c', does]) for does in (patient, first, patient)]
    service = launch.LaunchService(argv=[], noninteractive=True)
    service.include_launch_description(launch.LaunchDescription([*nodes, *_end_together(nodes)]))
    begun = time.monotonic()
    assert service.run() == code
    assert time.monotonic() - begun < 30.0
