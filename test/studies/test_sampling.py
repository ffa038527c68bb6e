# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

from herding_ros.studies import sampling
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.experiments.sampling import COMPARED
from herding_ros.studies.study import Options, Results
import pytest


def test_every_estimator_gets_there_and_they_agree() -> None:
    found = EXPERIMENTS['sampling'](6, 2, 0.03, 0, 5e-3)
    assert list(found) == list(COMPARED)
    for name, each in found.items():
        assert each['standard_error'] <= 5e-3
        assert each['off'] < 4.0 * 7e-3
        assert (each['off'] == 0.0) == (name == 'plain')
        assert min(each['first'], each['again']) > 0.0
        assert each['work'] >= each['paths'][-1] * (1.0 - 1e-12)


def test_gains_are_at_equal_standard_error(tmp_path: Path) -> None:
    """Half the standard error at the same cost is worth four times as much."""
    task = sampling.tasks(Options(seeds=1, quick=True))[0]
    plain = {'standard_error': 2e-3, 'paths': [100], 'work': 100.0, 'first': 1.0, 'again': 0.5}
    ours = plain | {'standard_error': 1e-3, 'work': 50.0, 'paths': [80, 16]}
    other = {name: plain | {'off': 2e-3} for name in COMPARED}
    result = other | {'multilevel': ours | {'off': 1e-3}}
    section = sampling.draw(Results([(task, result)]), tmp_path)
    assert [str(row.ours) for row in section.rows] == ['4.00', '4.00', '8.00']
    bounds = [goal.reached for goal in section.goals]
    assert bounds == [False, False, True]
    assert '80 + 16' in section.values['costs']
    assert (tmp_path / 'sampling.png').stat().st_size > 1000


def test_distance_from_plain_is_in_standard_errors() -> None:
    task = sampling.tasks(Options(seeds=1, quick=True))[0]
    plain = {'standard_error': 3e-3}
    result = {'plain': plain, 'multilevel': {'standard_error': 4e-3, 'off': 1e-2}}
    assert float(sampling._off(Results([(task, result)]), 'multilevel')) == pytest.approx(2.0)
