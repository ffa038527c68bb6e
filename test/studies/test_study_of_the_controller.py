# SPDX-License-Identifier: Apache-2.0
"""The pictures of what the controller decides."""

from __future__ import annotations

from typing import Any

from herding_ros.studies import controller
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.study import Results
from herding_ros.studies.task import Task
import numpy as np
import pytest

HERD: dict[str, Any] = {'sheep': 6, 'dogs': 2, 'sigma': 0.01, 'seed': 1}


def test_looks_are_windows_feedbacks_and_the_answer_to_a_gust() -> None:
    run = EXPERIMENTS['looks'](
        goal=[1.0, 1.0], time_limit=11.5, gust=[0.0, 0.3], gust_at=2.4, **HERD
    )
    looks = run['looks']
    kinds = [controller._kind(look) for look in looks]
    assert [look['t'] for look in looks if look['kind'] == 'window'] == pytest.approx([0.0, 10.0])
    assert kinds.count('feedback on a surprise') == 1
    answer = looks[kinds.index('feedback on a surprise')]
    assert (answer['t'], answer['age']) == pytest.approx((2.5, 0.5))
    t, off = controller._surprise(run, looks)
    assert off[25] == pytest.approx(0.3, abs=0.02)  # nobody foresaw the gust
    assert off[30] < 0.02
    before = [look for look in looks if look['t'] < 2.5]
    np.testing.assert_array_equal(controller._surprise(run, before)[1][:26], off[:26])
    assert (controller._surprise(run, before)[1][30:40] > 0.25).all()
    assert len(t) == len(off) == 116


def test_plan_that_is_found_costs_no_more_than_its_candidates() -> None:
    found = EXPERIMENTS['candidates'](goal=[0.5, 0.5], at=0.5, start='strays', **HERD)['plans']
    *candidates, best = found
    assert len({plan['name'] for plan in found}) == len(found) > 3
    assert all(best['cost'] <= plan['cost'] for plan in candidates)
    starts = [(plan['x'][0], plan['d'][0]) for plan in found]
    assert all(start == starts[0] for start in starts)
    assert np.shape(best['x']) == (21, 6, 2)
    assert np.shape(best['d']) == (21, 2, 2)


def test_what_is_taken_from_the_square_of_the_spread_is_what_noise_adds_less_its_growth() -> None:
    run = {'paths': {'spread': np.sqrt(0.16 + 4e-4 * np.arange(101.0)).tolist()}}
    runs = Results([(Task('herding', {'seed': 0}), run)] * 2)
    places, taken, _ = controller._taken(runs, 1e-3)
    np.testing.assert_allclose(taken, 1e-3 - 4e-4)
    assert places == pytest.approx([0.425])
