# SPDX-License-Identifier: Apache-2.0
"""Commands on their way from a plan to the dogs."""

from herding_ros.control.command_filter import CommandFilter
from herding_ros.control.parameters import Bodies, Control, PAPER
from herding_ros.model.bodies import closest
from herding_ros.model.field import Field
from herding_ros.model.motion import Accelerating, Unicycle
from herding_ros.model.state import HerdState
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

BODIES = Bodies(separation=0.1, margin=0.0, ramp=0.0)
ALL = (0, 1, 2)
D = np.array([[0.0, 0.0], [0.12, 0.0], [0.0, 3.0]])
U = np.array([[0.05, 0.0], [-0.05, 0.0], [0.0, 0.05]])
STAND = np.zeros((3, 2))


def state(d=D, x=((9.0, 9.0),)):
    x = np.array(x)
    return HerdState(x, np.zeros_like(x), np.array(d))


def filtered(bodies, asked=U, last=STAND, herd=None, dogs=ALL, filter=None):
    filter = CommandFilter(3) if filter is None else filter
    herd = state() if herd is None else herd
    return filter.filtered(asked, last, herd, dogs, Control(bodies=bodies))


def test_dogs_that_would_meet_are_slowed_down_and_others_are_not():
    command = filtered(BODIES)
    assert command.changed
    assert not command.too_near
    closing = (command.u[0] - command.u[1])[0]
    assert 0.0 < closing * 0.1 < 0.02  # less than there is between them, in a control period
    assert (command.u[2] == U[2]).all()


def test_the_paper_s_commands_are_those_of_its_plans():
    command = filtered(PAPER.bodies, last=-U, herd=state(np.zeros((3, 2))))
    assert not command.changed
    assert (command.u == U).all()


def test_margin_and_delay_keep_dogs_farther_apart():
    def closing(**changes):
        u = filtered(Bodies(separation=0.1, ramp=0.0, **changes)).u
        return (u[0] - u[1])[0]

    near, wide = closing(margin=0.0), closing(margin=0.01)
    assert wide < near
    assert closing(margin=0.0, delay=1.0) < near


def test_a_command_changes_by_no_more_than_the_ramp_allows():
    bodies = Bodies(separation=0.0, ramp=0.5)
    last = -U
    for _ in range(20):
        u = filtered(bodies, last=last).u
        assert np.linalg.norm(u - last, axis=1).max() <= 0.05 * 0.1 / 0.5 + 1e-15
        last = u
    assert u == pytest.approx(U, abs=1e-15)


def test_smooth_commands_keep_dogs_apart_that_run_at_each_other_with_noisy_odometry():
    rng = np.random.default_rng(0)
    bodies = Bodies()
    d = D + np.array([[-0.3, 0.0], [0.3, 0.01], [0.0, 0.0]])
    last, filter = STAND, CommandFilter(3)
    nearest, largest = np.inf, 0.0
    for _ in range(300):
        seen = state(d + 0.01 * rng.normal(size=d.shape))
        u = filtered(bodies, last=last, herd=seen, filter=filter).u
        largest = max(largest, np.linalg.norm(u - last, axis=1).max())
        d, last = d + 0.1 * u, u
        nearest = min(nearest, np.linalg.norm(d[0] - d[1]))
    assert 0.1 <= nearest < 0.2
    assert largest < 0.3 * 0.05
    assert d[0, 0] > d[1, 0] + 0.2  # they have passed


def test_a_dog_that_is_hidden_stands_in_the_way_and_keeps_its_command():
    filter = CommandFilter(3)
    bodies = Bodies(separation=0.1, margin=0.0, ramp=0.5)
    filtered(bodies, filter=filter)
    stopped = U.copy()
    stopped[1] = 0.0
    command = filtered(
        bodies, stopped, U, state([[0.02, 0.0], [0.0, 3.0]]), (0, 2), filter
    )  # dog 0 has come up to dog 1
    assert (command.u[1] == 0.0).all()
    assert command.u[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert command.changed


def test_a_dog_keeps_from_sheep():
    bodies = Bodies(separation=0.0, sheep_distance=0.1, margin=0.0, ramp=0.0)
    command = filtered(bodies, herd=state(x=[[0.1, 0.0], [5.0, 5.0]]))
    assert command.u[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert command.changed
    behind = filtered(bodies, STAND, herd=state(x=[[0.0, -0.09]])).u
    assert behind[0] == pytest.approx([0.0, 0.01 / (np.e * 0.35)], rel=1e-3)
    assert not behind[1:].any()
    meeting = filtered(bodies)  # and from sheep only
    assert not meeting.changed
    assert (meeting.u == U).all()


def test_a_pair_that_is_too_near_is_noticed_and_parts():
    herd = state([[0.0, 0.0], [0.05, 0.0], [0.0, 3.0]])
    command = filtered(BODIES, herd=herd)
    assert command.too_near
    assert command.u[0, 0] < 0.0 < command.u[1, 0]


def test_separation_that_dogs_cannot_have_without_touching_is_refused():
    with pytest.raises(ValueError, match=r'at least twice the radius, 0\.2 m, got 0\.15'):
        Bodies(radius=0.1, separation=0.15)


@given(
    seed=st.integers(0, 2**32 - 1),
    dogs=st.integers(1, 20),
    acceleration=st.floats(0.005, 1.0),
    late=st.integers(0, 3),
)
@settings(max_examples=10, deadline=None)
def test_dogs_that_follow_slowly_never_come_too_near(seed, dogs, acceleration, late):
    """Whatever they are told, and if commands take effect up to `late` periods late."""
    rng = np.random.default_rng(seed)
    motion = Accelerating(acceleration=acceleration)
    bodies = Bodies(separation=0.1, margin=0.0, ramp=0.0, delay=0.1 * late)
    control = Control(motion=motion, bodies=bodies)
    side = int(np.ceil(np.sqrt(dogs)))
    d = 0.105 * np.stack(np.divmod(np.arange(dogs), side), axis=1)
    d = np.hstack([d + rng.uniform(-0.002, 0.002, d.shape), np.zeros((dogs, 2))])
    sheep, filter = np.array([[9.0, 9.0]]), CommandFilter(dogs)
    underway, pull = [np.zeros((dogs, 2))] * (late + 1), rng.uniform(0.0, 1.0)
    for k in range(45):
        if k % 15 == 0:
            wish = rng.normal(0.0, 0.05, (dogs, 2))
        asked = motion.project(wish + pull * (d[:, :2].mean(axis=0) - d[:, :2]), 0.05)
        herd = HerdState(sheep, 0.0 * sheep, d)
        u = filter.filtered(asked, underway[-1], herd, tuple(range(dogs)), control).u
        assert np.linalg.norm(u, axis=1).max() <= 0.05 * (1.0 + 1e-9)
        change = np.linalg.norm(u - underway[-1], axis=1).max()
        assert change <= 0.1 * acceleration + 1e-9
        underway = [*underway[1:], u]
        path = motion.rollout(d, np.array(underway[:1]), 0.01, 10)
        assert closest(path[:, :2].transpose(0, 2, 1)) >= 0.1 - 1e-6
        d = path[-1].T


@given(seed=st.integers(0, 2**32 - 1), dogs=st.integers(1, 20), ahead=st.floats(0.02, 0.5))
@settings(max_examples=10, deadline=None)
def test_dogs_that_have_to_turn_never_come_too_near(seed, dogs, ahead):
    """While they keep the speed and the turn rate that they are told."""
    rng = np.random.default_rng(seed)
    motion = Unicycle(turn_rate=0.05 / ahead, ahead=ahead)
    control = Control(motion=motion, bodies=Bodies(separation=0.1, margin=0.0, ramp=0.0))
    side = int(np.ceil(np.sqrt(dogs)))
    d = 0.12 * np.stack(np.divmod(np.arange(dogs), side), axis=1)
    d = np.column_stack([d, rng.uniform(-4.0, 4.0, dogs)])
    sheep, filter, pull = np.array([[9.0, 9.0]]), CommandFilter(dogs), rng.uniform(0.0, 1.0)
    u = np.zeros((dogs, 2))
    for k in range(60):
        if k % 15 == 0:
            wish = rng.normal(0.0, 0.05, (dogs, 2))
        asked = motion.project(wish + pull * (d[:, :2].mean(axis=0) - d[:, :2]), 0.05)
        herd = HerdState(sheep, 0.0 * sheep, d)
        u = filter.filtered(asked, u, herd, tuple(range(dogs)), control).u
        assert np.linalg.norm(u, axis=1).max() <= 0.05 * (1.0 + 1e-9)
        path = motion.rollout(d, u[None], 0.01, 10)
        assert closest(path[:, :2].transpose(0, 2, 1)) >= 0.1 - 1e-7
        d = path[-1].T


def test_two_dogs_that_have_to_turn_pass_each_other():
    motion = Unicycle(turn_rate=0.5, ahead=0.1)
    control = Control(motion=motion, bodies=Bodies(separation=0.1, margin=0.01, ramp=0.5))
    d, u = np.array([[-0.4, 0.0, 0.0], [0.4, 0.0, np.pi]]), np.zeros((2, 2))
    aims, sheep = d[::-1, :2].copy(), np.array([[9.0, 9.0]])
    filter = CommandFilter(2)
    for _ in range(600):
        asked = motion.project(aims - d[:, :2], 0.05)
        u = filter.filtered(asked, u, HerdState(sheep, 0.0 * sheep, d), (0, 1), control).u
        d = motion.rollout(d, u[None], 0.01, 10)[-1].T
        assert np.linalg.norm(d[0, :2] - d[1, :2]) >= 0.1 - 1e-7
    assert np.linalg.norm(d[:, :2] - aims, axis=1).max() < 0.05


def test_commands_never_bring_a_dog_too_near_to_a_wall():
    """Random fences and obstacles, commands at full speed, each for a control period."""
    rng = np.random.default_rng(0)
    control = Control(bodies=Bodies(separation=0.0, margin=0.0, ramp=0.0, delay=0.0))
    speed, period = control.max_speed, control.horizon.control_period
    changed = kept = 0
    for _ in range(20):
        ends = rng.uniform(-1.0, 1.0, (10, 1, 2)) + rng.uniform(-0.3, 0.3, (10, 2, 2))
        discs = np.append(rng.uniform(-1.0, 1.0, (3, 2)), [[0.1], [0.2], [0.3]], axis=1)
        field = Field(fences=ends.tolist(), discs=discs.tolist())
        d = rng.uniform(-1.0, 1.0, (40, 2))
        d = d[field.away(d)[0].min(axis=1) > control.bodies.wall_distance][:8]
        filter, last = CommandFilter(len(d)), np.zeros_like(d)
        heading = rng.uniform(0.0, 2.0 * np.pi, len(d))
        asked = speed * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        for _ in range(60):
            herd = state(d)
            command = filter.filtered(asked, last, herd, tuple(range(len(d))), control, field)
            same = (command.u == asked).all(axis=1)
            changed, kept = changed + int((~same).sum()), kept + int(same.sum())
            d = d + period * command.u
            last = command.u
            assert field.away(d)[0].min() > control.bodies.wall_distance - 1e-9
    assert min(changed, kept) > 100


def test_a_dog_slides_along_a_wall_and_may_leave_it():
    field = Field(fences=[[[-5.0, 0.0], [5.0, 0.0]]])
    bodies = Bodies(separation=0.0, margin=0.0, ramp=0.0)
    d = np.array([[0.0, bodies.wall_distance], [1.0, -bodies.wall_distance], [2.0, 1.0]])
    asked = np.array([[0.03, -0.04], [0.0, -0.05], [0.0, -0.05]])
    found = CommandFilter(3).filtered(asked, STAND, state(d), ALL, Control(bodies=bodies), field)
    np.testing.assert_allclose(found.u, [[0.03, 0.0], [0.0, -0.05], [0.0, -0.05]], atol=1e-9)
    assert found.changed
