# SPDX-License-Identifier: Apache-2.0
"""Dogs are kept apart, whatever is commanded, by commands that are changed as little as can be."""

import itertools
import time

from herding_ros.control.separation import gain_for, kept_apart, Neighbours, Obstacles
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.optimize import minimize
import shapely

DISTANCE, SPEED, PERIOD = 0.1, 0.05, 0.1
GAIN = gain_for(0.0, PERIOD)


def apart(d, u, obstacles=None, gain=GAIN):
    """Return the commands that keep dogs DISTANCE apart."""
    return kept_apart(Neighbours.of(d, DISTANCE, obstacles), u, gain, SPEED)


def smallest_distance(d, u, duration=PERIOD):
    """Return the smallest distance of two dogs while all run straight on."""
    least = np.inf
    for i, j in itertools.combinations(range(len(d)), 2):
        r, w = d[i] - d[j], u[i] - u[j]
        t = np.clip(-(r @ w) / max(w @ w, 1e-30), 0.0, duration)
        least = min(least, np.linalg.norm(r + t * w))
    return least


def herd(rng, dogs, least=1.0):
    """Dogs on a jittered lattice, no two nearer than `least` times the distance."""
    side = int(np.ceil(np.sqrt(dogs)))
    lattice = np.stack(np.divmod(np.arange(dogs), side), axis=1) * least * DISTANCE * 1.05
    d = lattice + rng.uniform(-0.02, 0.02, lattice.shape) * least * DISTANCE
    return d + rng.normal(size=2)


def commands(rng, dogs, most=SPEED):
    angle = rng.uniform(-np.pi, np.pi, dogs)
    return (
        most
        * np.sqrt(rng.uniform(0.0, 1.0, dogs))[:, None]
        * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    )


@given(seed=st.integers(0, 2**32 - 1), dogs=st.integers(1, 20))
@settings(max_examples=25, deadline=None)
def test_no_two_dogs_ever_come_too_near(seed, dogs):
    rng = np.random.default_rng(seed)
    d = herd(rng, dogs)
    pull = rng.uniform(0.0, 2.0)  # towards each other, or anywhere
    for _ in range(15):
        towards = d.mean(axis=0) - d
        u = apart(d, commands(rng, dogs) + pull * towards)
        assert np.linalg.norm(u, axis=1).max() <= SPEED * (1.0 + 1e-12)
        assert smallest_distance(d, u) >= DISTANCE - 1e-8
        d = d + PERIOD * u


@given(seed=st.integers(0, 2**32 - 1), dogs=st.integers(2, 20))
@settings(max_examples=15, deadline=None)
def test_dogs_that_are_too_near_part_whatever_they_are_told(seed, dogs):
    rng = np.random.default_rng(seed)
    d = herd(rng, dogs, least=rng.uniform(0.0, 0.9))
    one, other = np.triu_indices(dogs, k=1)

    def distances():
        return np.linalg.norm(d[one] - d[other], axis=1)

    before = distances()
    for _ in range(40):
        u = apart(d, commands(rng, dogs))
        d = d + PERIOD * u
        after = distances()
        near = before < DISTANCE
        assert (after >= before - 1e-8)[near].all()
        assert (after >= DISTANCE - 1e-8)[~near].all()
        if near.any():
            assert after[near].sum() > before[near].sum()
        before = after


def test_dogs_at_one_place_part():
    d = np.zeros((5, 2))
    for _ in range(200):
        d = d + PERIOD * apart(d, np.zeros_like(d))
    one, other = np.triu_indices(5, k=1)
    assert np.linalg.norm(d[one] - d[other], axis=1).min() > 0.98 * DISTANCE


def test_commands_that_bring_none_too_near_are_left_as_they_are():
    rng = np.random.default_rng(0)
    d, u = 10.0 * herd(rng, 6), commands(rng, 6)
    assert apart(d, u) is u


def conditions(d, u):
    """Return what each pair may not fall below, by the definition."""
    return [
        (d[i] - d[j]) @ (u[i] - u[j]) / np.linalg.norm(d[i] - d[j])
        + GAIN * (np.linalg.norm(d[i] - d[j]) - DISTANCE)
        for i, j in itertools.combinations(range(len(d)), 2)
    ]


def blocked_pairs_slip(d, u):
    """Return whether the commands of no pair are altered for passing on the right."""
    for i, j in itertools.combinations(range(len(d)), 2):
        n = (d[i] - d[j]) / np.linalg.norm(d[i] - d[j])
        w = u[i] - u[j]
        blocked = -(n @ w) - GAIN * (np.linalg.norm(d[i] - d[j]) - DISTANCE)
        if blocked > 0.0 and abs(n[0] * w[1] - n[1] * w[0]) < 0.2 * blocked:
            return False
    return True


def test_two_dogs_get_the_nearest_commands_that_are_allowed():
    """Against all commands on a grid, refined around the best."""
    rng = np.random.default_rng(1)
    tried = 0
    while tried < 8:
        d, u = herd(rng, 2), commands(rng, 2)
        if min(conditions(d, u)) >= 0.0 or not blocked_pairs_slip(d, u):
            continue
        tried += 1
        found = apart(d, u)
        centre, width = np.zeros(4), SPEED
        for _ in range(12):
            axis = np.linspace(-width, width, 13)
            grid = centre + np.stack(np.meshgrid(*[axis] * 4), axis=-1).reshape(-1, 4)
            pair = grid.reshape(-1, 2, 2)
            n = (d[0] - d[1]) / np.linalg.norm(d[0] - d[1])
            gap = np.linalg.norm(d[0] - d[1]) - DISTANCE
            allowed = ((pair[:, 0] - pair[:, 1]) @ n >= -GAIN * gap) & (
                np.linalg.norm(pair, axis=2) <= SPEED
            ).all(axis=1)
            cost = np.where(allowed, np.square(grid - u.ravel()).sum(axis=1), np.inf)
            centre, width = grid[cost.argmin()], 0.5 * width
        best = float(np.square(centre - u.ravel()).sum())
        cost = float(np.square(found - u).sum())
        assert cost <= best + 1e-12
        assert cost == pytest.approx(best, rel=0.02)


@pytest.mark.parametrize('dogs', [3, 5])
def test_several_dogs_get_the_nearest_commands_that_are_allowed(dogs):
    """Against a general solver."""
    rng = np.random.default_rng(dogs)
    tried = 0
    while tried < 4:
        d, u = herd(rng, dogs), commands(rng, dogs)
        if min(conditions(d, u)) >= 0.0 or not blocked_pairs_slip(d, u):
            continue
        tried += 1
        found = apart(d, u) / SPEED
        best = minimize(
            lambda v, u=u: np.square(v - u.ravel() / SPEED).sum(),
            np.zeros(2 * dogs),
            method='SLSQP',
            constraints=[
                {
                    'type': 'ineq',
                    'fun': lambda v, d=d: (
                        np.array(conditions(d, SPEED * v.reshape(-1, 2))) / SPEED
                    ),
                },
                {
                    'type': 'ineq',
                    'fun': lambda v: 1.0 - np.square(v.reshape(-1, 2)).sum(axis=1),
                },
            ],
            options={'ftol': 1e-10, 'maxiter': 500},
        )
        assert min(conditions(d, SPEED * best.x.reshape(-1, 2))) > -1e-6  # it has arrived
        assert found == pytest.approx(best.x.reshape(-1, 2), abs=1e-4)


def test_neither_axes_nor_the_order_of_dogs_matter():
    rng = np.random.default_rng(2)
    d, u = herd(rng, 7), commands(rng, 7)
    found = apart(d, u)
    assert not np.allclose(found, u)
    turn = np.linalg.qr(rng.normal(size=(2, 2)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))  # no mirror: dogs pass on the right
    turned = apart(d @ turn + 3.0, u @ turn)
    assert turned == pytest.approx(found @ turn, abs=1e-7 * SPEED)
    order = rng.permutation(7)
    swapped = apart(d[order], u[order])
    assert swapped == pytest.approx(found[order], abs=1e-7 * SPEED)


def test_two_dogs_that_want_to_change_places_do():
    d = np.array([[-0.3, 0.0], [0.3, 0.0]])
    aims = d[::-1].copy()
    for _ in range(400):
        u = aims - d
        u *= SPEED / np.maximum(np.linalg.norm(u, axis=1), SPEED)[:, None]
        u = apart(d, u)
        assert smallest_distance(d, u) >= DISTANCE - 1e-8
        d = d + PERIOD * u
    assert d == pytest.approx(aims, abs=1e-3)


def test_neighbours_are_all_that_a_dog_is_near_to():
    """Against Shapely."""
    rng = np.random.default_rng(7)
    d, ends = rng.uniform(-1.0, 1.0, (6, 2)), rng.uniform(-1.0, 1.0, (9, 2, 2))
    ends[0, 1] = ends[0, 0]  # a disc
    bars = np.concatenate([ends.reshape(9, 4), rng.uniform(0.0, 0.1, (9, 1))], axis=1)
    places = rng.uniform(-1.0, 1.0, (4, 2))
    there = Obstacles.walls(bars, 0.05).and_also(Obstacles.points(places, 0.2))
    near = Neighbours.of(d, DISTANCE, there, reach=0.3)
    shapes = [*shapely.linestrings(ends[1:]), *shapely.points(places)]
    shapes = [shapely.Point(ends[0, 0]), *shapes]
    keep = np.concatenate([bars[:, 4] + 0.05, np.full(4, 0.2)])
    gaps = shapely.distance(shapely.points(d)[:, None], np.array(shapes)) - keep
    alone = near.other < 0
    assert sorted(near.gaps[alone]) == pytest.approx(sorted(gaps[gaps < 0.3]))
    assert np.count_nonzero(near.passed & alone) == np.count_nonzero(gaps[:, 9:] < 0.3)
    i, j = np.triu_indices(6, k=1)
    pairs = np.linalg.norm(d[i] - d[j], axis=1) - DISTANCE
    assert near.gaps[~alone] == pytest.approx(pairs[pairs < 0.6])
    # A step along a normal widens the gap by as much.
    moved = d[near.one] + 1e-6 * near.normals
    for k in np.flatnonzero(alone):
        wider = shapely.distance(shapely.Point(moved[k]), np.array(shapes)) - keep
        assert np.abs(wider - near.gaps[k] - 1e-6).min() < 1e-9


def test_a_dog_passes_one_that_stands():
    d = np.array([[-0.3, 0.0], [0.0, 0.0]])
    for _ in range(400):
        stands = Obstacles.points(d[1:], DISTANCE)
        u = apart(d[:1], np.array([[SPEED, 0.0]]), stands)
        d[:1] += PERIOD * u
        assert np.linalg.norm(d[0] - d[1]) >= DISTANCE - 1e-8
    assert d[0, 0] > 0.3


def test_a_crowd_that_is_driven_together_stays_within_its_walls():
    rng = np.random.default_rng(3)
    d = herd(rng, 10)
    low, high = d.min(axis=0) - 0.01, d.max(axis=0) + 0.01
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    ends = np.concatenate([corners, np.roll(corners, 1, axis=0)], axis=1)
    walls = Obstacles.walls(np.concatenate([ends, np.zeros((4, 1))], axis=1), 0.0)
    for _ in range(50):
        u = apart(d, 2.0 * commands(rng, 10), walls)
        assert smallest_distance(d, u) >= DISTANCE - 1e-8
        d = d + PERIOD * u
        assert (d >= low - 1e-8).all()
        assert (d <= high + 1e-8).all()


@pytest.mark.parametrize('delay', [0.0, 0.1, 0.3])
def test_commands_that_take_effect_late_bring_none_too_near(delay):
    """Every command takes effect `delay` or less late; dogs push towards one place."""
    rng = np.random.default_rng(4)
    late = round(delay / PERIOD)
    gain = gain_for(delay, PERIOD)
    for dogs in (2, 3, 6):
        d = herd(rng, dogs, least=2.0)
        underway = [np.zeros((dogs, 2))] * (late + 1)
        for k in range(200):
            aim = d.mean(axis=0) + 0.02 * np.array([np.cos(0.1 * k), np.sin(0.1 * k)])
            u = aim - d
            u *= SPEED / np.linalg.norm(u, axis=1)[:, None]
            underway = [*underway[1:], apart(d, u, gain=gain)]
            acting = underway[-1 - rng.integers(late + 1)]
            assert smallest_distance(d, acting) >= DISTANCE - 1e-8
            d = d + PERIOD * acting


def test_a_thousand_dogs_on_a_heap_part_in_bounded_time():
    rng = np.random.default_rng(5)
    d, u = rng.uniform(0.0, 0.5, (1000, 2)), commands(rng, 1000)
    one, other = np.triu_indices(1000, k=1)
    before = np.linalg.norm(d[one] - d[other], axis=1)
    started = time.perf_counter()
    after = d + PERIOD * apart(d, u)
    assert time.perf_counter() - started < 5.0
    near = before < DISTANCE
    assert (np.linalg.norm(after[one] - after[other], axis=1) >= before - 1e-6)[near].all()
