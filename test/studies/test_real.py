# SPDX-License-Identifier: Apache-2.0
"""The study of real sheep, on made-up drives in the form of the recorded ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from herding_ros.model.alignment import Alignment
from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import follow
from herding_ros.model.noise import increments
from herding_ros.model.potentials import Morse
from herding_ros.model.state import HerdState
from herding_ros.studies import cli, real
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.experiments.real import drives, identify
from herding_ros.studies.study import Options, Results, Section
from herding_ros.studies.task import Task
from matplotlib.figure import Figure
import numpy as np
import pytest

SHEEP = 6
TRUE = Crowd(
    Morse(3.0, 1.0, 20.0, 20.0), Morse(3.0, 2.5, 0.0, 2.0), friction=0.3,
    alignment=Alignment(3.0, 1.5), noise=0.6, common_noise=0.3,
)  # fmt: skip


@pytest.fixture(scope='module')
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six drives of 12 s: a dog behind a flock, a shepherd who stands."""
    parts = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        t = 0.05 * np.arange(241)
        dog = np.stack([-4.0 + 0.9 * t, 2.0 * np.sin(0.4 * t + seed)], axis=1)
        x = rng.normal(0.0, 0.8, (SHEEP, 2))
        start = HerdState(x, np.tile([0.8, 0.0], (SHEEP, 1)), dog[:1])
        noise = increments(rng, TRUE, SHEEP, 0.05, 240)
        flock = follow(TRUE, start, dog[:, :, None], 0.05, noise).x
        still = np.full((len(t), 1, 2), 50.0)
        parts.append(np.concatenate([flock, dog[:, None], still], axis=1)[::2])
    path = tmp_path_factory.mktemp('data') / 'drives.npz'
    np.savez(
        path, x=np.concatenate(parts).astype(np.float32), frames=[len(p) for p in parts], dt=0.1
    )
    return path


def test_drives_are_read(data: Path) -> None:
    found = drives(data)
    assert [each.x.shape for each in found] == [(121, SHEEP, 2)] * 6
    np.testing.assert_allclose(found[3].d[0, 0], [-4.0, 2.0 * np.sin(3.0)], rtol=1e-6)
    assert found[0].duration == pytest.approx(12.0)
    name, count = identify(data)
    assert (len(name), count) == (16, 6)


def test_what_is_no_file_of_drives_is_refused(data: Path, tmp_path: Path) -> None:
    bad = tmp_path / 'bad.npz'
    np.savez(bad, x=np.zeros((5, 4, 2)), dt=0.1)
    with pytest.raises(ValueError, match='must have the arrays x, frames and dt, lacks frames'):
        identify(bad)
    np.savez(bad, x=np.zeros((5, 4, 2)), frames=[2, 2], dt=0.1)
    with pytest.raises(ValueError, match=r'x must have shape \(4, sheep \+ 2, 2\)'):
        identify(bad)


def test_the_name_is_of_the_numbers_not_of_the_file(data: Path, tmp_path: Path) -> None:
    with np.load(data) as file:
        arrays = {name: file[name] for name in file.files}
    again, other = tmp_path / 'again.npz', tmp_path / 'other.npz'
    np.savez_compressed(again, **arrays)
    arrays['x'][0, 0, 0] += 1.0
    np.savez(other, **arrays)
    assert identify(again) == identify(data)
    assert identify(other) != identify(data)


def test_a_fit_predicts_drives_that_it_has_not_seen(data: Path) -> None:
    predict = EXPERIMENTS['real_prediction']
    straight, fitted = (
        predict('', form, [1, 2, 4, 5], [0, 3], noise, path=str(data))
        for form, noise in (('constant velocity', False), ('aligned', True))
    )
    errors = [real._Prediction([each]).rms for each in (straight, fitted)]
    assert (errors[1][1:] < 0.75 * errors[0][1:]).all()
    recorded, simulated = fitted['sizes']
    assert simulated == pytest.approx(recorded, rel=0.3)
    assert fitted['crowd']['sheep.attraction_length'] == 20.0
    assert 0.3 < fitted['crowd']['noise'] < 1.2


def test_what_is_known_in_advance_is_used_for_predictions(tmp_path: Path) -> None:
    """Centres that accelerate, follow a dog's command, and their dog: each line knows the next."""
    rng = np.random.default_rng(0)
    dt, parts = 0.1, []
    for _ in range(8):
        pushes = np.repeat(rng.normal(size=(8, 2)), 50, axis=0)  # each lasts for 5 s
        v = np.cumsum(dt * pushes, axis=0)
        middle = np.cumsum(dt * v, axis=0)
        x = middle[:, None] + rng.normal(0.0, 1.0, (SHEEP, 2))
        dog = middle[:, None] + rng.normal(size=2)
        parts.append(np.concatenate([x, dog, 0.0 * dog], axis=1))
    path = tmp_path / 'drives.npz'
    np.savez(path, x=np.concatenate(parts), frames=[len(p) for p in parts], dt=dt)
    found = EXPERIMENTS['real_limits']('', list(range(8)), folds=4, path=str(path))
    velocity, second, _, dog = (np.array(each) for each in found['centre'].values())
    # Within 1 s a push of 1 m/s^2 adds 0.5 m in each coordinate; most of them last.
    assert velocity[0] == pytest.approx(0.5 * np.sqrt(2.0), rel=0.25)
    assert second[0] < 0.6 * velocity[0]
    np.testing.assert_allclose(dog, 0.0, atol=1e-6)
    assert found['sheep']['as they look later'][0] < found['sheep']['as known'][0]


def test_the_recorded_dog_in_numbers(data: Path) -> None:
    found = EXPERIMENTS['real_drives']('', path=str(data))['drives']
    assert len(found) == 6
    for each in found:
        assert each['duration'] == pytest.approx(12.0)
        assert each['away'] <= each['flock_path'] + 0.1
        # 0.9 m/s ahead, and to and fro.
        assert 10.8 <= each['dog_path'] <= 12.0 * np.hypot(0.9, 0.8)


@pytest.mark.parametrize('policy', ['rule', 'planner'])
def test_real_sheep_are_herded(policy: str) -> None:
    run = EXPERIMENTS['real_herding'](
        'not aligned', policy, 2, seed=1, goal=[24.0, 32.0], time_limit=1.0, sheep=4, paths=8
    )
    assert run['duration'] == pytest.approx(1.0)
    assert 0.0 < run['dogs_run'] <= 8.0
    assert run['paths']['distance'][0] == pytest.approx(40.0, abs=3.0)
    with pytest.raises(ValueError, match="policy must be 'rule' or 'planner', got 'wolf'"):
        EXPERIMENTS['real_herding']('as fitted', 'wolf', 1, 0, [1.0, 1.0], 1.0)


def made_up(task: Task) -> dict[str, Any]:
    """Errors of 1 m straight on, 0.3 m as fitted; ours takes 30 s, the rule 20 s or fails."""
    given = task.parameters
    if task.kind == 'real_drives':
        drive = {'duration': 10.0, 'flock_path': 10.0, 'dog_path': 15.0, 'away': 9.0,
                 'dog_distance': 5.0, 'spread': 1.5}  # fmt: skip
        return {'drives': [drive, drive]}
    if task.kind == 'real_limits':
        return {'centre': {'its velocity': [0.4, 2.0, 4.0, 8.0]},
                'sheep': {'as known': [0.5, 2.0, 4.0, 8.0]}}  # fmt: skip
    if task.kind == 'real_prediction':
        off = 1.0 if given['form'] == 'constant velocity' else 0.3
        drive = {'squares': [14.0 * off**2] * 4, 'sheep': [14] * 4, 'of_centre': [0.01] * 4,
                 'flocks': [1] * 4}  # fmt: skip
        crowd = real._PRESETS[given['form']].flat() if given['noise'] else {}
        found: dict[str, Any] = {
            'crowd': {k: v for k, v in crowd.items() if isinstance(v, float)},
            'drives': [drive for _ in given['test']],
        }
        if given['form'] == 'not aligned' and given['noise']:
            found['crowd']['friction'] *= 1.1
        return found | ({'sizes': [1.0, 1.2]} if given['noise'] else {})
    time = 30.0 if given['policy'] == 'planner' else 20.0
    arrived = given['policy'] == 'planner' or given['seed'] % 2 == 0
    return {
        'arrived': arrived, 'time': time if arrived else None, 'duration': time,
        'max_spread': 2.0, 'dogs_run': 60.0,
        'paths': {'dogs': np.zeros((2, given['dogs'], 2)), 'centre': np.zeros((2, 2)),
                  'first': np.zeros((14, 2)), 'last': np.ones((14, 2))},
    }  # fmt: skip


@pytest.fixture(scope='module')
def section(tmp_path_factory: pytest.TempPathFactory) -> Section:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, 'savefig', lambda *_, **__: None)
        found = [
            (task, json.loads(json.dumps(made_up(task), default=np.ndarray.tolist)))
            for task in real.tasks(Options())
        ]
        return real.draw(Results(found), tmp_path_factory.mktemp('figures'))


def test_tables_and_goals(section: Section) -> None:
    goals = {goal.text: goal for goal in section.goals}
    assert goals['held-out drives, 1 s ahead: error of a sheep'].reached
    assert not goals['held-out drives, 10 s ahead: size of the flock over that recorded'].reached
    assert goals['the crowd of this package that is aligned is what is fitted'].reached
    assert not goals['the crowd of this package that is not aligned is what is fitted'].reached
    assert goals['sheep as fitted, dogs: 3: arrivals'].reached
    # Half of the rule's runs fail: the median is between 20 s and never.
    assert goals['sheep as fitted, dogs: 3: median time'].bound.startswith('≤ never')
    assert '| constant velocity | 1.00 | 1.00 |' in section.values['held']
    assert '| not aligned | 0.00 | 0.00 |' in section.values['gain']
    assert '| 20.0 | 20.0 | 1.00 | 40.0 | 1.50 |' in section.values['drives']
    assert section.values['limits'].splitlines()[2:] == [
        '| the crowd `aligned` | 0.100 | 0.100 | 0.100 | 0.100 |',
        '| its velocity | 0.400 | 2.00 | 4.00 | 8.00 |',
    ]
    assert '| as known | 0.500 |' in section.values['later']
    assert section.values['sizes'].startswith('1.20 m, where it is 1.00 m')


def test_the_jackknife_is_that_of_a_mean() -> None:
    """Of equally many errors on each drive, if one form is always right."""
    squares = np.random.default_rng(0).uniform(1.0, 2.0, 9)
    drives = [{'squares': [s] * 4, 'of_centre': [s] * 4, 'sheep': [1] * 4, 'flocks': [1] * 4}
              for s in squares]  # fmt: skip
    right = [{**d, 'squares': [0.0] * 4} for d in drives]
    gain = real._Prediction([{'drives': right}]).less(real._Prediction([{'drives': drives}]))[0]
    of_mean = np.std(squares, ddof=1) / 3.0
    assert gain.value == pytest.approx(np.sqrt(squares.mean()))
    assert gain.error == pytest.approx(0.5 * of_mean / gain.value, rel=0.05)  # d sqrt(m)


def test_held_out_drives_are_in_no_fit() -> None:
    predictions = [t.parameters for t in real.tasks(Options()) if t.kind == 'real_prediction']
    held = set(range(0, 29, 3))
    for given in predictions:
        assert not held & set(given['train'])
        assert not set(given['train']) & set(given['test'])
    tested = [i for g in predictions if g['form'] == 'aligned' for i in g['test']]
    assert sorted(tested) == list(range(29))


def test_without_data_the_rest_is_computed_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(EXPERIMENTS, 'real_herding', lambda **_: made_up_run)
    made_up_run = json.loads(
        json.dumps(
            made_up(Task('real_herding', {'policy': 'rule', 'seed': 0, 'dogs': 1})),
            default=np.ndarray.tolist,
        )
    )
    assert cli.main(['real', '--quick', '--jobs', '1', '--out', str(tmp_path)]) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert '12 tasks are left out, since they need DATA' in said
    assert 'no results' in (tmp_path / 'real.md').read_text(encoding='utf-8')


@pytest.mark.parametrize(
    ('arguments', 'refusal'),
    [
        (['symmetry', 'DATA'], 'DATA must not be given: symmetry has none to choose'),
        (['real', 'nowhere.npz'], 'No such file'),
    ],
)
def test_bad_data_is_refused(
    data: Path, arguments: list[str], refusal: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match='2'):
        cli.main([str(data) if word == 'DATA' else word for word in arguments])
    assert refusal in capsys.readouterr().err
