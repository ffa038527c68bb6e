# SPDX-License-Identifier: Apache-2.0
"""A start from a table or a recorded run."""

from pathlib import Path
import re
from types import SimpleNamespace

from herding_ros.model.crowd import Crowd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import HerdState
from herding_ros.nodes.start import read_start
import numpy as np
import pytest

TABLE = """# a flock of two
sheep,0.1,-0.2
dog, 1.0, 2.0

sheep,3e-1,0.4,0.01,-0.02
"""


def test_table_is_read(tmp_path: Path) -> None:
    file = tmp_path / 'start.csv'
    file.write_text(TABLE)
    herd = read_start(file, 0.0)
    np.testing.assert_array_equal(herd.x, [[0.1, -0.2], [0.3, 0.4]])
    np.testing.assert_array_equal(herd.v, [[0.0, 0.0], [0.01, -0.02]])
    np.testing.assert_array_equal(herd.d, [[1.0, 2.0]])


@pytest.mark.parametrize(
    ('table', 'message'),
    [
        (
            'sheep,1,2\ncat,1,2\n',
            'line 2 must be sheep,x,y or sheep,x,y,vx,vy or dog,x,y, got cat',
        ),
        ('sheep,1\ndog,1,2\n', 'line 1 must be'),
        ('sheep,1,b\ndog,1,2\n', 'line 1 must be'),
        ('dog,1,2,3,4\n', 'line 1 must be'),
        ('sheep,1,2\n', 'at least one sheep and one dog, got 1 sheep and 0 dogs'),
        ('sheep,1,nan\ndog,1,2\n', 'must be finite'),
    ],
)
def test_what_is_no_start_is_refused(tmp_path: Path, table: str, message: str) -> None:
    file = tmp_path / 'start.csv'
    file.write_text(table)
    with pytest.raises(ValueError, match=re.escape(message)):
        read_start(file, 0.0)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match='start_from must be a CSV file or a bag'):
        read_start(tmp_path / 'nothing.csv', 0.0)


def test_bag_is_read_at_the_nearest_instant_without_what_was_not_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    x, d = np.random.default_rng(0).normal(size=(2, 3, 4, 2))
    v = np.full_like(x, np.nan)
    x[1, 2], d[1, 0] = np.nan, np.nan
    run = SimpleNamespace(
        times=np.array([0.0, 0.5, 1.5]), x=x, v=v, d=d, seen=np.isfinite(x[..., 0])
    )
    monkeypatch.setattr('herding_ros.bag.reader.read_run', lambda folder: run)
    herd = read_start(tmp_path, 0.9)
    np.testing.assert_array_equal(herd.x, x[1, [0, 1, 3]])
    np.testing.assert_array_equal(herd.v, np.zeros((3, 2)))
    np.testing.assert_array_equal(herd.d, d[1, 1:])
    np.testing.assert_array_equal(read_start(tmp_path, 1.1).x, x[2])


def test_the_sim_starts_from_a_herd_and_only_from_one_of_its_size() -> None:
    herd = HerdState(np.ones((2, 2)), np.zeros((2, 2)), np.zeros((1, 2)))
    sim = Simulation(Crowd(), World(sheep=2, dogs=1), np.ones(2), herd)
    np.testing.assert_array_equal(sim.state.x, herd.x)
    np.testing.assert_array_equal(sim.state.d, herd.d)
    with pytest.raises(ValueError, match='sheep must be as many as the start has, 2, got 30'):
        Simulation(Crowd(), World(), np.ones(2), herd)
