# SPDX-License-Identifier: Apache-2.0
"""A number of the solve report has one name, from the controller to the studies and reports."""

import dataclasses

from herding_ros.bag.recorded_run import Replan
from herding_ros.control.parameters import Control, Horizon, Mapping
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.solution import Status
from herding_ros.control.solve_report import SolveReport
from herding_ros.model.crowd import Crowd
from herding_ros.model.scenario import initial_herd
import numpy as np

REPORT = SolveReport(
    kind='window',
    status=Status.OUT_OF_TIME,
    objective=0.25,
    gradient_norm=1e-3,
    optimiser_iterations=20,
    optimiser_calls=31,
    fine_calls=3,
    paths=(12_345, 16),
    standard_error=1e-3,
    extraction_calls=7,
    mapping_status=Status.CONVERGED,
    mapping_iterations=2,
    mapping_residuals=(0.123456, 0.0625),
    mapping_error_before=0.5,
    mapping_error_after=0.125,
    felt_strength=0.5,
    felt_range=2.0,
    seconds={'coarse': 0.5, 'fine': 0.25, 'extraction': 0.125, 'total': 1.0},
)


def test_values_are_all_there_is_under_the_names_of_the_fields() -> None:
    values = REPORT.values()
    names = {field.name for field in dataclasses.fields(REPORT)} - {'seconds'}
    assert set(values) == names | {'solve_ms', 'coarse_ms', 'fine_ms', 'extraction_ms'}
    assert (values['status'], values['mapping_status']) == ('out of time', 'converged')
    assert (values['paths'], values['mapping_residuals']) == ('12345 16', '0.123 0.0625')
    assert (values['solve_ms'], values['extraction_ms']) == (1000.0, 125.0)
    for name in names - {'kind', 'status', 'mapping_status', 'paths', 'mapping_residuals'}:
        assert values[name] == getattr(REPORT, name)


def test_a_bag_has_numbers_of_the_report_under_their_names() -> None:
    names = {field.name for field in dataclasses.fields(Replan)}
    assert names - {'time', 'number', 'deadline_margin_s'} <= set(REPORT.values())


def test_seconds_are_accounted_for() -> None:
    state = initial_herd(4, 2, np.ones(2), np.random.default_rng(0))
    control = Control(horizon=Horizon(length=10.0, accepted=5.0), mapping=Mapping(paths=20))
    planner = RecedingHorizon(Crowd(noise=0.02), control, np.ones(2))
    planner.solve(state, 0.0)  # what is compiled at the first call is not counted
    seconds = planner.solve(state, 5.0).report.seconds
    assert set(seconds) == {'coarse', 'fine', 'extraction', 'total'}
    parts = seconds['coarse'] + seconds['fine'] + seconds['extraction']
    assert 0.5 * seconds['total'] < parts <= seconds['total']
