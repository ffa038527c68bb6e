# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
import dataclasses
import math
import re

from herding_ros.control.parameters import (
    check_lockstep,
    Control,
    Horizon,
    Mapping,
    Optimiser,
    OutOfStepError,
    PAPER,
    Reference,
    Sensor,
    Weights,
)
from herding_ros.control.space_mapping import MIN_DECREASE
from herding_ros.model.parameters import Parameters
from herding_ros.model.simulation import World
import pytest

GROUPS = [Weights, Reference, Horizon, Optimiser, Mapping, Sensor, Control]


@pytest.mark.parametrize(
    ('make', 'named'),
    [
        (lambda: Weights(control=0.0), 'Weights.control is 0.0'),
        (lambda: Weights(centre=-1.0), 'Weights.centre is -1.0'),
        (lambda: Weights(spread=math.nan), 'Weights.spread is nan'),
        (lambda: Reference(kind='straight'), "Reference.kind is 'straight'"),
        (lambda: Optimiser(method='newton'), "Optimiser.method is 'newton'"),
        (lambda: Optimiser(max_iterations=0), 'Optimiser.max_iterations is 0'),
        (lambda: Mapping(estimator='spread'), "Mapping.estimator is 'spread'"),
        (lambda: Mapping(paths=1), 'Mapping.paths is 1'),
        (lambda: Mapping(paths=10_001), 'Mapping.paths is 10001'),
        (lambda: Mapping(max_iterations=-1), 'Mapping.max_iterations is -1'),
        (lambda: Sensor(position_noise=-0.01), 'Sensor.position_noise is -0.01'),
        (lambda: Sensor(velocity_noise=math.inf), 'Sensor.velocity_noise is inf'),
        (lambda: Control(max_speed=math.inf), 'Control.max_speed is inf'),
        (lambda: Control(max_speed='5'), "Control.max_speed is '5'"),
        (lambda: Control(weights=None), 'Control.weights is None'),
        (lambda: Horizon(length=20.05), 'Horizon.length is 20.05'),
        (lambda: Horizon(accepted=0.01), 'Horizon.accepted is 0.01'),
        (lambda: Horizon(accepted=30.0), 'Horizon.accepted is 30.0'),
        (lambda: Horizon(length=201.0), 'Horizon.length is 201.0'),
        (lambda: Horizon(substeps=0), 'Horizon.substeps is 0'),
        (lambda: Horizon(control_period=-0.1), 'Horizon.control_period is -0.1'),
    ],
)
def test_refusal_names_field_value_and_what_is_allowed(
    make: Callable[[], Parameters], named: str
) -> None:
    name, value = map(re.escape, named.split(' is '))
    with pytest.raises(ValueError, match=f'^{name} must be .*, got {value}$'):
        make()


@pytest.mark.parametrize('group', GROUPS)
def test_every_field_is_explained(group: type[Parameters]) -> None:
    for field in dataclasses.fields(group):
        assert field.metadata.get('doc') or isinstance(field.default, Parameters)


def test_time_grids_fit_into_each_other() -> None:
    horizon = Horizon(length=20.0, accepted=10.0, control_period=0.1, substeps=10)
    assert horizon.intervals == 200
    assert horizon.dt == pytest.approx(0.01)


def test_paper_is_the_papers_own_setting() -> None:
    assert PAPER.weights == Weights(
        distance=0.0, centre=1.0, spread=1.0, control=1e-2, dogs=0.0, beyond=0.0, terminal=0.0
    )
    assert not PAPER.optimiser.rules
    assert PAPER.max_speed == 5e-2
    assert PAPER.reference.kind == 'interpolated'
    assert (PAPER.horizon.length, PAPER.horizon.accepted) == (20.0, 10.0)
    assert PAPER.optimiser.step_tolerance == 5e-3
    assert (PAPER.mapping.method, PAPER.mapping.residual) == ('aggressive', 0.3)
    assert PAPER.mapping.paths == 100
    assert MIN_DECREASE == 5e-3


def test_commands_are_as_long_for_the_controller_as_for_the_world() -> None:
    check_lockstep(Horizon().control_period, World(dt=0.02, substeps=5).control_period)
    with pytest.raises(OutOfStepError, match=r'must be .* of the sim .* 0\.05 s, got 0\.1 s'):
        check_lockstep(Horizon().control_period, World(dt=0.01, substeps=5).control_period)
