# SPDX-License-Identifier: Apache-2.0
"""The program `fit`, from a table to a parameter file that nodes take."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from herding_ros.control.parameters import Sensor
from herding_ros.fit.cli import _in_words, main
from herding_ros.fit.estimate import Estimate, Fit
from herding_ros.fit.forecast import Forecast
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.simulation import World
import numpy as np
import pytest
from recorded import record
import yaml


@pytest.fixture(scope='module')
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flock and its dog in a CSV file, 20 s."""
    path = tmp_path_factory.mktemp('recording') / 'flock.csv'
    seen = record(Crowd(), World(sheep=10, dogs=2, seed=3), 20.0)
    with path.open('w', newline='') as file:
        rows = csv.writer(file)
        rows.writerow(['time', 'name', 'x', 'y', 'vx', 'vy'])
        for k, t in enumerate(seen.times):
            for i, (x, v) in enumerate(zip(seen.x[k], seen.v[k], strict=True)):
                rows.writerow([t, f'sheep_{i}', *x, *v])
            for m, d in enumerate(seen.d[k]):
                rows.writerow([t, f'dog_{m}', *d, '', ''])
    return path


def flat(tree: dict[str, Any], prefix: str = '') -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in tree.items():
        out |= flat(value, f'{prefix}{key}.') if isinstance(value, dict) else {prefix + key: value}
    return out


def test_from_a_table_to_parameters(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'new' / 'crowd.yaml'
    assert main([str(table), '--out', str(out), '--hold', 'crowd.sheep.']) == 0
    said = capsys.readouterr().out
    assert '10 sheep, 2 dogs, 19.9 s, 200 instants' in said
    assert 'crowd.dog.attraction cannot be told: it has hardly any effect here' in said
    assert 'not fitted: crowd.sheep.repulsion,' in said
    assert '1 s ahead: positions off by' in said
    assert out.with_suffix('.png').read_bytes().startswith(b'\x89PNG')

    text = out.read_text()
    values = flat(yaml.safe_load(text)['/**']['ros__parameters'])
    assert values.pop('crowd.preset') == 'cohesive'
    sensor = {name: values.pop(f'sensor.{name}') for name in ('position_noise', 'velocity_noise')}
    crowd = CROWDS['cohesive'].with_values(values, 'crowd.')
    # ROS takes no 1 for 1.0: types are those of the fields.
    assert {k: type(v) for k, v in values.items() if not isinstance(v, list)} == {
        k: type(v) for k, v in Crowd().flat('crowd.').items() if not isinstance(v, tuple)
    }
    assert crowd.sheep == Crowd().sheep
    assert crowd.noise == pytest.approx(0.01, rel=0.1)
    assert sensor['position_noise'] == pytest.approx(0.01, rel=0.05)
    told = next(line for line in text.splitlines() if line.strip().startswith('friction:'))
    low, high = (float(word) for word in told.split('#')[1].split(' to '))
    assert low < crowd.friction < high
    untold = next(line for line in text.splitlines() if 'hardly any effect' in line)
    assert 'attraction' in untold


def test_what_would_be_told_with_the_rest_held_is_said() -> None:
    """Of two with a correlation of 0.8, one of them untold: 0.6 of the interval is left."""
    correlation = np.array([[1.0, 0.8], [0.8, 1.0]])
    told = Estimate('crowd.dog.repulsion', 'm^2/s^2', 1.0, 0.2, 0.1, False)
    untold = Estimate('crowd.dog.attraction', 'm^2/s^2', 1.0, 2.0, 2.0, False)
    found = Fit(Crowd(), Sensor(), (told, untold), correlation, (), True, 1)
    judged = [Forecast(0.0, *np.ones((4, 3)))]
    low, high = np.exp(np.array([-1.0, 1.0]) * 1.96 * 0.2 * 0.6)
    line = f'if you know them: crowd.dog.repulsion {low:.3g} to {high:.3g}'
    assert any(each.endswith(line) for each in _in_words(found, judged))
    weak = Fit(Crowd(), Sensor(), (told, untold), np.eye(2), (), True, 1)
    assert not any('if you know them' in each for each in _in_words(weak, judged))


@pytest.mark.parametrize(
    ('arguments', 'refusal'),
    [
        (['no.csv'], 'No such file'),
        (['TABLE', '--lead', '99'], 'shorter than the recording'),
        (['TABLE', '--hold', 'wool'], 'hold must be among crowd.sheep.repulsion'),
        (['TABLE', '--step', '0'], 'step must be above 0, got 0'),
        (['TABLE', '--position-noise', '-1'], 'position_noise must be at least 0, got -1'),
    ],
)
def test_bad_arguments(
    table: Path,
    tmp_path: Path,
    arguments: list[str],
    refusal: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = [str(table) if word == 'TABLE' else word for word in arguments]
    assert main([*given, '--out', str(tmp_path / 'crowd.yaml')]) == 2
    said = capsys.readouterr().err
    assert said.startswith('fit: ')
    assert refusal in said
    assert not (tmp_path / 'crowd.yaml').exists()


def test_a_crowd_of_another_kind_is_called_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sheep that walk in circles at different paces: no crowd of ours."""
    path = tmp_path / 'circles.csv'
    times, rng = 0.1 * np.arange(150), np.random.default_rng(0)
    with path.open('w', newline='') as file:
        rows = csv.writer(file)
        rows.writerow(['time', 'name', 'x', 'y'])
        for t in times:
            for i in range(5):
                angle = 0.5 * t + i
                place = (1.0 + 0.3 * i) * np.array([np.cos(angle), np.sin(angle)])
                rows.writerow([t, f'sheep_{i}', *(place + 0.001 * rng.standard_normal(2))])
            rows.writerow([t, 'dog', 9.0, 9.0])
    hold = ['crowd.sheep.', 'crowd.dog.']
    main([str(path), '--out', str(tmp_path / 'c.yaml'), '--hold', *hold])
    assert 'sheep are not quite of its kind' in capsys.readouterr().out
