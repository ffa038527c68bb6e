# SPDX-License-Identifier: Apache-2.0
"""No number of the planner belongs to one world: in another one the same run is found.

Where lengths are L times and times T times as long, all parameters are converted by their units.
Then every equation is the same, and so must be the run, converted. For powers of four all
conversions are exact, and the bits are equal.
"""

from dataclasses import replace

from herding_ros.control.closed_loop import closed_loop, ClosedLoopRun
from herding_ros.control.parameters import (
    Control,
    CONTROLS,
    Horizon,
    Mapping,
    PAPER,
    Sensor,
)
from herding_ros.control.scale import control_of, Scale
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.potentials import Morse, PowerLaw
from herding_ros.model.simulation import World
import numpy as np
import pytest

REFERENCE = World(sheep=20, dogs=3, seed=4)
GOAL = np.array([0.5, 0.5])
FILTERING = Sensor(position_noise=0.01, velocity_noise=0.005)
SHORT = Horizon(length=8.0, accepted=4.0)
LARGE = World(sheep=60, dogs=2, seed=1)

CASES = {
    'default': (Crowd(), REFERENCE, Control(), 3.0),
    'first seconds': (Crowd(), REFERENCE, Control(), 1.5),
    'whole': (Crowd(), REFERENCE, Control(), 60.0),
    'paper': (Crowd(noise=0.02), REFERENCE, replace(PAPER, horizon=SHORT), 5.0),
    'filter': (Crowd(), REFERENCE, Control(sensor=FILTERING, horizon=SHORT), 2.0),
    'guided': (CROWDS['guided'], REFERENCE, Control(horizon=SHORT), 5.0),
    'independent': (CROWDS['independent'], REFERENCE, Control(horizon=SHORT), 5.0),
    'table': (Crowd(sheep=PowerLaw()), REFERENCE, Control(horizon=SHORT), 3.0),
    'mean field': (
        Crowd(),
        LARGE,
        Control(horizon=SHORT, coarse=replace(Control().coarse, markers=8)),
        1.5,
    ),
    'ncg': (
        Crowd(),
        REFERENCE,
        replace(PAPER, horizon=SHORT, optimiser=replace(PAPER.optimiser, method='ncg')),
        3.0,
    ),
    'corrected feedback': (
        Crowd(noise=0.03),
        REFERENCE,
        Control(horizon=SHORT, mapping=Mapping(feedback=True, paths=20)),
        2.0,
    ),
}


def in_world(case: str, length: float, time: float) -> ClosedLoopRun:
    """Return the run of a case where lengths and times are longer, converted back."""
    crowd, world, control, limit = CASES[case]
    run = closed_loop(
        crowd.rescaled(length, time),
        world.rescaled(length, time),
        control.rescaled(length, time),
        GOAL * length,
        limit * time,
    )
    return replace(
        run, t=run.t / time, x=run.x / length, d=run.d / length, u=run.u * time / length
    )


WORK = (
    *('kind', 'status', 'optimiser_iterations', 'optimiser_calls', 'fine_calls', 'paths'),
    *('extraction_calls', 'mapping_iterations'),
)


def work(run: ClosedLoopRun) -> list[list[object]]:
    """Return what was done in each solve."""
    return [[getattr(report, name) for name in WORK] for report in run.reports]


@pytest.mark.parametrize(
    'case', [case for case in CASES if case not in ('filter', 'first seconds', 'whole')]
)
def test_the_same_bits_in_a_world_of_powers_of_four(case: str) -> None:
    here, there = in_world(case, 1.0, 1.0), in_world(case, 64.0, 1.0 / 64.0)
    assert work(there) == work(here)
    for name in ('t', 'x', 'd', 'u'):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name), name)


@pytest.mark.parametrize(
    ('case', 'length', 'time'),
    [('first seconds', 40.0, 1.0 / 60.0), ('filter', 40.0, 1.0 / 60.0), ('paper', 0.3, 7.0)],
)
def test_the_same_run_but_for_rounding_in_any_world(
    case: str, length: float, time: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Iterations let rounding errors grow to 1e-5 in a window of 20 s, and with each look.

    So sensors must not round to 1e-8.
    """
    monkeypatch.setattr('herding_ros.model.simulation.single', lambda values: values)
    here, there = in_world(case, 1.0, 1.0), in_world(case, length, time)
    assert work(there) == work(here)
    error = 1e-4 if case == 'first seconds' else 1e-7
    for name in ('x', 'd', 'u'):
        np.testing.assert_allclose(
            getattr(there, name), getattr(here, name), rtol=0, atol=error, err_msg=name
        )


@pytest.mark.statistics
def test_whole_runs_take_as_long_and_as_much_work_in_any_world() -> None:
    here, there = in_world('whole', 1.0, 1.0), in_world('whole', 40.0, 1.0 / 60.0)
    assert here.arrived
    assert there.arrived
    assert there.t[-1] == pytest.approx(here.t[-1], abs=0.5)
    iterations = [sum(each.optimiser_iterations for each in run.reports) for run in (here, there)]
    assert iterations[1] == pytest.approx(iterations[0], rel=0.1)


@pytest.mark.parametrize('crowd', CROWDS.values(), ids=CROWDS)
@pytest.mark.parametrize(('length', 'time'), [(64.0, 1.0 / 32.0), (0.25, 8.0)])
def test_scale_follows_crowd_and_dogs_by_powers_of_two(
    crowd: Crowd, length: float, time: float
) -> None:
    here = Scale.of(crowd, 0.05)
    there = Scale.of(crowd.rescaled(length, time), 0.05 * length / time)
    assert there == Scale(length * here.length, time * here.time)


def test_scale_of_the_reference_scenario_leaves_all_defaults() -> None:
    for crowd in (Crowd(), Crowd(noise=0.03), Crowd(sheep=PowerLaw())):
        scale = Scale.of(crowd, 0.05)
        assert scale == Scale(1.0, 1.0)
        for defaults in (*CONTROLS.values(), World()):
            assert scale.apply(defaults) == defaults


def test_times_follow_dogs_and_sheep_alike() -> None:
    """Dogs sixteen times as fast, and sheep that follow as much more slowly."""
    assert Scale.of(Crowd(), 16.0 * 0.05).time == 1.0 / 4.0
    assert Scale.of(Crowd(friction=0.5 / 16.0), 0.05).time == 4.0
    assert Scale.of(Crowd(friction=0.0), 16.0 * 0.05).time == 1.0 / 16.0


def test_crowd_that_notices_no_dogs_has_the_scale_of_the_reference() -> None:
    indifferent = Crowd(dog=Morse(0.0, 0.5, 0.0, 2.0))
    assert Scale.of(indifferent, 4.0) == Scale(1.0, 1.0)


@pytest.mark.parametrize('control_period', [0.03, 0.07, 0.1, 3.0])
@pytest.mark.parametrize('max_speed', [1.0, 4.0])
def test_control_of_a_plant_has_its_period_and_the_scale_of_its_dogs(
    control_period: float, max_speed: float
) -> None:
    crowd = Crowd().rescaled(20.0, 1.0)
    usual = Scale.of(crowd, max_speed).apply(Control()).horizon
    control = control_of(crowd, max_speed, control_period)
    assert control.max_speed == max_speed
    found = control.horizon
    assert found.control_period == control_period
    for name in ('length', 'accepted', 'feedback'):
        shortest = max(getattr(usual, name), control_period)
        assert getattr(found, name) == pytest.approx(shortest, abs=0.51 * control_period)
    assert found.dt <= usual.dt * (1.0 + 1e-6)
    if control_period == usual.control_period:
        assert found == usual


@pytest.mark.parametrize('value', [0.0, -0.1, np.nan, np.inf])
def test_speeds_and_periods_that_are_none_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match=rf'^max_speed must be a number above 0, got {value}$'):
        control_of(Crowd(), value, 0.1)
    with pytest.raises(
        ValueError, match=rf'^control_period must be a number above 0, got {value}$'
    ):
        control_of(Crowd(), 0.05, value)


@pytest.mark.statistics
def test_field_is_herded_with_nothing_but_crowd_speed_and_goal() -> None:
    """And in less time than with a window of the reference scenario, which took 42 s."""
    crowd = Crowd().rescaled(20.0, 1.0)
    scale = Scale.of(crowd, 4.0)
    control = replace(scale.apply(Control()), max_speed=4.0)
    world = replace(scale.apply(replace(REFERENCE, seed=0)), max_speed=4.0)
    assert control.horizon.length == 20.0 * scale.time
    run = closed_loop(crowd, world, control, np.array([10.0, 10.0]), 40.0)
    assert run.arrived
