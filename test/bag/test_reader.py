# SPDX-License-Identifier: Apache-2.0
"""Bags read back into the arrays they were made of, whatever is missing or odd in them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
import random
import shutil
from typing import Any

from herding_ros.bag import reader
from herding_ros.bag.reader import read_run
from herding_ros.bag.writer import BagWriter
from herding_ros.point_cloud import points
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

PERIOD_NS = 100_000_000
PARAMETERS = {'/controller': {'goal': [0.5, -0.25]}, '/sim': {'seed': 3}}
T, N, M = 30, 4, 2


@pytest.fixture
def arrays() -> dict[str, Any]:
    """States with values that single floats hold exactly."""
    generator = np.random.default_rng(0)

    def exact(*shape: int) -> Any:
        return generator.integers(-512, 512, shape) / 256.0

    return {'x': exact(T, N, 2), 'v': exact(T, N, 2), 'd': exact(T, M, 2), 'u': exact(T, M, 2)}


def write(
    recorder: Any, arrays: dict[str, Any], prefix: str = '/truth', first_ns: int = 0
) -> None:
    """What the nodes publish, ten states a second, twice as fast as in reality."""
    for k in range(T):
        ns = first_ns + k * PERIOD_NS
        recorder.sheep(f'{prefix}/sheep', ns, arrays['x'][k], arrays['v'][k])
        for m in range(M):
            recorder.odometry(f'{prefix}/dog_{m + 1}/odom', ns, arrays['d'][k, m])
            recorder.command(f'/dog_{m + 1}/cmd_vel', ns, arrays['u'][k, m])
        recorder.log_ns += PERIOD_NS
        recorder.publish_ns += PERIOD_NS // 2


def test_walls_come_back_with_the_time_since_when_the_controller_has_known_them(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    """Drawings that say the same count once; one in another frame is left out."""
    walls = [(0.0, 0.5), (1.0, 0.5), (1.0, 0.5), (1.0, 2.0)]
    drawings = [(1.0, 'map', []), (1.5, 'map', walls), (2.0, 'map', walls), (2.1, 'odom', [])]
    with run_recorder(tmp_path / 'bag') as recorder:
        write(recorder, arrays)
        for start, frame, points in drawings:
            recorder.markers('/herd/markers', round(start * 1e9), {'walls': points}, frame)
    run = read_run(tmp_path / 'bag')
    ((since, found),) = run.surroundings
    assert since == 1.5
    assert found.walls.tolist() == [[[0.0, 0.5], [1.0, 0.5]], [[1.0, 0.5], [1.0, 2.0]]]
    assert run.surroundings_at(1.4).walls.shape == (0, 2, 2)
    assert run.surroundings_at(9.0) is found
    assert any('/herd/markers' in note and 'odom' in note for note in run.notes)


def test_plans_come_back_with_the_time_at_which_they_begin(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    """They are announced before, and not in the order in which they begin."""
    starts = (1.2, 2.5, 1.4)

    def trajectory(recorder: Any, start: float, x: float, names: list[str]) -> Any:
        def at(value: float) -> Any:
            vector = recorder.make('geometry_msgs/Vector3', x=value, y=0.0, z=0.0)
            turn = recorder.make('geometry_msgs/Quaternion', x=0.0, y=0.0, z=0.0, w=1.0)
            return recorder.make('geometry_msgs/Transform', translation=vector, rotation=turn)

        later = recorder.make('builtin_interfaces/Duration', sec=0, nanosec=500_000_000)
        here = recorder.make('builtin_interfaces/Duration', sec=0, nanosec=0)
        return recorder.make(
            'trajectory_msgs/MultiDOFJointTrajectory',
            header=recorder.header(round(start * 1e9)),
            joint_names=names,
            points=[
                recorder.make(
                    'trajectory_msgs/MultiDOFJointTrajectoryPoint',
                    transforms=[at(x + k) for _ in names],
                    velocities=[recorder.twist((2.0, 0.0)) for _ in names],
                    accelerations=[],
                    time_from_start=when,
                )
                for k, when in enumerate((here, later))
            ],
        )

    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
        for k, start in enumerate(starts):
            recorder.write('/plan', trajectory(recorder, start, float(k), ['dog_2']))
            header = recorder.header(round(start * 1e9))
            pose = recorder.make(
                'geometry_msgs/PoseStamped', header=header, pose=recorder.pose((k, -k))
            )
            recorder.write(
                '/herd/path', recorder.make('nav_msgs/Path', header=header, poses=[pose])
            )
        recorder.write('/plan', trajectory(recorder, 0.0, float('nan'), ['dog_1']))
        for ns, at in ((0, (1.0, 2.0)), (10**9, (3.0, 4.0))):
            recorder.goal(ns, at, '/herd/goal')
    run = read_run(tmp_path / 'bag')
    begun = [plan.times - plan.times[0] for plan in run.plans]
    assert [plan.times[0] for plan in run.plans] == pytest.approx(starts)
    assert np.allclose(begun, [0.0, 0.5, 1.0])
    assert np.isnan(run.plans[1].points[:, 0]).all()  # dog 1 is in none of them
    # The last point goes on with its velocity for as long as the one before.
    assert run.plans[1].points[:, 1, 0].tolist() == [1.0, 2.0, 3.0]
    assert [route.points.tolist() for route in run.expected] == [[[k, -k]] for k in range(3)]
    assert [run.goal_at(t).tolist() for t in (0.5, 1.5)] == [[1.0, 2.0], [3.0, 4.0]]
    assert any('/plan' in note and 'finite' in note for note in run.notes)


def test_arrays_come_back(tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
        recorder.diagnostics('recorder: bag', 10**18, replan=9)
        recorder.diagnostics(
            'controller: plan', 0, replan=0, solve_ms=12.5, status='converged', objective=0.25,
            gradient_norm='1e-3', optimiser_iterations=20, optimiser_calls=31,
            mapping_iterations=2, mapping_error_before=0.5, mapping_error_after=0.125,
            deadline_margin_s=1.5, other='thing',
        )  # fmt: skip
        recorder.diagnostics('controller: plan', PERIOD_NS, replan=1, solve_ms=20, kind='feedback')
        recorder.diagnostics('controller: plan', 2 * PERIOD_NS, replan=1, solve_ms=99)
    run = read_run(tmp_path / 'bag')
    np.testing.assert_allclose(run.times, 0.1 * np.arange(T), rtol=0, atol=1e-12)
    for mine, read in ((arrays['x'], run.x), (arrays['v'], run.v), (arrays['d'], run.d)):
        assert read.dtype == np.float64
        np.testing.assert_array_equal(read, mine)
    np.testing.assert_allclose(run.command_times, run.times)
    np.testing.assert_array_equal(run.commands, arrays['u'])
    np.testing.assert_array_equal(run.goal, [0.5, -0.25])
    assert run.parameters == PARAMETERS
    assert run.version == '9.8.7'
    assert run.wall_s == pytest.approx(0.05 * (T - 1))
    first, second = run.replans
    assert (first.time, first.number, first.status, first.solve_ms) == (0.0, 0, 'converged', 12.5)
    assert (first.gradient_norm, first.optimiser_calls) == (1e-3, 31)
    assert (first.mapping_error_before, first.mapping_error_after) == (0.5, 0.125)
    assert (second.time, second.solve_ms) == (pytest.approx(0.1), 20)
    assert np.isnan(second.objective)
    assert (first.kind, second.kind) == ('window', 'feedback')  # older bags do not say it


def test_topics_are_counted(tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
    topics = {topic.name: topic for topic in read_run(tmp_path / 'bag').topics}
    assert len(topics) == 1 + 2 * M
    assert topics['/truth/sheep'].type == 'sensor_msgs/msg/PointCloud2'
    assert topics['/truth/sheep'].count == T
    assert topics['/truth/sheep'].rate == pytest.approx(10.0, rel=0.05)


def test_without_truth_the_observed_states_are_read(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays, prefix='')
    run = read_run(tmp_path / 'bag')
    np.testing.assert_array_equal(run.x, arrays['x'])
    np.testing.assert_array_equal(run.d, arrays['d'])


def test_truth_goes_before_observation(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, {**arrays, 'x': arrays['x'] + 1.0}, prefix='')
        write(recorder, arrays)
    np.testing.assert_array_equal(read_run(tmp_path / 'bag').x, arrays['x'])


def test_last_goal_pose_goes_before_the_parameter(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
        recorder.goal(0, (1.0, 1.0))
        recorder.goal(1, (2.0, -3.0))
    np.testing.assert_array_equal(read_run(tmp_path / 'bag').goal, [2.0, -3.0])


def test_dogs_are_read_at_the_times_of_the_sheep(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        for k in range(3):
            recorder.sheep('/sheep', 1000 + k * 100, [[0, 0]], [[0, 0]])
        for k in range(5):
            recorder.odometry('/dog_1/odom', 950 + k * 100, (k, -k))
    run = read_run(tmp_path / 'bag')
    np.testing.assert_allclose(run.d[:, 0], [[0.5, -0.5], [1.5, -1.5], [2.5, -2.5]])


def test_commands_hold_until_the_next(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        recorder.sheep('/sheep', 0, [[0, 0]], [[0, 0]])
        for m in (1, 2):
            recorder.odometry(f'/dog_{m}/odom', 0, (0, 0))
        recorder.command('/dog_1/cmd_vel', 10**9, (1, 0))
        recorder.command('/dog_2/cmd_vel', 2 * 10**9, (0, 2))
        recorder.command('/dog_1/cmd_vel', 3 * 10**9, (3, 0))
    run = read_run(tmp_path / 'bag')
    np.testing.assert_allclose(run.command_times, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(run.commands[:, 0, 0], [1, 1, 3])
    np.testing.assert_array_equal(run.commands[:, 1, 1], [0, 2, 2])


def test_commands_without_stamp_are_dated_by_the_bag(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        recorder.sheep('/sheep', 0, [[0, 0]], [[0, 0]])
        recorder.odometry('/dog_1/odom', 0, (0, 0))
        recorder.log_ns = 2 * 10**9
        recorder.write('/dog_1/cmd_vel', recorder.twist((1, 2)))
    run = read_run(tmp_path / 'bag')
    np.testing.assert_allclose(run.command_times, [2.0])
    np.testing.assert_array_equal(run.commands, [[[1, 2]]])


def test_twelve_dogs_are_in_the_order_of_their_numbers(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        recorder.sheep('/sheep', 0, [[0, 0]], [[0, 0]])
        for m in range(12, 0, -1):
            recorder.odometry(f'/dog_{m}/odom', 0, (m, 0))
    np.testing.assert_array_equal(read_run(tmp_path / 'bag').d[0, :, 0], range(1, 13))


def test_after_a_reset_the_last_run_is_read(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, {**arrays, 'x': arrays['x'] + 1.0}, first_ns=5 * PERIOD_NS)
        write(recorder, arrays)
    run = read_run(tmp_path / 'bag')
    np.testing.assert_array_equal(run.x, arrays['x'])
    np.testing.assert_array_equal(run.d, arrays['d'])
    assert len(run.command_times) == T


@pytest.mark.parametrize('order', ['<', '>'])
def test_clouds_are_read_by_their_field_table(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any], order: str
) -> None:
    layout = np.dtype(
        {
            'names': ['vy', 'y', 'id', 'x', 'vx'],
            'formats': [f'{order}f8', f'{order}f4', f'{order}u4', f'{order}f8', f'{order}f4'],
            'offsets': [4, 16, 24, 32, 44],
            'itemsize': 53,
        }
    )
    ids = [7, 3, 5, 1]  # sheep are told by their ids
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        recorder.sheep('/sheep', 0, arrays['x'][0], arrays['v'][0], ids, layout)
        recorder.odometry('/dog_1/odom', 0, (0, 0))
    run = read_run(tmp_path / 'bag')
    np.testing.assert_array_equal(run.x[0], arrays['x'][0][np.argsort(ids)])
    np.testing.assert_array_equal(run.v[0], arrays['v'][0][np.argsort(ids)])


def test_rows_of_a_cloud_may_be_padded(run_recorder: Any, tmp_path: Path) -> None:
    with run_recorder(tmp_path / 'bag') as recorder:
        field = recorder.make('sensor_msgs/PointField', name='x', offset=0, datatype=7, count=1)
        cloud = recorder.make(
            'sensor_msgs/PointCloud2', header=recorder.header(0), height=2, width=2,
            fields=[field], is_bigendian=False, point_step=4, row_step=12, is_dense=True,
            data=np.array([1, 2, 99, 3, 4, 99], '<f4').view(np.uint8),
        )  # fmt: skip
    np.testing.assert_array_equal(points(cloud)['x'], [1, 2, 3, 4])
    field.datatype = 99
    with pytest.raises(ValueError, match=r"'x' .* datatype from 1 to 8, got 99"):
        points(cloud)
    cloud.data = cloud.data[:20]
    with pytest.raises(ValueError, match=r'2 rows of 12 bytes, .* got 20 bytes'):
        points(cloud)


def test_sqlite3_bags_are_read_too(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        recorder.goal(0, (1.0, 2.0))
        for k in range(3):
            recorder.log_ns = k * 10**9
            recorder.sheep('/sheep', k * 10**9, [[k, 0]], [[0, 0]])
            recorder.odometry('/dog_1/odom', k * 10**9, (0, k))
    convert_to_sqlite3(tmp_path / 'bag', tmp_path / 'other')
    run = read_run(tmp_path / 'other')
    np.testing.assert_array_equal(run.x[:, 0, 0], [0, 1, 2])
    np.testing.assert_array_equal(run.d[:, 0, 1], [0, 1, 2])
    np.testing.assert_array_equal(run.goal, [1.0, 2.0])
    assert run.wall_s == 2.0
    assert run.version == ''


def convert_to_sqlite3(source: Path, target: Path) -> None:
    from rosbags.rosbag2 import Reader

    with (
        Reader(source) as reader,
        Writer(target, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer,
    ):
        connections = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, rihs01=c.digest)
            for c in reader.connections
        }
        for connection, time, data in reader.messages():
            writer.write(connections[connection.id], time, data)


# Bags with something missing or wrong: what is there is read, and what is not is noted.


def test_one_stamp_too_early_costs_nothing(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    """One of many: a radio that reordered two messages, or a clock that was corrected."""
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
        ns = (T - 1) * PERIOD_NS - 20_000_000
        recorder.sheep('/truth/sheep', ns, arrays['x'][0], arrays['v'][0])
        recorder.sheep('/truth/sheep', 0, arrays['x'][0], arrays['v'][0])  # never got a time
    run = read_run(tmp_path / 'bag')
    assert run.times[-1] == pytest.approx(0.1 * (T - 1))
    np.testing.assert_array_equal(run.x[[*range(T - 1), T]], arrays['x'])
    late, astray = run.notes
    assert late == 'put in order, by stamp, 1 message of /truth/sheep'
    assert astray.startswith('left out 1 message of /truth/sheep (stamp astray)')


def test_reset_of_a_live_sim_leaves_nothing_of_the_run_before(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    """The sim publishes the truth of the dogs after that of the sheep; commands reply to both."""
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        for first_ns, shift in ((100 * PERIOD_NS, 1.0), (0, 0.0)):
            write(recorder, {**arrays, 'x': arrays['x'] + shift}, first_ns=first_ns)
            number = 3 if shift else 4
            recorder.diagnostics('controller: plan', first_ns + PERIOD_NS, replan=number)
        recorder.command('/dog_1/cmd_vel', T * PERIOD_NS, (9, 9))
    run = read_run(tmp_path / 'bag')
    np.testing.assert_array_equal(run.x, arrays['x'])
    np.testing.assert_array_equal(run.d, arrays['d'])
    assert run.replans_made == len(run.replans) == 1
    assert run.notes == (
        'time was set back 1 time in all topics, as by a reset: only the run after that is read',
    )


def test_commands_without_stamp_after_a_reset(tmp_path: Path, run_recorder: Any) -> None:
    """The log time goes on."""
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        for stamp in (50, 51, 52, 0, 1, 2):
            recorder.log_ns += 10**9
            recorder.odometry('/dog_1/odom', stamp * 10**9, (0, 0))
            recorder.sheep('/sheep', stamp * 10**9, [[0, 0]], [[0, 0]])
            recorder.write('/dog_1/cmd_vel', recorder.twist((stamp, 0)))
    run = read_run(tmp_path / 'bag')
    np.testing.assert_allclose(run.command_times, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(run.commands[:, 0, 0], [0, 1, 2])


def test_goal_in_force_is_what_the_controller_says(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
        recorder.goal(0, (1.0, 2.0), '/herd/goal')
        recorder.goal(0, (7.0, 7.0))
    run = read_run(tmp_path / 'bag')
    np.testing.assert_array_equal(run.goal, [1.0, 2.0])


@pytest.mark.parametrize(
    ('at', 'frame', 'reason'),
    [
        ((7, 7), 'odom', "(wrong frame): goal (7, 7) must be in frame 'map', got 'odom'"),
        ((3, 3), '', "(wrong frame): goal (3, 3) must be in frame 'map', got ''"),
        ((np.nan, 1), 'map', '(not finite): goal (nan, 1) must be finite, got NaN'),
    ],
)
def test_goal_that_the_nodes_refuse_decides_nothing(
    tmp_path: Path,
    run_recorder: Any,
    arrays: dict[str, Any],
    at: tuple[float, float],
    frame: str,
    reason: str,
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
        recorder.goal(0, (1.0, 1.0))
        recorder.goal(1, at, frame=frame)
    run = read_run(tmp_path / 'bag')
    np.testing.assert_array_equal(run.goal, [1.0, 1.0])
    assert run.notes[0].startswith(f'left out 1 message of /goal_pose {reason}')


def test_bag_without_destination_is_read(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', {'/controller': {'goal': 'home'}}) as recorder:
        write(recorder, arrays)
    run = read_run(tmp_path / 'bag')
    assert run.goal is None
    assert run.notes[0].startswith('there is no destination')


def test_sheep_that_are_not_seen_are_not_a_number(tmp_path: Path, run_recorder: Any) -> None:
    """Clouds without sheep, sheep that get lost, one that is nowhere, and one that comes late."""
    nan = np.nan
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        clouds = [{}, {3: 1, 5: 2}, {3: 3, 5: nan}, {5: 4}, {5: 5, 9: 6}]
        for k, cloud in enumerate(clouds):
            x = np.reshape([[each, 0] for each in cloud.values()], (-1, 2))
            recorder.sheep('/sheep', k * 10**8, x, np.zeros_like(x), list(cloud))
            recorder.odometry('/dog_1/odom', k * 10**8, (0, 0))
    run = read_run(tmp_path / 'bag')
    np.testing.assert_array_equal(
        run.x[..., 0], [[1, 2, nan], [3, nan, nan], [nan, 4, nan], [nan, 5, 6]]
    )
    np.testing.assert_array_equal(run.seen, np.isfinite(run.x[..., 0]))
    assert run.notes == (
        'left out 1 message of /sheep (empty): sheep must be at least one point, got an empty '
        'cloud',
        '1 position in /sheep not finite: those sheep are not seen there',
        'not all sheep are seen all the time: /sheep has 1 to 2 of 3, 2 at the end',
    )


def test_clouds_of_places_alone_are_read(tmp_path: Path, run_recorder: Any) -> None:
    layout = np.dtype([('x', '<f4'), ('y', '<f4')])
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        cloud = np.zeros(2, layout)
        cloud['x'] = 1, 2
        fields = [
            recorder.make('sensor_msgs/PointField', name=name, offset=at, datatype=7, count=1)
            for name, at in (('x', 0), ('y', 4))
        ]
        message = recorder.make(
            'sensor_msgs/PointCloud2', header=recorder.header(0), height=1, width=2,
            fields=fields, is_bigendian=False, point_step=8, row_step=16, is_dense=True,
            data=np.frombuffer(cloud.tobytes(), np.uint8),
        )  # fmt: skip
        recorder.write('/sheep', message)
        recorder.odometry('/dog_1/odom', 0, (0, 0))
    run = read_run(tmp_path / 'bag')
    np.testing.assert_array_equal(run.x, [[[1, 0], [2, 0]]])
    assert np.isnan(run.v).all()
    assert [note.split(' has ')[1].split(':')[0] for note in run.notes] == [
        'no field id of an integer type', 'no velocities'
    ]  # fmt: skip


def test_ids_that_change_all_the_time_name_no_sheep(
    tmp_path: Path, run_recorder: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader, '_MOST_CELLS', 100)
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        for k in range(20):
            recorder.sheep('/sheep', k, [[k, 0], [k, 1]], np.zeros((2, 2)), [2 * k, 2 * k + 1])
    run = read_run(tmp_path / 'bag')
    assert run.x.shape == (20, 2, 2)
    assert 'the ids in /sheep are not those of sheep' in run.notes[-1]


def test_silent_topics_leave_the_others(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    cloud, odometry = 'sensor_msgs/msg/PointCloud2', 'nav_msgs/msg/Odometry'
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        recorder.advertise('/truth/sheep', cloud)
        recorder.advertise('/dog_0/odom', odometry)
        recorder.advertise('/truth/dog_1/odom', odometry)
        write(recorder, arrays, prefix='')
    run = read_run(tmp_path / 'bag')
    np.testing.assert_array_equal(run.x, arrays['x'])
    np.testing.assert_array_equal(run.d, arrays['d'])
    np.testing.assert_array_equal(run.commands, arrays['u'])
    assert run.dogs == (1, 2)
    assert run.notes == (
        '/truth/sheep has no messages: /sheep is read',
        '/dog_0/odom has no messages: dog 0 is left out',
        '/truth/dog_1/odom has no messages: /dog_1/odom is read',
    )


def test_dog_that_falls_silent_is_nowhere(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        for k in range(6):
            recorder.sheep('/sheep', k * 10**9, [[0, 0]], [[0, 0]])
            recorder.odometry('/dog_2/odom', k * 10**9, (k, 0))
        for k in range(20):
            recorder.odometry('/dog_1/odom', k * 10**8, (0.1 * k, 0))
    run = read_run(tmp_path / 'bag')
    np.testing.assert_allclose(run.d[:, 0, 0], [0, 1, 1.9, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(run.d[:, 1, 0], range(6))
    assert run.notes == ('dog 1 is silent, and not drawn, in 3 of 6 states, from 3.0 s on',)


def test_sheep_without_dogs_are_read(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        recorder.sheep('/sheep', 0, [[0, 0]], [[0, 0]])
    run = read_run(tmp_path / 'bag')
    assert run.d.shape == (1, 0, 2)
    assert run.commands.shape == (0, 0, 2)
    assert run.notes == ('there are no dogs: none has messages on /dog_<number>/odom',)


def test_topics_of_another_type_or_frame_are_left_out(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        recorder.write('/goal_pose', recorder.twist((1, 2)))
        write(recorder, arrays)
        message = recorder.make(
            'nav_msgs/Odometry', header=recorder.header(0, 'odom'), child_frame_id='',
            pose=recorder.make(
                'geometry_msgs/PoseWithCovariance', pose=recorder.pose((9, 9)),
                covariance=np.zeros(36),
            ),
            twist=recorder.make(
                'geometry_msgs/TwistWithCovariance', twist=recorder.twist((0, 0)),
                covariance=np.zeros(36),
            ),
        )  # fmt: skip
        recorder.write('/truth/dog_1/odom', message)
        recorder.bag.write('/truth/dog_2/odom', b'no message', 0, 0)
    run = read_run(tmp_path / 'bag')
    np.testing.assert_array_equal(run.d, arrays['d'])
    np.testing.assert_array_equal(run.goal, PARAMETERS['/controller']['goal'])
    kinds = {(note.split()[5], note.split('(')[1].split(')')[0]) for note in run.notes}
    assert kinds == {
        ('/goal_pose', 'wrong type'),
        ('/truth/dog_1/odom', 'wrong frame'),
        ('/truth/dog_2/odom', 'malformed'),
    }


@pytest.mark.parametrize('text', ['', '[', '[1]', '"a"', '[' * 100_000, '{"/sim": 3, "a": {}}'])
def test_custom_data_may_be_anything(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any], text: str
) -> None:
    recorder = run_recorder(tmp_path / 'bag')
    recorder.bag.close()
    recorder.bag = BagWriter(tmp_path / 'other', {'parameters': text})
    with recorder:
        write(recorder, arrays)
    run = read_run(tmp_path / 'other')
    assert run.parameters == ({'a': {}} if 'sim' in text else {})
    assert ('the parameters in the metadata cannot be read' in run.notes) is ('sim' not in text)


# Namespaces.


def test_herd_in_a_namespace_is_read_by_itself(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    parameters = {'/field_a/controller': {'goal': [9.0, 9.0]}, '/field_a/sim': {'seed': 3}}
    with run_recorder(tmp_path / 'bag', parameters) as recorder:
        write(recorder, arrays, prefix='/field_a/truth')
        recorder.goal(0, (1.0, 2.0), '/field_a/herd/goal')
        recorder.diagnostics('field_a/controller: plan', 0, replan=0)
        recorder.diagnostics('field_b/controller: plan', 0, replan=7)
    run = read_run(tmp_path / 'bag')
    assert run.namespace == '/field_a'
    np.testing.assert_array_equal(run.x, arrays['x'])
    np.testing.assert_array_equal(run.d, arrays['d'])
    np.testing.assert_array_equal(run.goal, [1.0, 2.0])
    assert run.replans_made == 1
    assert run.notes == ()


def test_one_of_several_namespaces_has_to_be_chosen(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays, prefix='/truth')
        write(recorder, {**arrays, 'x': arrays['x'] + 1.0}, prefix='/a/b')
        recorder.goal(0, (1.0, 2.0))
    with pytest.raises(ValueError, match=r'several namespaces, /, /a/b: choose .* --namespace'):
        read_run(tmp_path / 'bag')
    with pytest.raises(ValueError, match='must be one with sheep, /, /a/b, got c'):
        read_run(tmp_path / 'bag', 'c')
    for name in ('a/b', '/a/b/'):
        run = read_run(tmp_path / 'bag', name)
        np.testing.assert_array_equal(run.x, arrays['x'] + 1.0)
        np.testing.assert_array_equal(run.goal, [1.0, 2.0])
        assert run.notes == ('the destination is that of /goal_pose: /a/b has none of its own',)
    np.testing.assert_array_equal(read_run(tmp_path / 'bag', '/').x, arrays['x'])


def test_replans_are_counted_as_the_controllers_number_them(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    """Some were lost, one came twice, and a second controller took over from the first."""
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
        for k, number in enumerate(['0', '2', '2', '5', '1', 'what', 3]):
            recorder.diagnostics('controller: plan', k * PERIOD_NS, replan=number, solve_ms='x')
    run = read_run(tmp_path / 'bag')
    assert [replan.number for replan in run.replans] == [0, 2, 5, 1, 2, 3]
    assert run.replans_made == 6 + 4


def test_largest_gap(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        for ns in (0, 10**8, 5 * 10**8, 6 * 10**8):
            recorder.sheep('/sheep', ns, [[0, 0]], [[0, 0]])
    assert read_run(tmp_path / 'bag').largest_gap_s == 0.4


# Bags that cannot be read.


def test_no_bag_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match='nothing is not a bag'):
        read_run(tmp_path / 'nothing')
    (tmp_path / 'run' / 'bag').mkdir(parents=True)
    with pytest.raises(FileNotFoundError, match=r'run is not a bag: .*; give .*run/bag$'):
        read_run(tmp_path / 'run')
    (tmp_path / 'bag_0.mcap').touch()
    with pytest.raises(FileNotFoundError, match=r'; give the folder it is in$'):
        read_run(tmp_path / 'bag_0.mcap')


def test_unclosed_bag_is_told(tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]) -> None:
    recorder = run_recorder(tmp_path / 'bag', PARAMETERS)
    write(recorder, arrays)
    with pytest.raises(FileNotFoundError, match='has not been closed'):
        read_run(tmp_path / 'bag')
    recorder.bag.close()


def test_bag_without_states_is_told(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        recorder.goal(0, (1, 1))
    with pytest.raises(ValueError, match=r'truth/sheep or sheep.*only /goal_pose'):
        read_run(tmp_path / 'bag')


def test_bag_with_topics_but_no_states_is_told(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        recorder.odometry('/dog_1/odom', 0, (0, 0))
        recorder.bag.add_topic('/sheep', 'sensor_msgs/msg/PointCloud2', '', [], '')
    with pytest.raises(ValueError, match=r'no states.*/sheep \(sensor_msgs/msg/PointCloud2, 0\)'):
        read_run(tmp_path / 'bag')


def test_plan_says_where_to_when_the_parameters_are_not_known(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', {}) as recorder:
        write(recorder, arrays)
        recorder.diagnostics('controller: plan', 0, replan=0, goal_x=9.0, goal_y=9.0)
        recorder.diagnostics('controller: plan', 1, replan=1, goal_x=0.5, goal_y=-0.25)
    np.testing.assert_array_equal(read_run(tmp_path / 'bag').goal, [0.5, -0.25])


def test_missing_fields_are_told(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        cloud = recorder.make(
            'sensor_msgs/PointCloud2', header=recorder.header(0), height=1, width=0, fields=[],
            is_bigendian=False, point_step=4, row_step=0, is_dense=True,
            data=np.zeros(0, np.uint8),
        )  # fmt: skip
        recorder.write('/sheep', cloud)
        recorder.odometry('/dog_1/odom', 0, (0, 0))
    with pytest.raises(ValueError, match=r'no sheep that can be read.*must have fields x and y'):
        read_run(tmp_path / 'bag')


def test_damaged_bag_is_refused(tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
    file = tmp_path / 'bag' / 'bag_0.mcap'
    whole = file.read_bytes()
    for seed in range(8):
        generator = random.Random(seed)
        data = bytearray(whole)
        if seed % 2:
            data = data[: generator.randrange(len(data))]
        else:
            place = generator.randrange(len(data) // 2)  # where the messages are
            data[place : place + 8] = generator.randbytes(8)
        file.write_bytes(data)
        with pytest.raises(ValueError, match='bag'):
            read_run(tmp_path / 'bag')


@pytest.mark.parametrize(
    'text', ['', '[]', 'a: 1', 'rosbag2_bagfile_information: 3', '{', '!!python/object/apply:x []']
)
def test_damaged_metadata_is_told(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any], text: str
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
    (tmp_path / 'bag' / 'metadata.yaml').write_text(text)
    with pytest.raises(ValueError, match=r'metadata\.yaml does not describe a bag'):
        read_run(tmp_path / 'bag')


def test_bag_is_read_from_its_own_folder_alone(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
    shutil.copytree(tmp_path / 'bag', tmp_path / 'stranger')
    metadata = tmp_path / 'stranger' / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('bag_0.mcap', '../bag/bag_0.mcap'))
    (tmp_path / 'stranger' / 'bag_0.mcap').unlink()
    with pytest.raises(ValueError, match='missing'):
        read_run(tmp_path / 'stranger')


def test_bag_of_several_files_is_read_as_one(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'one', PARAMETERS) as recorder:
        write(recorder, arrays)
    with run_recorder(tmp_path / 'none', PARAMETERS) as recorder:
        recorder.bag.close()
        custom_data = {'herding_ros_version': '9.8.7', 'parameters': json.dumps(PARAMETERS)}
        recorder.bag = BagWriter(tmp_path / 'several', custom_data, max_size=10_000)
        write(recorder, arrays)
    assert recorder.bag.file_count > 3
    one, several = read_run(tmp_path / 'one'), read_run(tmp_path / 'several')
    for field in dataclasses.fields(one):
        np.testing.assert_equal(getattr(several, field.name), getattr(one, field.name))


@pytest.mark.parametrize('mode', ['FILE', 'MESSAGE', 'file'])
def test_bag_that_rosbag2_compressed_is_refused(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any], mode: str
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
    file = tmp_path / 'bag' / 'metadata.yaml'
    text = file.read_text().replace("compression_mode: ''", f'compression_mode: {mode}')
    file.write_text(text.replace("compression_format: ''", 'compression_format: zstd'))
    with pytest.raises(ValueError, match=r'compressed by rosbag2, mode (file|message): write it'):
        read_run(tmp_path / 'bag')


def test_bag_with_a_file_that_is_not_listed_is_told(
    tmp_path: Path, run_recorder: Any, arrays: dict[str, Any]
) -> None:
    with run_recorder(tmp_path / 'bag', PARAMETERS) as recorder:
        write(recorder, arrays)
    shutil.copy(tmp_path / 'bag' / 'bag_0.mcap', tmp_path / 'bag' / 'bag_1.mcap')
    with pytest.raises(FileNotFoundError, match=r'does not list bag_1\.mcap; recover it by'):
        read_run(tmp_path / 'bag')
