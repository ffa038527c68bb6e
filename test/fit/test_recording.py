# SPDX-License-Identifier: Apache-2.0
"""Recordings read from bags and tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from herding_ros.fit.recording import from_bag, from_table, read, Recording
import numpy as np
import pytest

TABLE = """time,name,x,y,vx,vy
0.0,dolly,1.0,2.0,0.5,-0.5
0.0,dog_1,5.0,5.0,,
0.5,dolly,1.5,2.0,,
1.0,dolly,2.0,2.5,,
1.0,dog_1,6.0,7.0,,
1.0,molly,3.0,3.0,,
"""


def test_a_table_becomes_arrays(tmp_path: Path) -> None:
    (tmp_path / 'a.csv').write_text(TABLE)
    found = read(tmp_path / 'a.csv')
    np.testing.assert_array_equal(found.times, [0.0, 0.5, 1.0])
    nan = np.nan
    np.testing.assert_array_equal(found.x[:, 0], [[1.0, 2.0], [1.5, 2.0], [2.0, 2.5]])
    np.testing.assert_array_equal(found.x[:, 1], [[nan, nan], [nan, nan], [3.0, 3.0]])
    np.testing.assert_array_equal(found.v[:, 0], [[0.5, -0.5], [nan, nan], [nan, nan]])
    # The dog was silent at 0.5 s: half-way.
    np.testing.assert_array_equal(found.d[:, 0], [[5.0, 5.0], [5.5, 6.0], [6.0, 7.0]])
    assert found.position_noise is None


@pytest.mark.parametrize(
    ('table', 'refusal'),
    [
        ('time,name,x\n0,a,1\n', 'must begin with a line that names the columns .* it lacks y'),
        (TABLE.replace('1.5,2.0', '1.5,wet'), 'line 4: must be numbers'),
        (TABLE.replace('1.5,2.0', '1.5,'), 'line 4: time, x and y must be finite'),
        (TABLE.replace('dog_1', 'rex'), 'names that begin with dog, got dolly, molly, rex'),
        (TABLE.replace('olly', 'ogly').replace('mogly', 'dog_2').replace('dogly', 'dog_3'),
         'there must be sheep'),
        (TABLE.replace('0.5,dolly', '1.0,dolly'), 'line 5: dolly must be there once at 1 s'),
        (TABLE.replace('0.5,dolly', '0.5,'), 'line 4: there must be a name'),
        (TABLE.replace('1.5,2.0', '1,5,2,0'), 'line 4: there must be no more values than columns'),
        (TABLE.replace(',', ';'), 'it lacks time, name, x, y; it has time;name;x;y;vx;vy'),
    ],
)  # fmt: skip
def test_bad_tables_are_refused(tmp_path: Path, table: str, refusal: str) -> None:
    (tmp_path / 'a.csv').write_text(table)
    with pytest.raises(ValueError, match=refusal):
        from_table(tmp_path / 'a.csv')


def test_a_table_may_begin_with_the_mark_of_a_spreadsheet(tmp_path: Path) -> None:
    """Excel's `CSV UTF-8` does."""
    (tmp_path / 'a.csv').write_text(TABLE)
    (tmp_path / 'b.csv').write_text(TABLE, encoding='utf-8-sig')
    plain, marked = (from_table(tmp_path / name) for name in ('a.csv', 'b.csv'))
    np.testing.assert_array_equal(plain.x, marked.x)
    np.testing.assert_array_equal(plain.d, marked.d)


TIMES, PLACES = np.arange(4.0), np.zeros((4, 2, 2))


@pytest.mark.parametrize(
    ('times', 'x', 'words'),
    [
        (TIMES[:2], PLACES[:2], 'times must be at least 3, got 2'),
        ([0.0, 1.0, 0.5, 2.0], PLACES, 'times must increase, got 0.5 after 1'),
        ([0.0, 1.0, 1.0, 2.0], PLACES, 'times must increase, got 1 after 1'),
        (TIMES, PLACES[:, :0], 'there must be sheep, each seen at least once'),
        (
            TIMES,
            [[[np.nan, np.nan], [0.0, 0.0]]] * 4,
            'there must be sheep, each seen at least once',
        ),
    ],
)
def test_arrays_that_are_no_recording_are_refused(times: Any, x: Any, words: str) -> None:
    with pytest.raises(ValueError, match=f'^recording: {words}$'):
        Recording(times, x, np.zeros_like(x), np.zeros((len(times), 1, 2)))


@pytest.mark.parametrize('what', ['x', 'v'])
@pytest.mark.parametrize('seen', [(np.nan, 0.0), (0.0, np.nan), (np.inf, 0.0), (np.inf, np.inf)])
def test_half_a_place_is_none(what: str, seen: tuple[float, float]) -> None:
    """The filter looks at the first coordinate only: a fit went on, to other values."""
    arrays = {'x': PLACES.copy(), 'v': PLACES.copy()}
    arrays[what][2, 1] = seen
    words = f'recording: {what} must be finite, or NaN in both coordinates where it was not seen'
    with pytest.raises(ValueError, match=f'^{words}, got .* at 2 s$'):
        Recording(TIMES, **arrays, d=np.zeros((4, 1, 2)))


def test_of_a_bag_the_observations_are_read(tmp_path: Path, run_recorder: Any) -> None:
    parameters = {'/sim': {'position_noise': 0.02, 'velocity_noise': 0.03}}
    rng = np.random.default_rng(0)
    truth, seen = rng.integers(-512, 512, (2, 5, 3, 2)) / 256.0
    dogs, odometry = rng.integers(-512, 512, (2, 5, 2)) / 256.0
    with run_recorder(tmp_path / 'bag', parameters) as recorder:
        for k in range(5):
            recorder.sheep('/truth/sheep', k * 10**8, truth[k], truth[k])
            recorder.sheep('/sheep', k * 10**8, seen[k], -seen[k])
            recorder.odometry('/truth/dog_1/odom', k * 10**8, dogs[k])
            recorder.odometry('/dog_1/odom', k * 10**8, odometry[k])
    found = read(tmp_path / 'bag')
    np.testing.assert_array_equal(found.x, seen)
    np.testing.assert_array_equal(found.v, -seen)
    np.testing.assert_array_equal(found.d[:, 0], odometry)
    assert (found.position_noise, found.velocity_noise) == (0.02, 0.03)


def test_truth_alone_is_no_observation(tmp_path: Path, run_recorder: Any) -> None:
    with run_recorder(tmp_path / 'bag') as recorder:
        for k in range(5):
            recorder.sheep('/truth/sheep', k * 10**8, np.ones((3, 2)), np.ones((3, 2)))
            recorder.odometry('/dog_1/odom', k * 10**8, np.ones(2))
    with pytest.raises(ValueError, match='no observed sheep: /sheep must have messages'):
        from_bag(tmp_path / 'bag')


def test_what_of_a_bag_is_not_in_the_recording_is_logged(
    tmp_path: Path, run_recorder: Any, caplog: pytest.LogCaptureFixture
) -> None:
    with run_recorder(tmp_path / 'bag') as recorder:
        for k in range(40):
            recorder.log_ns = k * 10**8
            recorder.sheep('/sheep', (k % 20) * 10**8, np.ones((3, 2)), np.ones((3, 2)))
            recorder.odometry('/dog_1/odom', (k % 20) * 10**8, np.ones(2))
    assert len(from_bag(tmp_path / 'bag').times) == 20
    said = [each.getMessage() for each in caplog.records if each.levelname == 'WARNING']
    words = (
        'time was set back 1 time in all topics, as by a reset: only the run after that is read'
    )
    assert f'{tmp_path / "bag"}: {words}' in said


def test_a_bag_without_dogs_is_refused(tmp_path: Path, run_recorder: Any) -> None:
    """As such a table is: what sheep do for dogs would be taken for their own."""
    with run_recorder(tmp_path / 'bag') as recorder:
        for k in range(5):
            recorder.sheep('/sheep', k * 10**8, np.ones((3, 2)), np.ones((3, 2)))
    with pytest.raises(ValueError, match=r'bag has no dogs: none has messages on /dog_<i>/odom$'):
        from_bag(tmp_path / 'bag')


def test_half_a_velocity_in_a_bag_does_not_count(tmp_path: Path, run_recorder: Any) -> None:
    v = np.array([[0.5, np.nan], [np.inf, 0.5], [0.25, 0.5]])
    with run_recorder(tmp_path / 'bag') as recorder:
        for k in range(5):
            recorder.sheep('/sheep', k * 10**8, np.ones((3, 2)), v)
            recorder.odometry('/dog_1/odom', k * 10**8, np.ones(2))
    found = from_bag(tmp_path / 'bag').v[0]
    assert np.isnan(found[:2]).all()
    assert found[2].tolist() == [0.25, 0.5]
