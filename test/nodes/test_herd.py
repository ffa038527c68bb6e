# SPDX-License-Identifier: Apache-2.0
"""The whole system: three processes, real DDS, a bag, against the same loop without ROS."""

from __future__ import annotations

from collections.abc import Callable
import json
import os
from pathlib import Path
import re
import signal
import time
from typing import Any
from xml.etree import ElementTree

from herding_ros.control.closed_loop import as_policy, closed_loop, play
from herding_ros.control.excitation import ExcitingPilot
from herding_ros.control.parameters import Control, Horizon
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.fit import recording
from herding_ros.fit.estimate import fit
from herding_ros.model import fast_forces
from herding_ros.model.crowd import Crowd
from herding_ros.model.flock import Arrival, arrived, spread
from herding_ros.model.potentials import Morse
from herding_ros.model.simulation import Simulation, World
from herding_ros.nodes import herd
from herding_ros.nodes.signals import ENDING, note_signals
from herding_ros.nodes.sim import SimSettings
from herding_ros.nodes.start import read_start
import numpy as np
import psutil
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores
from trajectory_msgs.msg import MultiDOFJointTrajectory

NEXT = (
    ('look at', 'trajectories.png'),
    ('open in a browser:', 'replay.html'),
    ('draw again: report', 'bag'),
)
LAYOUT = Path(__file__).resolve().parents[2] / 'config' / 'plotjuggler.xml'
SHEEP, DOGS, SEED, GOAL = 10, 3, 2, (0.4, 0.2)
LARGE = 1600
EXCITED = 25.0
RESPONSE = ('dog.repulsion', 'dog.repulsion_length', 'friction', 'noise')
OF_RCLPY = ('/rosout', '/parameter_events')
OPTIONS = ['--sheep', '10', '--dogs', '3', '--seed', '2', '--goal', '0.4', '0.2']


def read(bag: Path) -> dict[str, list[Any]]:
    """Every message of a bag by topic, read by somebody else's reader."""
    out: dict[str, list[Any]] = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection in reader.connections:
            out[connection.topic] = []
        for connection, _, raw in reader.messages():
            out[connection.topic].append(reader.deserialize(raw, connection.msgtype))
        assert {t: info.msgcount for t, info in reader.topics.items()} == {
            t: len(found) for t, found in out.items()
        }
    return out


def raw(bag: Path) -> dict[str, list[bytes]]:
    """The bytes of every message by topic, but for what rclpy itself publishes."""
    out: dict[str, list[bytes]] = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, data in reader.messages():
            if connection.topic not in OF_RCLPY:
                out.setdefault(connection.topic, []).append(bytes(data))
                message = reader.deserialize(data, connection.msgtype)
                again = bytes(reader.typestore.serialize_cdr(message, connection.msgtype))
                again += bytes(-len(again) % 4)
                assert again == data, f'{connection.topic} has memory between its fields'
    return out


def positions(cloud: Any) -> np.ndarray:
    """What a point cloud says of x and y, by its own field table."""
    offsets = {field.name: field.offset for field in cloud.fields}
    rows = cloud.data.reshape(-1, cloud.point_step)
    columns = [rows[:, offsets[name] : offsets[name] + 4].copy() for name in ('x', 'y')]
    return np.concatenate([column.view('<f4') for column in columns], axis=1)


def plotted() -> set[str]:
    """The names by which the layout for PlotJuggler asks for numbers of statuses."""
    curves = ElementTree.parse(LAYOUT).iter('curve')
    return {name for each in curves if (name := each.get('name', '')).startswith('/diagnostics/')}


def published(log: Path) -> dict[str, int]:
    """What a node said it had published."""
    return {topic: int(n) for n, topic in re.findall(r'(\d+) on (/[\w/]+)', log.read_text())}


def test_lockstep_is_the_loop_without_ros_bit_for_bit(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    expected = closed_loop(
        Crowd(), World(sheep=SHEEP, dogs=DOGS, seed=SEED), Control(), np.array(GOAL), 400.0
    )
    assert expected.arrived
    out = tmp_path / 'out'
    process = start('herd', *OPTIONS, '--out', str(out))
    assert process.wait() == 0
    folder = min(os.path.relpath(out), str(out), key=len)
    assert all(f'{what} {folder}/{name}' in process.log for what, name in NEXT)
    assert process.log.endswith(f'another flock: --seed {SEED + 1}\n')
    messages = read(out / 'bag')
    x = np.array([positions(cloud) for cloud in messages['/truth/sheep']])
    assert np.array_equal(x, expected.x.astype(np.float32))
    places = [message.pose.pose.position for message in messages['/truth/dog_2/odom']]
    assert np.array_equal([[p.x, p.y] for p in places], expected.d[:, 1])
    again = read_start(out / 'bag', 2.02)
    assert np.array_equal(again.x, expected.x[20].astype(np.float32))
    assert np.array_equal(again.d, expected.d[20])
    # The sim stands still at the goal, so the answer to the last state is not played.
    orders = [message.twist.linear for message in messages['/dog_3/cmd_vel']]
    assert np.array_equal([[o.x, o.y] for o in orders[: len(expected.u)]], expected.u[:, 2])

    for node in ('sim', 'controller'):
        counts = published(out / 'log' / f'{node}.log')
        assert counts
        assert '/diagnostics' in counts
        del counts['/diagnostics']  # is shared by the nodes
        assert counts == {topic: len(messages[topic]) for topic in counts}

    statuses = [status for message in messages['/diagnostics'] for status in message.status]
    assert plotted() <= {  # PlotJuggler puts the hardware in front
        f'/diagnostics/{status.hardware_id}/{status.name}/{value.key}'
        for status in statuses
        for value in status.values
    }

    summary = json.loads((out / 'summary.json').read_text())
    assert summary['arrived'] is True
    assert summary['time_s'] == pytest.approx(expected.t[-1])
    assert summary['seed'] == SEED
    assert summary['replans'] == len(expected.reports)
    assert summary['messages_recorded'] == sum(len(found) for found in messages.values())
    assert summary['max_spread_m'] == pytest.approx(spread(expected.x).max(), rel=1e-6)
    at_first = float(spread(x[0].astype(float)))
    assert arrived(x[-1].astype(float), np.array(GOAL), at_first, Arrival())
    assert (out / 'trajectories.png').read_bytes().startswith(b'\x89PNG')

    # Other processes with the same seed send the same bytes, but for what they say of wall time.
    other = tmp_path / 'other'
    start('herd', *OPTIONS, '--time-limit', '2', '--out', str(other)).wait()
    long, short = raw(out / 'bag'), raw(other / 'bag')
    assert long.keys() == short.keys()
    assert len(short['/truth/sheep']) == 21
    for topic in short.keys() - {'/diagnostics'}:
        assert short[topic] == long[topic][: len(short[topic])], topic


def test_dogs_run_to_and_fro_for_a_recording_that_tells_how_sheep_respond(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    """As in the loop without ROS; the run ends by itself, and of its bag `fit` makes the truth."""
    crowd, world = Crowd(), World(sheep=20, dogs=5, seed=SEED)
    pilot = ExcitingPilot(RecedingHorizon(crowd, Control(), np.array(GOAL), SEED), world.dogs)
    field = Simulation(crowd, world, np.array(GOAL))
    expected = play(field, as_policy(pilot, []), EXCITED, stop=False)
    out = tmp_path / 'out'
    options = [*OPTIONS, '--sheep', '20', '--dogs', '5', '--excite', '--time-limit', str(EXCITED)]
    process = start('herd', *options, '--out', str(out))
    assert process.wait() == 0, process.log
    x = np.array([positions(cloud) for cloud in read(out / 'bag')['/truth/sheep']])
    assert np.array_equal(x, expected.x.astype(np.float32))
    assert f'ros2 run herding_ros fit {out}/bag' in process.log

    found = fit([recording.read(out / 'bag')], Crowd(dog=Morse(2e-2, 0.25, 5e-4, 2.0)))
    true = crowd.flat('crowd.')
    told = {e.name: e for e in found.estimates if e.is_told and e.name in true}
    assert told.keys() >= {f'crowd.{name}' for name in RESPONSE}
    assert {
        e.name: (e.low, e.high) for e in told.values() if not e.low < true[e.name] < e.high
    } == {}


def test_chosen_topics_alone_are_recorded(start: Callable[..., Any], tmp_path: Path) -> None:
    """And nobody waits for the recorder to hear the others."""
    chosen = ['/truth/sheep', '/dog_1/cmd_vel']
    options = [*OPTIONS, '-p', f'topics:={chosen}', '--time-limit', '1']
    process = start('herd', *options, '--out', str(tmp_path / 'out'))
    assert process.wait() == 1, process.log  # time ran out
    assert read(tmp_path / 'out' / 'bag').keys() == {*chosen, '/clock'}
    assert (tmp_path / 'out' / 'trajectories.png').exists()


def test_large_flock_is_herded_as_in_the_loop_without_ros(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    """Its clouds, its forces by a mesh, its mean-field limit, the density in the picture."""
    control = Control(horizon=Horizon(length=4.0, accepted=2.0))  # long windows take long
    expected = closed_loop(
        Crowd(), World(sheep=LARGE, dogs=DOGS, seed=SEED), control, np.array(GOAL), 1.0
    )
    assert max(fast_forces.CROSSOVER, 2 * control.coarse.markers) < LARGE
    options = [*OPTIONS, '--sheep', str(LARGE)]  # the last one counts
    options += ['-p', 'horizon.length:=4.0', '-p', 'horizon.accepted:=2.0']
    out = tmp_path / 'out'
    process = start('herd', *options, '--time-limit', '1', '--out', str(out))
    assert process.wait() == 1, process.log  # time ran out
    assert 'why flocks do not arrive: doc/troubleshooting.md' in process.log
    messages = read(out / 'bag')
    x = np.array([positions(cloud) for cloud in messages['/truth/sheep']])
    assert np.array_equal(x, expected.x.astype(np.float32))
    assert len(messages['/sheep']) == 11
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['sheep'] == LARGE
    assert summary['arrived'] is False
    assert (out / 'trajectories.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.slow
def test_nodes_that_start_together_find_each_other_at_once(
    start: Callable[..., Any], peer: Any, tmp_path: Path
) -> None:
    """From the moment all are there, with kernels ready, to the first plan: no lost seconds.

    In two of three rounds at least: other work on the machine may delay one.
    """
    took = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    plans = peer.listen(MultiDOFJointTrajectory, 'plan', latched)
    for k in range(3):
        plans.clear()
        nodes = [start('recorder', bag=tmp_path / f'bag_{k}')]
        nodes += [
            start(name, lockstep=True, wait_for='recorder') for name in ('controller', 'sim')
        ]
        nodes[1].wait_for('kernels loaded')
        nodes[2].wait_for('kernels loaded')
        begun = time.monotonic()
        peer.spin_until(lambda: plans)
        took.append(time.monotonic() - begun)
        nodes[1].wait_for('ready')
        for node in nodes:
            node.end()
    assert sorted(took)[1] < 2.5


@pytest.mark.slow
def test_real_time_arrives_too(start: Callable[..., Any], tmp_path: Path) -> None:
    many = ['--sheep', '20', '--dogs', '5']
    process = start('herd', *OPTIONS, *many, '--real-time', '10', '--out', str(tmp_path / 'out'))
    assert process.wait() == 0
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['real_time_factor'] <= 10.5


@pytest.mark.parametrize(
    'arguments',
    [
        ['--sheep', '0'],
        ['--dogs', 'two'],
        ['--sigma', 'nan'],
        ['--goal', '1'],
        ['--goal', 'inf', '0'],
        ['--seed', '-1'],
        ['--time-limit', '0'],
        ['--real-time', '-3'],
        ['--real-time', '5000'],
        ['--dogs', '1001'],
        ['--sigma', '1e150'],
        ['--strays', '30'],
        ['--strays', '2', '--sheep', '2'],
        ['--nonsense'],
    ],
)
def test_bad_arguments_are_refused(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match='2'):
        herd.main([*arguments, '--out', str(tmp_path / 'out')])
    assert arguments[0] in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


def test_herd_takes_just_what_its_nodes_take() -> None:
    """So what it lets pass starts all of them."""
    fields = {
        entry.name: entry.field.metadata
        for each in (World(), SimSettings(), Crowd())
        for entry in each.walk()
    }
    for option, name in {
        'sheep': 'sheep', 'dogs': 'dogs', 'sigma': 'noise', 'goal': 'goal',
        'time-limit': 'time_limit', 'real-time': 'real_time_factor', 'strays': 'arrival.strays',
    }.items():  # fmt: skip
        high = fields[name]['high']
        given = [f'--{option}', str(high), *([str(-high)] if option == 'goal' else [])]
        assert herd._parser().parse_args(given)
        given[1] = str(high + 1)
        with pytest.raises(SystemExit, match='2'):
            herd._parser().parse_args(given)


def test_existing_bag_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'precious').write_text('data')
    assert herd.main(['--out', str(tmp_path)]) == 2
    assert [path.name for path in (tmp_path / 'bag').iterdir()] == ['precious']


def test_runs_that_begin_in_the_same_second_have_a_folder_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(herd.time, 'strftime', lambda _: 'now')
    out = []
    monkeypatch.setattr(herd, '_run', lambda options, *_: out.append(options.out) or 0)
    for _ in range(3):
        assert herd.main([]) == 0
    assert [path.relative_to(tmp_path / 'runs').name for path in out] == ['now', 'now_2', 'now_3']


def test_interrupt_ends_all_children_and_leaves_a_valid_bag(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    """The interrupt is that of a terminal that is closed."""
    out = tmp_path / 'out'
    process = start('herd', *OPTIONS, '--real-time', '2', '--out', str(out))
    process.wait_for('to go')
    children = psutil.Process(process.process.pid).children()
    assert len(children) == 3
    assert process.end(signal.SIGHUP) == 130
    assert psutil.wait_procs(children, timeout=5.0)[1] == []
    messages = read(out / 'bag')
    assert len(messages['/truth/sheep']) > 0
    assert published(out / 'log' / 'sim.log')['/truth/sheep'] == len(messages['/truth/sheep'])


def test_killed_herd_leaves_no_child_and_a_valid_bag(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    """In a folder whose name means something to YAML."""
    out = tmp_path / 'run #1: "a", é'
    process = start('herd', *OPTIONS, '--real-time', '2', '--out', str(out))
    process.wait_for('to go')
    children = psutil.Process(process.process.pid).children()
    assert process.end(signal.SIGKILL) == -signal.SIGKILL
    assert psutil.wait_procs(children, timeout=5.0)[1] == []
    assert len(read(out / 'bag')['/truth/sheep']) > 0


def test_every_signal_that_asks_to_end_is_noted() -> None:
    """Except a hang-up that is to be ignored, as below nohup."""
    before = {number: signal.getsignal(number) for number in ENDING}
    try:
        for number in ENDING:
            noted = note_signals()
            signal.raise_signal(number)
            assert noted.is_set()
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        noted = note_signals()
        signal.raise_signal(signal.SIGHUP)
        assert not noted.is_set()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_dead_child_is_named_with_its_last_words(
    start: Callable[..., Any], wait_until: Callable[..., None], tmp_path: Path
) -> None:
    process = start('herd', *OPTIONS, '--real-time', '2', '--out', str(tmp_path / 'out'))
    process.wait_for('to go')
    wait_until(lambda: 'ready to herd' in (tmp_path / 'out/log/controller.log').read_text())
    children = psutil.Process(process.process.pid).children()
    controller = next(c for c in children if 'herding_ros.nodes.controller' in c.cmdline())
    controller.kill()
    assert process.wait() == 3
    assert 'controller died (exit code -9)' in process.log
    assert 'ready to herd' in process.log
    assert psutil.wait_procs(children, timeout=5.0)[1] == []
    assert len(read(tmp_path / 'out' / 'bag')['/truth/sheep']) > 0


def test_dead_recorder_is_named_though_its_bag_is_not_closed(
    start: Callable[..., Any], tmp_path: Path
) -> None:
    process = start('herd', *OPTIONS, '--real-time', '2', '--out', str(tmp_path / 'out'))
    process.wait_for('to go')
    children = psutil.Process(process.process.pid).children()
    next(c for c in children if 'herding_ros.nodes.recorder' in c.cmdline()).kill()
    assert process.wait() == 3
    assert 'recorder died (exit code -9)' in process.log
    assert 'no report' in process.log
    assert 'Traceback' not in process.log
    assert psutil.wait_procs(children, timeout=5.0)[1] == []


def values_of(*arguments: str) -> dict[str, dict[str, Any]]:
    return herd._values(herd._parser().parse_args(arguments))


def test_a_field_brings_its_destination_and_parameters() -> None:
    values = values_of('--field', 'pen')
    for node in ('sim', 'controller'):
        assert values[node]['field'] == 'pen'
        assert values[node]['goal'] == (2.8, 0.0)
    assert values['sim']['sheep'] == 20
    assert values_of('--field', 'pen', '--sheep', '7')['sim']['sheep'] == 7
    assert values_of('--field', 'meadow')['controller']['motion.kind'] == 'unicycle'
    with pytest.raises(ValueError, match='goal must not be given with a field that has one'):
        values_of('--field', 'pen', '--goal', '1', '1')
    with pytest.raises(ValueError, match=r'field must be corner, .* got no_such_field'):
        values_of('--field', 'no_such_field')
