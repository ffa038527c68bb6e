# SPDX-License-Identifier: Apache-2.0
"""One window: direct optimisation, the controller's mapping, and variants of Algorithm 1."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from herding_ros.control.costs.tracking import Tracking
from herding_ros.control.objective import Objective
from herding_ros.control.parameters import Control, Horizon, Optimiser, PAPER
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import centre
from herding_ros.model.motion import Holonomic
from herding_ros.model.noise import noise_paths
from herding_ros.studies.experiments import EXPERIMENTS
from herding_ros.studies.experiments.case import Case
from herding_ros.studies.experiments.direct import pathwise_gradient
from herding_ros.studies.runs import settings_of
import numpy as np
import pytest

project = Holonomic().project

SHORT = Horizon(length=8.0, accepted=4.0)
MAPPING = replace(
    PAPER.mapping, method='output', paths=20, max_iterations=2, tolerance=0.0, residual=0.0
)
CONTROL = replace(PAPER, horizon=SHORT, mapping=MAPPING)
HERD = {'sheep': 9, 'dogs': 2, 'sigma': 0.03, 'seed': 1}


def case(sigma: float = 0.03) -> Case:
    return Case(9, 2, sigma, 1, CONTROL)


def test_settings_are_the_differences_from_the_default() -> None:
    for control in (Control(), PAPER, CONTROL, replace(PAPER, optimiser=Optimiser('ncg'))):
        assert Control().with_values(settings_of(control)) == control
    assert settings_of(Control()) == {}
    with pytest.raises(ValueError, match=r'Mapping\.paths must be .* got 0'):
        Control().with_values({'mapping.paths': 0})


def test_pathwise_gradient_is_the_derivative() -> None:
    """Central differences in random directions; their error falls with the square."""
    each, rng = case(), np.random.default_rng(3)
    model, target = each.coarse, each.deterministic.centre
    noise = noise_paths(rng, each.crowd, 9, model.dt, len(target) - 1, 7)
    u = project(rng.uniform(-0.05, 0.05, each.deterministic.plan.u.shape), 0.05)
    value = partial(pathwise_gradient, model, noise, target)
    _, gradient = value(u)
    for _ in range(3):
        h = rng.standard_normal(u.shape)
        slope = model.inner(gradient, h)
        errors = [
            abs((value(u + e * h)[0] - value(u - e * h)[0]) / (2.0 * e) - slope)
            for e in (2e-3, 2e-4)
        ]
        assert errors[0] < 0.02 * abs(slope)
        assert errors[1] < max(0.02 * errors[0], 1e-7 * abs(slope))


def test_value_is_that_of_the_mean_over_paths() -> None:
    each = case()
    model, target, u = each.coarse, each.deterministic.centre, each.deterministic.plan.u
    rng = np.random.default_rng(each.seen)
    noise = noise_paths(rng, each.crowd, 9, model.dt, len(target) - 1, 20)
    value, _ = pathwise_gradient(model, noise, target, u)
    singles = [
        rollout(each.crowd, each.state, u, model.dt, model.substeps, noise.path(i)).x
        for i in range(20)
    ]
    assert np.sqrt(2.0 * value) == pytest.approx(
        each.error(centre(np.mean(singles, axis=0))), rel=1e-9
    )


def test_without_noise_the_gradient_is_that_of_the_coarse_model() -> None:
    each = case(0.0)
    model, target = each.coarse, each.deterministic.centre + 0.01
    u = 0.5 * each.deterministic.plan.u
    noise = noise_paths(np.random.default_rng(0), each.crowd, 9, model.dt, len(target) - 1, 3)
    objective = Objective([Tracking(1.0, 0.0, target)])
    expected = model.value_and_gradient(objective, u)
    found = pathwise_gradient(model, noise, target, u)
    assert found[0] == pytest.approx(expected[0], rel=1e-12)
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-9, atol=1e-15)


def test_direct_optimisation_and_mapping_start_from_the_same_error() -> None:
    settings = settings_of(CONTROL)
    direct = EXPERIMENTS['direct'](
        **HERD, paths=20, iterations=12, judge_paths=200, control=settings
    )
    mapped = EXPERIMENTS['window'](**HERD, judge_paths=200, trace=False, control=settings)
    assert direct['before'] == pytest.approx(mapped['before'], rel=1e-9)
    assert direct['after'] < 0.7 * direct['before']
    assert len(direct['errors']) >= 6
    assert mapped['after'] < mapped['before']
    assert mapped['calls']['fine'] == mapped['iterations'] + 1 == 3


def test_judging_is_on_other_noise_and_the_same_for_all() -> None:
    each = case()
    u = each.deterministic.plan.u
    first, uncertainty = each.judge(u, 400)
    again, _ = each.judge(u, 400)
    np.testing.assert_array_equal(first, again)
    more, _ = each.judge(u, 4000)
    assert 0.3 < each.error(each.deterministic.centre + first - more) / uncertainty < 3.0
    control = replace(CONTROL, mapping=replace(CONTROL.mapping, paths=100))
    report = each.plan(control).report
    seen = report.mapping_error_before
    assert abs(each.error(first) - seen) > 1e-6 * seen


def variant(**changes: Any) -> dict[str, Any]:
    given = {
        'optimiser': 'spg',
        'observable': 'centre',
        'common_numbers': True,
        'broyden': True,
        'iterations': 2,
    } | changes
    settings = settings_of(CONTROL)
    return EXPERIMENTS['variant'](**HERD, paths=20, judge_paths=200, control=settings, **given)


def test_the_variant_with_everything_is_the_controllers_aggressive_mapping() -> None:
    mapping = replace(MAPPING, method='aggressive')
    report = case().plan(replace(CONTROL, mapping=mapping)).report
    found = variant()
    assert found['before'] == pytest.approx(report.mapping_error_before, rel=1e-12)
    assert found['first_residual'] == pytest.approx(report.mapping_residuals[0], rel=0.1)
    assert found['after'] == pytest.approx(report.mapping_error_after, rel=0.15)


def test_each_switch_changes_what_it_should() -> None:
    base = variant()
    plain = variant(broyden=False)
    # Both start with B = I, so that they part at the second correction.
    assert plain['misfits'][:2] == base['misfits'][:2]
    assert plain['misfits'][2] != base['misfits'][2]
    fresh = variant(common_numbers=False)
    assert fresh['misfits'][0] == base['misfits'][0]
    assert fresh['misfits'][1] != base['misfits'][1]
    assert variant(observable='individuals')['first_residual'] != base['first_residual']
    other = variant(optimiser='ncg')
    assert other['first_residual'] == pytest.approx(base['first_residual'], rel=0.1)
    assert other['calls']['extraction'] != base['calls']['extraction']
