# SPDX-License-Identifier: Apache-2.0
"""The recording for Rerun, as Rerun's own reader understands it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import sys
from typing import Any

from herding_ros.model.field import read_field
from herding_ros.report import cli
from herding_ros.report.curves import curves
from herding_ros.report.rerun_recording import save_rerun, TIMELINE
from herding_ros.report.walls import outlines
from moving_flock import a_run
import numpy as np
import pytest


class Read:
    """What is in a recording: rows at their times [s], and what is there all the time."""

    def __init__(self, file: Path) -> None:
        chunk = pytest.importorskip('rerun.chunk', reason='rerun-sdk is not installed')
        reader = chunk.RrdReader(file)
        self.blueprints = reader.blueprints()
        self.rows: dict[tuple[str, str], list[tuple[float, Any]]] = {}
        self.static: dict[tuple[str, str], Any] = {}
        for each in reader.stream():
            batch = each.to_record_batch()
            for name in batch.schema.names:
                key, values = (each.entity_path, name.rpartition(':')[2]), batch.column(name)
                if ':' not in name:
                    continue
                if each.is_static:
                    self.static[key] = values.to_pylist()[0]
                    continue
                nanoseconds = batch.column(TIMELINE).to_numpy().astype(int)
                rows = zip((nanoseconds * 1e-9).tolist(), values.to_pylist(), strict=True)
                self.rows.setdefault(key, []).extend(rows)

    def at(self, entity: str, component: str, time: float) -> np.ndarray:
        """Return what a viewer shows at a time: the last before it, of two the later."""
        rows = [row for row in self.rows[entity, component] if row[0] <= time + 1e-9]
        newest = max(row[0] for row in rows)
        return np.array([row[1] for row in rows if row[0] == newest][-1])


@pytest.fixture
def read(tmp_path: Path) -> Any:
    pytest.importorskip('rerun', reason='rerun-sdk is not installed')

    def save_and_read(run: Any) -> Read:
        save_rerun(run, tmp_path / 'run.rrd')
        return Read(tmp_path / 'run.rrd')

    return save_and_read


def test_sheep_and_dogs_are_where_they_were_at_every_time(read: Any) -> None:
    run = a_run()
    run.x[30:, 4] = np.nan  # not seen
    run.d[40:60, 1] = np.nan  # silent
    found = read(run)
    rows = found.rows['/herd/sheep', 'positions']
    assert np.allclose([row[0] for row in rows], run.times, rtol=0, atol=1e-9)
    for k, (_, places) in enumerate(rows):
        assert np.allclose(np.array(places)[:, :2], run.x[k][run.seen[k]], atol=1e-6)
        assert not np.array(places)[:, 2].any()
    for m, number in enumerate(run.dogs):
        assert found.static[f'/herd/dog_{number}', 'labels'] == [str(number)]
        for k, (_, place) in enumerate(found.rows[f'/herd/dog_{number}', 'positions']):
            there = run.d[k, m][None][np.isfinite(run.d[k, m, :1])]
            assert np.allclose(np.reshape(place, (-1, 3))[:, :2], there, atol=1e-6)
    (_, heading) = found.rows['/herd/dog_1/heading', 'vectors'][50]
    assert heading[0][0] > 0.0 == pytest.approx(heading[0][1], abs=1e-6)  # they go along x
    assert len(found.static['/herd/dog_1/path', 'strips']) == 1
    assert len(found.static['/herd/dog_2/path', 'strips']) == 2  # before the silence and after


def test_plans_and_destination_are_those_in_force(read: Any) -> None:
    run = a_run()
    announced = (*run.plans[:3], run.plans[5], run.plans[4])  # a feedback while one waits
    found = read(replace(run, plans=announced))
    for time, k in ((0.5, 0), (2.0, 2), (4.7, 4), (9.0, 5)):
        for number in run.dogs:
            (line,) = found.at(f'/herd/dog_{number}/plan', 'strips', time)
            assert np.allclose(line[:, :2], run.plans[k].points[:, number - 1], atol=1e-6)
    (line,) = found.at('/herd/centre/expected', 'strips', 6.1)
    assert np.allclose(line[:, :2], run.expected[6].points, atol=1e-6)
    assert found.at('/herd/destination', 'positions', 4.9) == pytest.approx(np.array([[2, 0, 0]]))
    assert found.at('/herd/destination', 'positions', 5.0) == pytest.approx(np.array([[1, 1, 0]]))


def test_dog_that_a_plan_leaves_out_has_none(read: Any) -> None:
    run = a_run()
    run.plans[3].points[:, 1] = np.nan
    found = read(run)
    assert len(found.at('/herd/dog_1/plan', 'strips', 3.5)) == 1
    assert len(found.at('/herd/dog_2/plan', 'strips', 3.5)) == 0


def test_walls_are_those_of_the_field_and_curves_those_of_the_run(read: Any) -> None:
    run = replace(a_run(), parameters={'/sim': {'field': 'pen'}})
    found = read(run)
    walls = found.static['/herd/walls', 'strips']
    for wall, line in zip(walls, outlines(read_field('pen')[0]), strict=True):
        assert np.allclose(np.array(wall)[:, :2], line, atol=1e-6)
    assert len(found.static['/herd/region', 'strips']) == 1
    names = 'distance', 'spread', 'share_of_sheep_at_the_destination'
    for name, curve in zip(names, curves(run), strict=True):
        rows = found.rows[f'/curves/{name}', 'scalars']
        assert found.static[f'/curves/{name}', 'names'] == [curve.label]
        assert np.allclose([row[0] for row in rows], curve.times, rtol=0, atol=1e-9)
        assert np.allclose([row[1][0] for row in rows], curve.values)
    assert len(found.blueprints) == 1


def test_run_without_plans_and_destination_is_saved(read: Any) -> None:
    run = replace(a_run(states=1, dogs=1, plans=0), goal=None, goals=())
    entities = {entity for entity, _ in read(run).rows}
    assert {'/herd/sheep', '/herd/dog_1', '/herd/centre'} <= entities
    assert not {'/herd/destination', '/herd/dog_1/plan'} & entities


def test_program_writes_it_beside_the_rest(tmp_path: Path, run_recorder: Any) -> None:
    pytest.importorskip('rerun', reason='rerun-sdk is not installed')
    with run_recorder(tmp_path / 'bag') as recorder:
        for k in range(3):
            recorder.sheep('/truth/sheep', k * 10**9, [(0.1 * k, 2.0)], [(0.1, 0.0)])
    assert cli.main([str(tmp_path / 'bag'), '--rerun', str(tmp_path / 'run.rrd')]) == 0
    rows = Read(tmp_path / 'run.rrd').rows['/herd/sheep', 'positions']
    assert [time for time, _ in rows] == [0.0, 1.0, 2.0]
    assert np.allclose([places for _, places in rows], [[(0.1 * k, 2.0, 0.0)] for k in range(3)])


def test_who_has_no_rerun_is_told_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, 'rerun', None)
    with pytest.raises(ValueError, match=r'pip install .rerun-sdk>=0\.41.'):
        save_rerun(a_run(), tmp_path / 'run.rrd')
    assert not list(tmp_path.iterdir())


def test_other_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r'must end in \.rrd, got run\.mcap'):
        save_rerun(a_run(), tmp_path / 'run.mcap')
