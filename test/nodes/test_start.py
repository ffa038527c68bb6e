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

TABLE = """# a flock of two, in the form that fit takes
time,name,x,y,vx,vy
10, molly, 0.1,-0.2
10, dog_1, 1.0, 2.0

10, polly,3e-1,0.4,0.01,-0.02
12, molly, 5.0, 6.0
12, dog_1, 7.0, 8.0
"""


def test_table_is_read_at_the_nearest_instant(tmp_path: Path) -> None:
    file = tmp_path / 'start.csv'
    file.write_text(TABLE)
    herd = read_start(file, 0.9)
    np.testing.assert_array_equal(herd.x, [[0.1, -0.2], [0.3, 0.4]])
    np.testing.assert_array_equal(herd.v, [[0.0, 0.0], [0.01, -0.02]])
    np.testing.assert_array_equal(herd.d, [[1.0, 2.0]])
    herd = read_start(file, 1.1)
    np.testing.assert_array_equal(herd.x, [[5.0, 6.0]])  # the other one is out of sight
    np.testing.assert_array_equal(herd.d, [[7.0, 8.0]])


@pytest.mark.parametrize(
    ('table', 'message'),
    [
        ('sheep,1,2\ndog,1,2\n', 'must begin with a line that names the columns time, name, x, y'),
        (TABLE.replace('0.4', 'b'), 'line 6: must be numbers'),
        (
            TABLE.replace('dog', 'cat'),
            'there must be sheep, and dogs with names that begin with dog',
        ),
        (TABLE.replace('7.0', 'nan'), 'line 8: time, x and y must be finite'),
    ],
)
def test_what_is_no_start_is_refused(tmp_path: Path, table: str, message: str) -> None:
    file = tmp_path / 'start.csv'
    file.write_text(table)
    with pytest.raises(ValueError, match=re.escape(message)):
        read_start(file, 0.0)


def test_no_dog_at_the_instant_is_refused(tmp_path: Path) -> None:
    file = tmp_path / 'start.csv'
    file.write_text(TABLE.replace('12, dog_1, 7.0, 8.0\n', ''))
    with pytest.raises(ValueError, match='at least one sheep and one dog, got 1 sheep and 0 dogs'):
        read_start(file, 2.0)


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
