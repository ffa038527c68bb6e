# SPDX-License-Identifier: Apache-2.0
from herding_ros.control.plan import Plan
from herding_ros.model.state import Array
import numpy as np
import pytest

INTERVALS = 200
PERIOD = 100_000_000  # ns
# Simulated time from zero, deep into a long run, and a wall clock of today.
STARTS = [0, 10_000_000_000, 3_400_000_000_000, 1_750_000_000_123_456_789]
starts = pytest.mark.parametrize('start', STARTS)


def seconds(ns: int) -> float:
    return ns * 1e-9


def plan_from(start: int) -> Plan:
    """Each command says which interval it belongs to."""
    u = np.arange(1.0, INTERVALS + 1.0)[:, None, None] * np.ones((1, 2, 2))
    return Plan(seconds(start), seconds(PERIOD), u)


@starts
def test_stamp_at_the_start_of_an_interval_belongs_to_it(start: int) -> None:
    plan = plan_from(start)
    found = [plan.index(seconds(start + k * PERIOD)) for k in range(-3, INTERVALS + 3)]
    assert found == list(range(-3, INTERVALS + 3))


@starts
def test_stamp_shortly_before_the_end_of_an_interval_belongs_to_it(start: int) -> None:
    plan = plan_from(start)
    found = [plan.index(seconds(start + (k + 1) * PERIOD - 10_000)) for k in range(INTERVALS)]
    assert found == list(range(INTERVALS))


@starts
def test_stamps_read_as_seconds_and_nanoseconds_agree(start: int) -> None:
    plan = plan_from(start)
    for k in range(INTERVALS):
        whole, rest = divmod(start + k * PERIOD, 1_000_000_000)
        assert plan.index(whole + rest * 1e-9) == k


@pytest.mark.parametrize('rate', [3, 30, 60, 144])
def test_periods_of_no_whole_nanoseconds_are_rounded_to_stamps(rate: int) -> None:
    plan = Plan(seconds(STARTS[1]), 1.0 / rate, np.zeros((INTERVALS, 1, 2)))
    stamps = [STARTS[1] + round(k * 1e9 / rate) for k in range(INTERVALS)]
    assert [plan.index(seconds(stamp)) for stamp in stamps] == list(range(INTERVALS))


@starts
def test_commands_are_those_of_the_interval_and_zero_outside(start: int) -> None:
    plan = plan_from(start)

    def command(ns: int) -> Array:
        return plan.at(seconds(start + ns))

    for k in range(INTERVALS):
        np.testing.assert_array_equal(command(k * PERIOD), np.full((2, 2), k + 1.0))
        np.testing.assert_array_equal(command(k * PERIOD + PERIOD // 2), command(k * PERIOD))
    for outside in (-PERIOD, -PERIOD // 2, INTERVALS * PERIOD, (INTERVALS + 50) * PERIOD):
        np.testing.assert_array_equal(command(outside), np.zeros((2, 2)))


@starts
@pytest.mark.parametrize('k', [0, 1, 100, 199, 200, 300])
def test_shifted_plan_goes_on_as_planned_and_holds_the_end(start: int, k: int) -> None:
    plan = plan_from(start)
    later = plan.shifted(seconds(start + k * PERIOD))
    assert later.u.shape == plan.u.shape
    assert later.t0 == seconds(start + k * PERIOD)
    assert later.dt == plan.dt
    expected = [min(k + i, INTERVALS - 1) + 1.0 for i in range(INTERVALS)]
    np.testing.assert_array_equal(later.u[:, 0, 0], expected)


def test_shifted_to_before_the_start_the_beginning_is_held() -> None:
    earlier = plan_from(STARTS[1]).shifted(seconds(STARTS[1] - 2 * PERIOD))
    assert list(earlier.u[:5, 0, 0]) == [1.0, 1.0, 1.0, 2.0, 3.0]


def test_end_is_when_the_last_interval_is_played() -> None:
    assert plan_from(STARTS[1]).end == pytest.approx(30.0, abs=1e-9)


@pytest.mark.parametrize('u', [np.zeros((5, 2)), np.zeros((5, 1, 3)), np.full((5, 1, 2), np.nan)])
def test_bad_velocities_are_refused(u: Array) -> None:
    with pytest.raises(ValueError, match='plan u'):
        Plan(0.0, 0.1, u)
