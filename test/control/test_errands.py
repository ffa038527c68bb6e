# SPDX-License-Identifier: Apache-2.0
"""Who has strayed, who fetches whom, and what it costs until a dog is there."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

from herding_ros.control.costs.check import taylor_orders
from herding_ros.control.costs.cost_to_go import CostToGo
from herding_ros.control.detour import detour
from herding_ros.control.errands import behind_each, Errands
from herding_ros.control.parameters import Bodies
from herding_ros.control.reach import Reach
from herding_ros.control.ways import Ways
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.dynamics import rollout
from herding_ros.model.field import Field
from herding_ros.model.flock import centre
from herding_ros.model.potentials import Morse, PowerLaw, Tabulated
from herding_ros.model.state import HerdState
import numpy as np
import pytest

GOAL = np.array([3.0, 0.0])
REACH = Reach(standoff=0.1, reach=1.0, repels=True)


def herd(strays: int, dogs: int, seed: int = 0) -> HerdState:
    """Twelve sheep within 0.4 m, and strays at 1.5 m; dogs anywhere."""
    rng = np.random.default_rng(seed)
    x = 0.28 * rng.uniform(-1.0, 1.0, (12 + strays, 2))
    angles = rng.uniform(0.0, 2.0 * np.pi, strays)
    x[:strays] = 1.5 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    d = rng.normal(0.0, 2.0, (dogs, 2))
    return HerdState(x, np.zeros_like(x), d)


def test_reach_of_an_exponential_and_of_a_dog_that_nobody_notices() -> None:
    found = Reach.of(Crowd(dog=Morse(0.02, 0.5, 0.0, 1.0)), 0.1)
    assert found is not None
    assert found.standoff == pytest.approx(-0.5 * np.log(0.8), rel=0.02)
    assert found.reach == pytest.approx(-0.5 * np.log(0.1), rel=0.02)
    assert found.repels
    assert Reach.of(Crowd(dog=Morse(0.0, 1.0, 0.0, 1.0)), 0.1) is None
    guided = Reach.of(CROWDS['guided'], 0.1)
    assert guided is not None
    assert not guided.repels


def test_a_dog_at_the_standoff_keeps_hold_of_its_sheep_where_a_push_ends_sharply() -> None:
    r = np.linspace(0.0, 1.0, 51)
    found = Reach.of(Crowd(dog=Tabulated(tuple(r), tuple(0.01 * (1.0 - r)))), 0.1)
    assert found.reach > 0.9
    assert found.standoff < 0.6 * found.reach


@pytest.mark.parametrize('order', [1, 2])
def test_reach_does_not_depend_on_where_a_power_law_is_cut_off(order: int) -> None:
    """Pushes W / r^2, to twice the dog's speed (order 1) at sqrt(W / (2 a u_max))."""
    w, max_speed = 2.0, 1.0
    found = []
    for cut in (1e-2, 1e-3):
        crowd = Crowd(dog=PowerLaw(w / cut, 1.0, 0.0, 1.0, cut), friction=2.0, order=order)
        found.append(Reach.of(crowd, max_speed))
    for name in ('standoff', 'reach'):
        assert getattr(found[0], name) == pytest.approx(getattr(found[1], name), rel=0.02)
    if order == 1:
        nearest = np.sqrt(w / (2.0 * 2.0 * max_speed))
        assert found[0].standoff == pytest.approx(nearest / np.sqrt(0.8), rel=0.02)
        assert found[0].reach == pytest.approx(nearest / np.sqrt(0.1), rel=0.02)


@pytest.mark.parametrize('seed', range(5))
def test_each_stray_has_the_dog_for_which_the_ways_are_shortest(seed: int) -> None:
    state = herd(3, 4, seed)
    errands = Errands.of(REACH, state, GOAL)
    assert sorted(errands.sheep) == [0, 1, 2]
    assert list(errands.together) == [False] * 3 + [True] * 12
    place = errands.place(state.x)
    posts = behind_each(state.x[:3], place, REACH.standoff)

    def total(dogs: tuple[int, ...]) -> float:
        ways = (
            detour(state.d[m] - place, p - place, errands.around)[0]
            for m, p in zip(dogs, posts, strict=True)
        )
        return float(sum(ways))

    found = tuple(errands.dogs[np.argsort(errands.sheep)])
    assert total(found) == pytest.approx(min(map(total, permutations(range(4), 3))), rel=1e-12)


def test_a_flock_that_is_together_has_no_strays() -> None:
    errands = Errands.of(REACH, herd(0, 2), GOAL)
    assert not len(errands.dogs)
    assert errands.together.all()
    assert errands.goal is None


def test_with_few_dogs_each_fetches_one_stray() -> None:
    errands = Errands.of(REACH, herd(5, 2), GOAL)
    assert sorted(errands.dogs) == [0, 1]
    assert len(set(errands.sheep)) == 2
    assert max(errands.sheep) < 5


def test_a_scattered_flock_is_driven_one_by_one() -> None:
    state = herd(0, 2)
    scattered = replace(state, x=20.0 * state.x)
    errands = Errands.of(REACH, scattered, GOAL)
    assert errands.goal is not None
    np.testing.assert_array_equal(errands.place(scattered.x), GOAL)
    assert len(errands.dogs) == 2


def test_errands_do_not_depend_on_the_unit_of_length_nor_on_where_the_origin_is() -> None:
    state, shift, scale = herd(2, 3), np.array([7.0, -2.0]), 40.0
    here = Errands.of(REACH, state, GOAL)
    moved = HerdState(scale * state.x + shift, state.v, scale * state.d + shift)
    reach = Reach(scale * REACH.standoff, scale * REACH.reach, repels=True)
    there = Errands.of(reach, moved, scale * GOAL + shift)
    np.testing.assert_array_equal(there.dogs, here.dogs)
    np.testing.assert_array_equal(there.sheep, here.sheep)
    assert there.around == pytest.approx(scale * here.around)
    assert there.inner == pytest.approx(scale * here.inner)


@pytest.mark.parametrize(('strays', 'dogs'), [(2, 3), (3, 2), (0, 2), (1, 1)])
def test_derivatives_of_the_cost_to_go(strays: int, dogs: int) -> None:
    state = herd(strays, dogs, 3)
    u = np.random.default_rng(0).normal(0.0, 0.05, (6, dogs, 2))
    played = rollout(Crowd(), state, u, 0.1)
    cost = CostToGo(Errands.of(REACH, state, GOAL), 3.0, 0.05)
    assert min(taylor_orders(cost, played, u, np.random.default_rng(1))) > 1.9


def before_the_flock(dogs: int, strays: int = 0) -> HerdState:
    """A herd with all its dogs, and what strays there are, on the side of the goal."""
    state, n = herd(strays, dogs, 3), np.arange(dogs)
    x = state.x.copy()
    x[:strays] = np.abs(x[:strays])
    d = 1.6 * np.stack([np.cos(0.5 + 0.3 * n), np.sin(0.5 + 0.3 * n)], axis=1)
    return HerdState(x, state.v, d)


@pytest.mark.parametrize(('strays', 'dogs'), [(0, 3), (1, 3)])
def test_derivatives_of_the_way_behind_the_flock(strays: int, dogs: int) -> None:
    state = before_the_flock(dogs, strays)
    errands = Errands.of(REACH, state, GOAL)
    assert len(errands.drivers) == dogs - strays
    u = np.random.default_rng(0).normal(0.0, 0.05, (6, dogs, 2))
    played = rollout(Crowd(), state, u, 0.1)
    cost = CostToGo(errands, 3.0, 0.05)
    assert min(taylor_orders(cost, played, u, np.random.default_rng(1))) > 1.9


def test_dogs_go_behind_the_flock_where_most_are_before_it() -> None:
    state = before_the_flock(3)
    assert list(Errands.of(REACH, state, GOAL).drivers) == [0, 1, 2]
    one_behind = replace(state, d=np.concatenate([state.d[:2], -state.d[2:]]))
    assert list(Errands.of(REACH, one_behind, GOAL).drivers) == [0, 1]
    two_behind = replace(state, d=np.concatenate([state.d[:1], -state.d[1:]]))
    assert not len(Errands.of(REACH, two_behind, GOAL).drivers)
    home = centre(state.x) + 0.1
    assert not len(Errands.of(REACH, state, home).drivers)


def test_in_a_lane_dogs_go_behind_the_flock_where_none_is_there() -> None:
    """A flock in a dead end, with its dogs on the way out, and no room behind it."""
    lane = Field(fences=(((3.0, 0.7), (-0.7, 0.7), (-0.7, -0.7), (3.0, -0.7)),))
    state = before_the_flock(3)
    ways = Ways.of(lane, Bodies(), state.x, GOAL)
    assert ways is not None
    errands = Errands.of(REACH, state, GOAL, ways)
    assert list(errands.drivers) == [0, 1, 2]
    post = errands.place(state.x) + errands.behind
    assert lane.gaps(post[None]).min() > Bodies().wall_distance
    one_behind = replace(state, d=np.concatenate([state.d[:2], -state.d[2:]]))
    assert not len(Errands.of(REACH, one_behind, GOAL, ways).drivers)


def test_a_stray_costs_what_it_adds_to_the_tracking_cost_for_as_long_as_its_dog_runs() -> None:
    state = herd(1, 1)
    d = state.x[:1] * 2.0
    played = rollout(Crowd(), replace(state, d=d), np.zeros((1, 1, 2)), 1e-9)
    errands = Errands.of(REACH, replace(state, d=d), GOAL)
    found, _ = CostToGo(errands, 3.0, 0.05).value_and_derivatives(played, np.zeros((1, 1, 2)))
    off = state.x[0] - state.x[1:].mean(axis=0)
    r = np.linalg.norm(off)
    way = np.linalg.norm(d[0] - state.x[0] - 0.1 * off / r)
    expected = 3.0 / (2 * 13) * (r**2 - errands.inner**2) * way / 0.05
    assert found == pytest.approx(expected, rel=0.02)  # the distance is rounded off near zero
    there = replace(state, d=behind_each(state.x[:1], errands.place(state.x), 0.1))
    played = rollout(Crowd(), there, np.zeros((1, 1, 2)), 1e-9)
    cost = CostToGo(errands, 3.0, 0.05)
    assert cost.value_and_derivatives(played, np.zeros((1, 1, 2)))[0] < 1e-6


def test_dogs_out_of_reach_are_drawn_to_the_flock() -> None:
    state = replace(herd(0, 1), d=np.array([[30.0, 0.0]]))
    played = rollout(Crowd(), state, np.zeros((1, 1, 2)), 0.1)
    cost = CostToGo(Errands.of(REACH, state, GOAL), 3.0, 0.05)
    _, by = cost.value_and_derivatives(played, np.zeros((1, 1, 2)))
    assert by.d is not None
    assert by.d[-1, 0, 0] > 0.0


# Two strays, one of them behind a fence, whose end is at (0.5, 0.9).
FENCE = Field(fences=(((0.5, -2.0), (0.5, 0.9)),))
BEHIND = HerdState(
    np.concatenate([herd(0, 2).x, [[1.5, 0.0], [-1.5, 0.2]]]), np.zeros((14, 2)), herd(0, 2).d
)


def among_walls() -> Errands:
    ways = Ways.of(FENCE, Bodies(), BEHIND.x, GOAL)
    return Errands.of(REACH, BEHIND, GOAL, ways)


def test_a_stray_behind_a_fence_is_led_round_it() -> None:
    errands = among_walls()
    here = int(np.flatnonzero(errands.sheep == 12)[0])
    assert list(np.isnan(errands.via[:, 0])) == [k != here for k in range(2)]
    turn, place = errands.via[here], errands.place(BEHIND.x)
    np.testing.assert_allclose(turn, [0.5, 1.0], atol=0.12)  # round the end of the fence
    assert turn[1] > 0.9
    direct = np.linalg.norm(turn - place)
    assert direct <= errands.rest[here] < 1.1 * direct
    np.testing.assert_array_equal(errands.places(BEHIND.x)[1 - here], place)


def test_derivatives_of_the_cost_of_strays_behind_a_fence() -> None:
    cost = CostToGo(among_walls(), 3.0, 0.05)
    rng = np.random.default_rng(1)
    u = rng.normal(0.0, 0.05, (4, 2, 2))
    trajectory = rollout(Crowd(), BEHIND, u, 0.1, 2)
    assert min(taylor_orders(cost, trajectory, u, rng)) > 1.9
    free = CostToGo(Errands.of(REACH, BEHIND, GOAL), 3.0, 0.05)
    values = [each.value_and_derivatives(trajectory, u)[0] for each in (cost, free)]
    assert values[0] > values[1]  # a longer way
