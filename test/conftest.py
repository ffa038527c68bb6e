# SPDX-License-Identifier: Apache-2.0
"""What all tests share: which of them run, in which order, and herds and bags to test with."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import gc
import json
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

from benchmark.browser import chromium
from herding_ros.bag.writer import BagWriter
from herding_ros.model.state import HerdState
from hypothesis import settings
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

# colcon tells Python to keep no compiled modules, and then each process compiles NumPy, SciPy and
# Numba anew.
os.environ.pop('PYTHONDONTWRITEBYTECODE', None)
sys.dont_write_bytecode = False

gc.disable()  # to look for garbage in what is being loaded takes a tenth of the time

settings.register_profile(
    'repeatable', database=None, deadline=None, derandomize=True, max_examples=20
)
settings.load_profile('repeatable')

TIMED = {
    'test_controller', 'test_endurance', 'test_faults', 'test_herd', 'test_hostile',
    'test_recorder_faults', 'test_signals', 'test_sim',
}  # fmt: skip
"""Files of tests that start nodes and look at the clock."""

STORE = get_typestore(Stores.ROS2_JAZZY)
CLOUD = np.dtype([('id', '<u4'), *((name, '<f4') for name in ('x', 'y', 'z', 'vx', 'vy', 'vz'))])


LEFT_OUT = ('statistics', 'slow')
"""Marks of tests that run only with --all, or if -m names them."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        '--all', action='store_true', help=f'run the tests marked {" or ".join(LEFT_OUT)} as well'
    )


@pytest.hookimpl(tryfirst=True)  # pytest-xdist looks for groups in the same hook
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what only --all runs, and say what two processes must not share.

    Tests that look at the clock take longest, go first and stay in one process: two at a time
    would be in each other's way.
    """
    if not config.getoption('all') and not config.getoption('markexpr'):
        left_out = {item for item in items if any(map(item.get_closest_marker, LEFT_OUT))}
        config.hook.pytest_deselected(items=list(left_out))
        items[:] = [item for item in items if item not in left_out]
    for item in items:
        name = item.path.stem
        item.add_marker(pytest.mark.xdist_group('timed' if name in TIMED else name))
        if starts_nodes(item):  # a busy machine may hold up a process; the output says RERUN
            item.add_marker(pytest.mark.flaky(reruns=1))
    items.sort(key=lambda item: (item.path.stem not in TIMED, not starts_nodes(item)))


def pytest_collection_finish() -> None:
    """Leave out of the search for garbage what has been loaded: it stays until the end."""
    gc.enable()
    gc.freeze()


def starts_nodes(item: pytest.Item) -> bool:
    """Whether a test is of those that start processes and wait for them."""
    return item.path.parent.name == 'nodes'


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let tests that wait for nobody give way to those that look at the clock."""
    if not starts_nodes(item) and os.nice(0) == 0:
        os.nice(10)


class RunRecorder:
    """Writes what the nodes publish in a run into a bag, made with rosbags' messages."""

    def __init__(
        self, path: Path, parameters: dict[str, Any] | None = None, **custom_data: str
    ) -> None:
        custom_data['herding_ros_version'] = '9.8.7'
        custom_data['parameters'] = json.dumps(parameters or {})
        self.bag = BagWriter(path, custom_data)
        self.log_ns = 0
        self.publish_ns = 1_700_000_000_000_000_000

    def __enter__(self) -> RunRecorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.bag.close()

    def write(self, topic: str, message: Any) -> None:
        name = message.__msgtype__
        if topic not in self.bag.topics:
            definition, _ = STORE.generate_msgdef(name, ros_version=2)
            self.bag.add_topic(topic, name, definition, [], STORE.hash_rihs01(name))
        self.bag.write(
            topic, bytes(STORE.serialize_cdr(message, name)), self.log_ns, self.publish_ns
        )

    def make(self, name: str, /, **fields: Any) -> Any:
        package, kind = name.split('/')
        return STORE.types[f'{package}/msg/{kind}'](**fields)

    def header(self, ns: int, frame: str = 'map') -> Any:
        stamp = self.make('builtin_interfaces/Time', sec=ns // 10**9, nanosec=ns % 10**9)
        return self.make('std_msgs/Header', stamp=stamp, frame_id=frame)

    def pose(self, at: Any) -> Any:
        return self.make(
            'geometry_msgs/Pose',
            position=self.make('geometry_msgs/Point', x=float(at[0]), y=float(at[1]), z=0.0),
            orientation=self.make('geometry_msgs/Quaternion', x=0.0, y=0.0, z=0.0, w=1.0),
        )

    def twist(self, u: Any) -> Any:
        linear = self.make('geometry_msgs/Vector3', x=float(u[0]), y=float(u[1]), z=0.0)
        angular = self.make('geometry_msgs/Vector3', x=0.0, y=0.0, z=0.0)
        return self.make('geometry_msgs/Twist', linear=linear, angular=angular)

    def sheep(
        self, topic: str, ns: int, x: Any, v: Any, ids: Any = None, dtype: np.dtype[Any] = CLOUD
    ) -> None:
        points = np.zeros(len(x), dtype)
        if 'id' in (dtype.names or ()):
            points['id'] = np.arange(len(x)) if ids is None else ids
        points['x'], points['y'] = np.transpose(x)
        points['vx'], points['vy'] = np.transpose(v)
        kinds = {('u', 4): 6, ('f', 4): 7, ('f', 8): 8}
        assert dtype.fields is not None
        fields = [
            self.make(
                'sensor_msgs/PointField',
                name=name,
                offset=offset,
                datatype=kinds[kind.kind, kind.itemsize],
                count=1,
            )
            for name, (kind, offset) in dtype.fields.items()
        ]
        cloud = self.make(
            'sensor_msgs/PointCloud2',
            header=self.header(ns),
            height=1,
            width=len(x),
            fields=fields,
            is_bigendian=dtype['x'].byteorder == '>',
            point_step=dtype.itemsize,
            row_step=dtype.itemsize * len(x),
            data=np.frombuffer(points.tobytes(), np.uint8),
            is_dense=True,
        )
        self.write(topic, cloud)

    def odometry(self, topic: str, ns: int, at: Any) -> None:
        pose = self.make(
            'geometry_msgs/PoseWithCovariance', pose=self.pose(at), covariance=np.zeros(36)
        )
        twist = self.make(
            'geometry_msgs/TwistWithCovariance', twist=self.twist((0, 0)), covariance=np.zeros(36)
        )
        header = self.header(ns)
        self.write(
            topic,
            self.make(
                'nav_msgs/Odometry', header=header, child_frame_id='', pose=pose, twist=twist
            ),
        )

    def command(self, topic: str, ns: int, u: Any) -> None:
        header, twist = self.header(ns), self.twist(u)
        self.write(topic, self.make('geometry_msgs/TwistStamped', header=header, twist=twist))

    def goal(self, ns: int, at: Any, topic: str = '/goal_pose', frame: str = 'map') -> None:
        header, pose = self.header(ns, frame), self.pose(at)
        self.write(topic, self.make('geometry_msgs/PoseStamped', header=header, pose=pose))

    def markers(self, topic: str, ns: int, points: dict[str, Any], frame: str = 'map') -> None:
        """Record markers by their names, after one that removes all."""
        header = self.header(ns, frame)
        colour = self.make('std_msgs/ColorRGBA', r=0, g=0, b=0, a=1)
        drawn = [
            self.make(
                'visualization_msgs/Marker', header=header, ns=name, id=0, type=5, action=action,
                pose=self.pose((0, 0)), scale=self.make('geometry_msgs/Vector3', x=1, y=1, z=1),
                color=colour, lifetime=self.make('builtin_interfaces/Duration', sec=0, nanosec=0),
                frame_locked=False, colors=[], text='', mesh_resource='',
                points=[self.make('geometry_msgs/Point', x=x, y=y, z=0.0) for x, y in places],
                texture_resource='', uv_coordinates=[], mesh_use_embedded_materials=False,
                texture=self.make(
                    'sensor_msgs/CompressedImage', header=header, format='',
                    data=np.zeros(0, np.uint8),
                ),
                mesh_file=self.make(
                    'visualization_msgs/MeshFile', filename='', data=np.zeros(0, np.uint8)
                ),
            )
            for name, places, action in (('', [], 3), *((k, v, 0) for k, v in points.items()))
        ]  # fmt: skip
        self.write(topic, self.make('visualization_msgs/MarkerArray', markers=drawn))

    def advertise(self, topic: str, name: str) -> None:
        """Record that there is a topic, without a message."""
        definition, _ = STORE.generate_msgdef(name, ros_version=2)
        self.bag.add_topic(topic, name, definition, [], STORE.hash_rihs01(name))

    def diagnostics(self, name: str, ns: int, **values: Any) -> None:
        status = self.make(
            'diagnostic_msgs/DiagnosticStatus',
            level=0,
            name=name,
            message='',
            hardware_id='',
            values=[
                self.make('diagnostic_msgs/KeyValue', key=key, value=str(value))
                for key, value in values.items()
            ],
        )
        header = self.header(ns)
        self.write(
            '/diagnostics',
            self.make('diagnostic_msgs/DiagnosticArray', header=header, status=[status]),
        )


@pytest.fixture(scope='session')
def run_recorder() -> type[RunRecorder]:
    return RunRecorder


@pytest.fixture(scope='session')
def random_herd() -> Callable[..., HerdState]:
    """Return a maker of random herds: sheep on the move, dogs around and between them."""

    def make(n: int, m: int, seed: int = 0) -> HerdState:
        rng = np.random.default_rng(seed)
        return HerdState(
            rng.uniform(-0.4, 0.4, (n, 2)),
            rng.normal(0.0, 0.05, (n, 2)),
            rng.uniform(-0.7, 0.7, (m, 2)),
        )

    return make


@pytest.fixture(scope='session')
def browser() -> Iterator[Any]:
    """A Chromium without a window: a WebDriver."""
    with chromium() as one:
        yield one


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 4 MB."""
    path = tmp_path / 'disk'
    path.mkdir()
    mount = ['mount', '-t', 'tmpfs', '-o', 'size=4m', 'tmpfs', str(path)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip('only root can make a small disk')
    yield path
    subprocess.run(['umount', '--lazy', str(path)], check=True)
