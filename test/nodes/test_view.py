# SPDX-License-Identifier: Apache-2.0
"""The page of a live herd, in a real browser. It is one herd for all tests of this file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
import io
import math
from pathlib import Path
import re
import signal
import time
from types import SimpleNamespace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from herding_ros.nodes import view
from herding_ros.nodes.middleware import start_ros
import numpy as np
from PIL import Image
import psutil
import pytest
from rcl_interfaces.msg import (
    Parameter as ParameterMessage,
)
from rcl_interfaces.msg import (
    ParameterEvent,
    ParameterType,
    ParameterValue,
)
from rcl_interfaces.srv import GetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import SetBool

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BLUE, RED, BLACK = (33, 102, 172), (194, 41, 43), (0, 0, 0)


@dataclass
class Watched:
    """A live herd, the page of it, and a node of the test's own."""

    browser: Any
    peer: Any
    sim: Any
    view: Any
    statuses: list[Any]

    def shown(self, text: str) -> None:
        """Wait until the page shows a text."""
        body = self.browser.find_element('tag name', 'body')
        self.peer.spin_until(lambda: text in body.text, 10.0)

    def press(self, name: str) -> None:
        """Click on a button or a tab."""
        self.browser.find_element('xpath', f'//*[normalize-space(text())="{name}"]').click()

    def status(self, name: str) -> Any:
        """Return the next status of a name."""
        self.statuses.clear()
        found: list[Any] = []

        def look() -> bool:
            found.extend(s for m in self.statuses for s in m.status if s.name == name)
            return bool(found)

        self.peer.spin_until(look)
        return found[-1]

    def sim_says(self, message: str) -> None:
        self.peer.spin_until(lambda: self.status('sim: herd').message == message, 10.0)

    def values(self, name: str) -> dict[str, str]:
        return {pair.key: pair.value for pair in self.status(name).values}


def pixels(browser: Any, colour: tuple[int, int, int], within: float = 40.0) -> np.ndarray:
    """Return the places (n, 2), x and y, of pixels of a colour on the map, left of the panel."""
    picture = Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert('RGB')
    here = np.asarray(picture)[:, :860].astype(float)
    here[:200, :330] = 255.0  # a notice that there is no graphics card
    return np.argwhere(np.linalg.norm(here - colour, axis=-1) < within)[:, ::-1]


@pytest.fixture(scope='module')
def watched(browser: Any, start_together: Callable[[], Any]) -> Watched:
    start, peer = start_together()
    shown = start('view', browser=False)
    start('controller', dogs=2, use_sim_time=True)
    sim = start('sim', sheep=12, dogs=2, goal='[3.0, 0.0]', real_time_factor=1.0)
    shown.wait_for('the page is at')
    (url,) = re.findall(r'http://\S+', shown.log)
    browser.get(url)
    # A few: those that wait while the browser is asked for something are of the past.
    statuses = peer.listen(DiagnosticArray, '/diagnostics', 10)
    one = Watched(browser, peer, sim, shown, statuses)
    one.peer.spin_until(lambda: browser.find_elements('tag name', 'canvas'))
    one.shown('to go')
    return one


def test_page_shows_sheep_dogs_and_numbers_of_a_live_herd(watched: Watched) -> None:
    watched.peer.spin_until(lambda: len(pixels(watched.browser, BLUE)) > 100, 10.0)
    watched.peer.spin_until(lambda: len(pixels(watched.browser, RED, 90.0)) > 60, 10.0)
    watched.shown('sim: running')
    watched.shown('distance [m]')
    watched.shown('deadline margin [s]')


def test_click_moves_the_destination_to_where_it_is(watched: Watched) -> None:
    goals = watched.peer.listen(PoseStamped, 'herd/goal', LATCHED)
    watched.peer.spin_until(lambda: goals)
    watched.press('pause')
    watched.sim_says('paused')
    from selenium.webdriver import ActionChains

    canvas = watched.browser.find_element('tag name', 'canvas')
    at = canvas.rect['x'] + canvas.rect['width'] / 2, canvas.rect['y'] + canvas.rect['height'] / 2
    move = ActionChains(watched.browser).move_to_element_with_offset(canvas, 60, 80)
    count = len(goals)
    move.click().perform()
    watched.peer.spin_until(lambda: len(goals) > count, 10.0)
    watched.press('go on')
    watched.sim_says('running')
    there = np.add(at, [60, 80])

    def crossed() -> bool:
        """Whether there is a black cross around the place of the click."""
        near = np.linalg.norm(pixels(watched.browser, BLACK) - there, axis=-1) < 15.0
        return bool(near.sum() > 20)

    watched.peer.spin_until(crossed, 10.0)


def test_value_in_force_is_shown_and_a_refused_one_with_the_reason(watched: Watched) -> None:
    from selenium.webdriver import Keys

    watched.press('parameters')
    watched.shown('crowd.noise')

    def field(name: str) -> Any:
        return watched.browser.find_element(
            'xpath', f'//label[contains(., "{name}")]/following::input[not(@type="hidden")]'
        )

    def write(name: str, value: str) -> None:
        field(name).send_keys(Keys.CONTROL, 'a')
        field(name).send_keys(value, Keys.ENTER)

    write('crowd.noise', '0.02')
    for node in ('sim', 'controller'):
        request = GetParameters.Request(names=['crowd.noise'])
        watched.peer.spin_until(
            lambda node=node, request=request: watched.peer.call(
                GetParameters, f'{node}/get_parameters', request
            ).values[0].double_value == 0.02,
            10.0,
        )  # fmt: skip
    write('max_speed', '0')
    watched.shown('controller refused max_speed = 0')
    watched.shown('must be')
    watched.peer.spin_until(lambda: float(field('max_speed').get_attribute('value')) == 0.05, 10.0)


def test_reset_begins_anew(watched: Watched) -> None:
    before = float(watched.values('sim: herd')['time_s'])
    watched.press('reset')
    watched.peer.spin_until(lambda: float(watched.values('sim: herd')['time_s']) < before, 10.0)


def test_view_that_has_been_answered_asks_no_more(watched: Watched) -> None:
    """Each client that comes or goes is made known to all nodes, which takes their time."""
    counts: list[int] = []

    def is_over(end: float = time.monotonic() + 2.0) -> bool:
        counts.append(watched.peer.node.count_clients('/sim/list_parameters'))
        return time.monotonic() > end

    watched.peer.spin_until(is_over)
    assert set(counts) == {0}


def test_browser_has_nothing_to_complain_of(watched: Watched) -> None:
    severe = [each for each in watched.browser.get_log('browser') if each['level'] == 'SEVERE']
    assert severe == []


def test_closing_it_disturbs_nobody(watched: Watched) -> None:
    """Neither a browser that leaves nor a view that is killed."""
    watched.browser.get('about:blank')
    watched.peer.spin_until(lambda: watched.values('view: page')['browsers'] == '0', 10.0)
    assert watched.view.end(signal.SIGKILL) == -signal.SIGKILL
    before = watched.values('sim: herd')
    begun = time.monotonic()
    watched.peer.spin_for(2.0)
    after = watched.values('sim: herd')
    passed, took = float(after['time_s']) - float(before['time_s']), time.monotonic() - begun
    assert passed == pytest.approx(took, abs=0.8)
    assert after['periods_skipped'] == before['periods_skipped']


def test_recorded_run_is_played(
    browser: Any, start: Callable[..., Any], tmp_path: Path, run_recorder: Any, wait_until: Any
) -> None:
    with run_recorder(tmp_path / 'bag') as recorder:
        for k in range(100):
            ns, along = k * 10**9, 0.02 * k
            sheep = [(along + 0.1 * i, 0.1 * j) for i in range(4) for j in range(4)]
            recorder.sheep('/truth/sheep', ns, sheep, np.zeros((16, 2)))
            recorder.odometry('/truth/dog_1/odom', ns, (along - 0.3, 0.0))
            recorder.log_ns += 10**9
            recorder.publish_ns += 10**9
        recorder.goal(0, (2.5, 0.0), '/herd/goal')
    process = start('view', str(tmp_path / 'bag'), browser=False)
    process.wait_for('the page is at')
    (url,) = re.findall(r'http://\S+', process.log)
    browser.get(url)

    def second() -> float:
        found = re.search(r't ([\d.]+) of 99\.0 s', browser.find_element('tag name', 'body').text)
        return float(found[1]) if found else -1.0

    wait_until(lambda: second() > 0.0 and len(pixels(browser, BLUE)) > 100)
    first = second(), pixels(browser, BLUE)[:, 0].mean()
    wait_until(lambda: second() > first[0] + 8.0)
    assert pixels(browser, BLUE)[:, 0].mean() > first[1] + 10.0
    browser.get('about:blank')
    process.ends_in_time(signal.SIGINT)


def test_herd_with_a_view_goes_on_until_it_is_told_to_end(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    options = ['--sheep', '5', '--dogs', '2', '--time-limit', '1', '-p', 'browser:=false']
    process = start('herd', '--view', *options, '--out', str(tmp_path / 'out'))
    process.wait_for('click on another destination')
    assert re.search(r'watch it at http://127\.0\.0\.1:\d+\n', process.log)
    children = psutil.Process(process.process.pid).children()
    assert len(children) == 4
    assert process.end() == 1  # the flock did not arrive
    assert psutil.wait_procs(children, timeout=5.0)[1] == []
    assert (tmp_path / 'out' / 'replay.html').exists()


@pytest.mark.slow  # the same as above, but for how the view ends
def test_run_goes_on_without_a_view_that_died(start: Callable[..., Any], tmp_path: Path) -> None:
    options = ['--sheep', '5', '--dogs', '2', '--time-limit', '5', '-p', 'browser:=false']
    process = start('herd', '--view', *options, '--out', str(tmp_path / 'out'))
    process.wait_for('watch it at')
    children = psutil.Process(process.process.pid).children()
    (view,) = [each for each in children if 'herding_ros.nodes.view' in each.cmdline()]
    view.kill()
    assert process.wait() == 1
    assert 'the view died (exit code -9); the run goes on' in process.log


def test_bag_that_is_none_is_refused_in_a_word(start: Callable[..., Any], tmp_path: Any) -> None:
    process = start('view', str(tmp_path / 'nothing'))
    assert process.wait() == 2
    assert 'cannot start' in process.log
    assert 'Traceback' not in process.log


class Looking:
    """A view without a process or a browser, which looks only when it is told to."""

    def __init__(self, domain: int) -> None:
        start_ros(['--ros-args', '-p', 'browser:=false'], domain_id=domain)
        self.view = view.View()
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.view)

    def look_until(self, condition: Callable[[], object], peer: Any) -> None:
        def look() -> object:
            self._executor.spin_once(timeout_sec=0.01)
            return condition()

        peer.spin_until(look, 20.0)

    def value(self, name: str) -> Any:
        return self.view._values.get('sim', {}).get(name)


@pytest.fixture
def looking(domain: int) -> Iterator[Looking]:
    one = Looking(domain)
    yield one
    one.view.destroy_node()
    rclpy.shutdown()


def test_node_that_comes_again_between_two_looks_has_its_new_values_shown(
    looking: Looking, peer: Any
) -> None:
    def begin(noise: float) -> Any:
        sim = rclpy.create_node('sim', context=peer.node.context)
        sim.declare_parameter('crowd.noise', noise)
        peer.add(sim)
        return sim

    def lives() -> list[bytes]:
        found = looking.view.get_publishers_info_by_topic('/parameter_events')
        return [bytes(each.endpoint_gid) for each in found if each.node_name == 'sim']

    sim = begin(0.01)
    looking.look_until(lambda: looking.value('crowd.noise') == 0.01, peer)
    (first,) = lives()
    sim.destroy_node()
    begin(0.02)
    peer.spin_until(lambda: len(lives()) == 1 and first not in lives())
    looking.look_until(lambda: looking.value('crowd.noise') == 0.02, peer)


def test_strangers_neither_end_a_view_nor_fill_it(looking: Looking, peer: Any) -> None:
    """All herds and drivers share a topic of statuses, and one of parameter events."""
    sim = rclpy.create_node('sim', context=peer.node.context)
    odd = {'field': 7, 'arrival.radius': 'near', 'crowd.noise': 0.01}
    for name, value in odd.items():
        sim.declare_parameter(name, value)
    peer.add(sim)
    looking.look_until(lambda: looking.value('crowd.noise') == 0.01, peer)
    statuses = peer.talk_to(DiagnosticArray, '/diagnostics')
    events = peer.talk_to(ParameterEvent, '/parameter_events')
    soon = [KeyValue(key='solve_ms', value='soon')]
    odd_values = (
        ParameterValue(type=ParameterType.PARAMETER_STRING, string_value='much'),
        ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=math.nan),
        ParameterValue(type=200),
    )
    changes = [ParameterMessage(name='crowd.noise', value=value) for value in odd_values]
    for k in range(200):
        number = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=0.02)
        new = ParameterMessage(name=f'new_{k}', value=number)
        newest = ParameterMessage(name='crowd.noise', value=number)
        events.publish(ParameterEvent(node='/sim', changed_parameters=[newest, *changes, new]))
        named = [DiagnosticStatus(name=f'driver_{k}'), DiagnosticStatus(name='sim: herd')]
        named[1].message = f'{k}'
        named.append(DiagnosticStatus(name='controller: plan', values=soon))
        statuses.publish(DiagnosticArray(status=named))
    looking.look_until(lambda: looking.view._statuses['sim: herd'][0] == '199', peer)
    looking.look_until(lambda: looking.value('crowd.noise') == 0.02, peer)
    assert len(looking.view._statuses) <= 3
    assert not [name for name in looking.view._values['sim'] if name.startswith('new_')]


def test_status_of_a_sim_that_has_gone_goes(
    looking: Looking, peer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    statuses = peer.talk_to(DiagnosticArray, '/diagnostics')
    looking.view._herd.ns = 1
    both = [DiagnosticStatus(name=name, message='busy') for name in (view._SIM, view._CONTROLLER)]
    statuses.publish(DiagnosticArray(status=both))
    looking.look_until(lambda: 'controller: busy' in looking.view._in_words(), peer)
    assert 'sim: busy' in looking.view._in_words()
    later = time.monotonic() + 2.0 * view._STATUS_LASTS
    monkeypatch.setattr(view, 'time', SimpleNamespace(monotonic=lambda: later))
    assert 'busy' not in looking.view._in_words()


def test_sim_that_does_not_answer_is_not_waited_for(
    looking: Looking, peer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    hanging = rclpy.create_node('sim', context=peer.node.context)  # nobody spins it
    hanging.create_service(SetBool, 'sim/pause', lambda _, response: response)
    pauses, refused = looking.view._pauses, list[str]()
    looking.look_until(pauses.service_is_ready, peer)
    monkeypatch.setattr(looking.view._panel, 'refuse', refused.append)
    looking.view._pause(True)
    looking.look_until(lambda: refused, peer)
    assert refused == ['no answer: the sim may be as it was']
    assert not pauses._pending_requests
    hanging.destroy_node()


def test_value_below_nothing_has_a_slider_that_reaches_it(looking: Looking, peer: Any) -> None:
    sim = rclpy.create_node('sim', context=peer.node.context)
    sim.declare_parameter('crowd.noise_field.patch', -0.5)
    peer.add(sim)
    looking.look_until(lambda: looking.value('crowd.noise_field.patch') == -0.5, peer)
    (tunable,) = view._tunables(looking.view._values['sim']).values()
    assert tunable.lowest == -1.0


def test_limits_of_speed_are_not_raised_by_a_slider() -> None:
    values = {'max_speed': 0.05, 'crowd.noise': 0.01, 'crowd.friction': 0.5, 'sheep': 30}
    found = view._tunables(values)
    assert {name: each.highest for name, each in found.items()} == {
        'max_speed': 0.05, 'crowd.noise': 0.04,
    }  # fmt: skip
