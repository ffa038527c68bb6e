# SPDX-License-Identifier: Apache-2.0
"""Runs in fields, and the page about them."""

from pathlib import Path
from typing import Any

from herding_ros.model.field import Field
from herding_ros.studies import fields
from herding_ros.studies.experiments.fields import crossings, run
from herding_ros.studies.study import Options, Results
import numpy as np
import pytest


def test_crossings_of_a_wall_are_counted() -> None:
    field = Field(fences=(((0.0, -1.0), (0.0, 1.0)),))
    x = np.array(
        [[[-0.5, 0.0], [-0.5, 2.0]], [[0.5, 0.5], [0.5, 2.0]], [[-0.5, -3.0], [0.5, 3.0]]]
    )
    assert crossings(field, x) == 1  # there through it, back round it, and one past its end


@pytest.mark.parametrize('policy', ['planner', 'strombom'])
def test_a_herd_sets_out_in_a_field(policy: str) -> None:
    found = run('pen', policy, 3, 0, 1.0, paths=8)
    assert found['duration'] == 1.0
    assert (found['crossings'], found['stops'], found['inside']) == (0, 0, 0)
    assert found['gap'] > 0.05
    assert found['dogs_run'] > 0.03
    assert len(found['snapshots']) == 5


def test_policies_without_a_name_are_refused() -> None:
    with pytest.raises(ValueError, match="must be 'planner' or 'strombom', got 'wolf'"):
        run('pen', 'wolf', 3, 0, 1.0)


def test_the_page_tells_arrivals_of_each_field(tmp_path: Path) -> None:
    one = run('island', 'strombom', 3, 0, 0.2)

    def result(task: Any) -> dict[str, Any]:
        p = task.parameters
        home = p['policy'] == 'planner' and not (p['field'] == 'pen' and p['seed'] < 3)
        return {**one, 'arrived': home, 'time': 100.0 + p['seed'] if home else None}

    tasks = fields.tasks(Options())
    assert len(tasks) == 20 * 3 * 5 * 2
    section = fields.draw(Results([(task, result(task)) for task in tasks]), tmp_path)
    assert {goal.reached for goal in section.goals if 'pen' in goal.text} == {False}
    assert {goal.reached for goal in section.goals if 'pen' not in goal.text} == {True}
    assert '| pen | 3 | ours | 17 of 20' in section.values['runs']
    assert '| corner | 5 | heuristic | 0 of 20' in section.values['runs']
    assert (tmp_path / 'fields-meadow.png').exists()
    assert fields.draw(Results([]), tmp_path).goals == []
