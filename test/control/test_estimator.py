# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable
import copy
from dataclasses import replace
import math
from typing import Any

from herding_ros.control.closed_loop import closed_loop, play
from herding_ros.control.estimator import StateEstimator
from herding_ros.control.lockstep_pilot import LockstepPilot
from herding_ros.control.parameters import Bodies, Control, Horizon, Mapping, Sensor
from herding_ros.control.pilot import Observed
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.alignment import Alignment
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.dynamics import rollout
from herding_ros.model.flock import spread
from herding_ros.model.noise import increments
from herding_ros.model.potentials import Morse
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest
from scipy.linalg import block_diag, solve_discrete_are

PERIOD, SUBSTEPS = 0.1, 2
NOISY = Sensor(0.05, 0.05)
GOAL = np.array([0.5, 0.5])
NO_FORCE = Morse(0.0, 1.0, 0.0, 1.0)
FLOCK = Crowd()
APART = Crowd(sheep=NO_FORCE, dog=NO_FORCE)
"""Sheep that feel friction and their own noise alone."""
SLIP = 0.01


def statistics(*values: Any) -> Any:
    """Mark a case that only a full run of the tests includes."""
    return pytest.param(*values, marks=pytest.mark.statistics)


def estimator(crowd: Crowd = FLOCK, sensor: Sensor = NOISY) -> StateEstimator:
    return StateEstimator(crowd, sensor, PERIOD, SUBSTEPS)


def blurred(state: HerdState, rng: np.random.Generator, noise: float = 0.05) -> HerdState:
    return HerdState(
        *(true + noise * rng.standard_normal(true.shape) for true in (state.x, state.v, state.d))
    )


class Watched:
    """A herd that moves as the model says, with its observations and what is believed."""

    def __init__(
        self, crowd: Crowd, state: HerdState, u: Array, updates: int, noise: float, seed: int = 0,
        sensor: Sensor | None = None,
    ) -> None:  # fmt: skip
        rng = np.random.default_rng(seed)
        n, filter_ = len(state.x), estimator(crowd, sensor or Sensor(noise, noise))
        self.true, self.seen, self.believed = [state], [blurred(state, rng, noise)], []
        for k in range(updates):
            self.believed.append(filter_.update(PERIOD * k, np.arange(n), self.seen[-1], u))
            force = increments(rng, crowd, n, PERIOD / 10, 10)
            state = rollout(crowd, state, u[None], PERIOD / 10, 10, force).at(-1)
            self.true.append(state)
            self.seen.append(blurred(state, rng, noise))

    def errors(self, what: str, first: int = 0) -> tuple[float, float]:
        """Root mean square of what is seen and of what is believed, per coordinate."""
        believed = self.believed[first:]
        true = np.array([getattr(each, what) for each in self.true[first : first + len(believed)]])
        return tuple(
            float(np.sqrt(np.square([getattr(each, what) for each in states] - true).mean()))
            for states in (self.seen[first : first + len(believed)], believed)
        )


def step_of(crowd: Crowd, dt: float) -> Array:
    """Matrix of a time step of free sheep, for position and velocity in one coordinate."""
    if crowd.order == 1:
        return np.array([[1.0, 0.0], [0.0, 0.0]])
    return np.array([[1.0, dt], [0.0, 1.0 - crowd.friction * dt]])


def force_of(crowd: Crowd, dt: float) -> Array:
    """Covariance that the random force adds in a time step."""
    if crowd.order == 1:
        return np.diag([(crowd.noise / crowd.friction) ** 2 * dt, 0.0])
    return np.diag([0.0, crowd.noise**2 * dt])


class DenseFilter:
    """The textbook: one Kalman filter with dense matrices for the whole herd, dogs included.

    Its state is (x_1, y_1, vx_1, vy_1, x_2, ..., then the dogs). Forces are looped over, from
    the formula of the potential.
    """

    def __init__(
        self, crowd: Crowd, sensor: Sensor, observed: HerdState, moving: bool = True
    ) -> None:
        self.crowd, self.sensor, self.n = crowd, sensor, len(observed.x)
        p, q, m = sensor.position_noise**2, sensor.velocity_noise**2, len(observed.d)
        at_random = crowd.noise**2 / (2.0 * crowd.friction)
        velocity = 1.0 / (1.0 / q + 1.0 / at_random) if moving else at_random
        self.mean = self.stacked(observed)
        for i in range(self.n):
            self.mean[4 * i + 2 : 4 * i + 4] *= velocity / q if moving else 0.0
        self.covariance = np.diag([p, p, velocity, velocity] * self.n + [p, p] * m)
        self.frictions = self.frictions_here()
        self.noise = np.diag([p, p, q, q] * self.n + [p, p] * m)
        self.seen = np.array([True, True, moving, moving] * self.n + [True, True] * m)

    @staticmethod
    def stacked(state: HerdState) -> Array:
        sheep = [[*x, *v] for x, v in zip(state.x, state.v, strict=True)]
        return np.array([*np.ravel(sheep), *state.d.ravel()])

    def rate(self, apart: Array) -> float:
        alignment = self.crowd.alignment
        near = math.exp(-0.5 * (math.hypot(*apart[:2]) / alignment.range) ** 2)
        return alignment.rate / self.n * near

    def frictions_here(self) -> list[float]:
        sheep = self.mean[: 4 * self.n].reshape(-1, 4)
        return [
            self.crowd.friction
            + sum(self.rate(sheep[i] - sheep[j]) for j in range(self.n) if j != i)
            for i in range(self.n)
        ]

    def pull(self, r: Array, force: Morse) -> Array:
        """Minus the gradient of the potential, without what is shorter than the noise."""
        length, total = math.hypot(*r), 0.0
        if force.repulsion_length > self.sensor.position_noise:
            decay = math.exp(-length / force.repulsion_length)
            total += force.repulsion / force.repulsion_length * decay
        if force.attraction_length > self.sensor.position_noise:
            decay = math.exp(-length / force.attraction_length)
            total -= force.attraction / force.attraction_length * decay
        return total * r / length

    def step(self, u: Array, dt: float) -> None:
        n, crowd = self.n, self.crowd
        sheep, dogs = self.mean[: 4 * n].reshape(n, 4), self.mean[4 * n :].reshape(-1, 2)
        moved = sheep.copy()
        for i in range(n):
            force = np.zeros(2)
            for j in range(n):
                if i != j:
                    apart = sheep[i] - sheep[j]
                    force = force + self.pull(apart[:2], crowd.sheep) / n
                    force = force - self.rate(apart) * apart[2:]
            for dog in dogs:
                force = force + self.pull(sheep[i, :2] - dog, crowd.dog)
            if crowd.order == 1:
                moved[i, 2:] = force / crowd.friction
                moved[i, :2] += dt * moved[i, 2:]
            else:
                moved[i, :2] += dt * sheep[i, 2:]
                moved[i, 2:] += dt * (force - crowd.friction * sheep[i, 2:])
        self.mean = np.array([*moved.ravel(), *(dogs + dt * u).ravel()])
        steps = [step_of(replace(crowd, friction=friction), dt) for friction in self.frictions]
        forward = block_diag(*[np.kron(step, np.eye(2)) for step in steps], np.eye(2 * len(dogs)))
        random = np.repeat(np.diag(force_of(crowd, dt)), 2)
        force = np.diag([*random] * n + [SLIP**2 * dt] * (2 * len(dogs)))
        self.covariance = forward @ self.covariance @ forward.T + force

    def correct(self, observed: HerdState) -> None:
        look = np.eye(len(self.mean))[self.seen]
        expected = look @ (self.covariance + self.noise) @ look.T
        gain = self.covariance @ look.T @ np.linalg.inv(expected)
        self.mean = self.mean + gain @ look @ (self.stacked(observed) - self.mean)
        self.covariance = self.covariance - gain @ look @ self.covariance
        self.frictions = self.frictions_here()


@pytest.mark.parametrize(
    ('crowd', 'sensor'),
    [
        (FLOCK, NOISY),
        (FLOCK, Sensor(0.005, 0.05)),
        (replace(FLOCK, noise=0.03, friction=1.0), Sensor(0.02, 0.005)),
        (replace(FLOCK, dog=Morse(0.1, 0.04, 5e-4, 2.0)), NOISY),
        (CROWDS['printed'], Sensor(0.03, 0.01)),
        (replace(FLOCK, order=1), NOISY),
        (replace(FLOCK, alignment=Alignment(3.0, 0.4)), NOISY),
    ],
)
def test_it_is_the_textbook_filter(
    crowd: Crowd, sensor: Sensor, random_herd: Callable[..., HerdState]
) -> None:
    """Also between observations that are missing."""
    rng, ids = np.random.default_rng(1), np.arange(5)
    state, t = random_herd(5, 2, seed=3), 10.0
    observed = blurred(state, rng, 0.005)
    ours, dense = estimator(crowd, sensor), DenseFilter(crowd, sensor, observed)
    ours.update(t, ids, observed, np.zeros((2, 2)))
    for periods in [1, 1, 3, 1, 7, *[1] * 15, 20, 1]:
        u = rng.normal(0.0, 0.03, (2, 2))
        t += periods * PERIOD
        state = rollout(crowd, state, u[None], PERIOD / 10, 10 * periods).at(-1)
        observed = blurred(state, rng, 0.005)
        believed = ours.update(t, ids, observed, u)
        for _ in range(periods * SUBSTEPS):
            dense.step(u, PERIOD / SUBSTEPS)
        dense.correct(observed)
        np.testing.assert_allclose(DenseFilter.stacked(believed), dense.mean, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    'crowd', [FLOCK, replace(FLOCK, friction=2.0, alignment=Alignment(1.0, 0.4))]
)
def test_without_velocities_it_is_the_textbook_filter(
    crowd: Crowd, random_herd: Callable[..., HerdState]
) -> None:
    """At unequal times, 1 to 30 a second; what stands in place of a velocity has no effect."""
    rng, ids, unseen = np.random.default_rng(1), np.arange(5), np.full(5, False)
    state, t = random_herd(5, 2, seed=3), 10.0
    observed = blurred(state, rng, 0.005)
    ours, dense = estimator(crowd, NOISY), DenseFilter(crowd, NOISY, observed, moving=False)
    ours.update(t, ids, observed, np.zeros((2, 2)), is_velocity_seen=unseen)
    for elapsed in [0.1, 0.033, 0.37, 1.0, *rng.uniform(1.0 / 30.0, 1.0, 15)]:
        u = rng.normal(0.0, 0.03, (2, 2))
        t += elapsed
        steps = max(round(elapsed / PERIOD * SUBSTEPS), 1)
        state = rollout(crowd, state, u[None], elapsed / 50, 50).at(-1)
        observed = replace(blurred(state, rng, 0.005), v=rng.normal(0.0, 9.0, (5, 2)))
        believed = ours.update(t, ids, observed, u, is_velocity_seen=unseen)
        for _ in range(steps):
            dense.step(u, elapsed / steps)
        dense.correct(observed)
        np.testing.assert_allclose(DenseFilter.stacked(believed), dense.mean, rtol=0, atol=1e-9)
    variances = np.diag(dense.covariance)[: 4 * 5].reshape(5, 4)
    expected = np.sqrt(variances.mean(axis=0)[[0, 2]])
    np.testing.assert_allclose(ours.deviations, expected, rtol=1e-6)


def test_velocities_that_some_sheep_have_are_used(random_herd: Callable[..., HerdState]) -> None:
    u, has = np.zeros((1, 2)), np.array([True, False, True])
    part, with_all, without = estimator(APART), estimator(APART), estimator(APART)
    for k, each in enumerate(Watched(APART, random_herd(3, 1), u, 20, 0.05).seen):
        found = part.update(k * PERIOD, np.arange(3), each, u, is_velocity_seen=has)
        full = with_all.update(k * PERIOD, np.arange(3), each, u)
        bare = without.update(k * PERIOD, np.arange(3), each, u, is_velocity_seen=has & False)
    for name in 'xv':
        one, two, none = (getattr(state, name) for state in (found, full, bare))
        np.testing.assert_array_equal(one[has], two[has])
        np.testing.assert_array_equal(one[~has], none[~has])
        assert (two[~has] != none[~has]).all()


def test_velocities_are_not_made_without_a_noise_to_weigh_positions_by(
    random_herd: Callable[..., HerdState],
) -> None:
    for sensor in (Sensor(), Sensor(velocity_noise=0.1)):
        with pytest.raises(ValueError, match=r'position_noise must be above 0 where .* got 0'):
            estimator(FLOCK, sensor).update(
                0.0, np.arange(3), random_herd(3, 1), np.zeros((1, 2)),
                is_velocity_seen=np.array([True, False, True]),
            )  # fmt: skip


def test_what_it_says_of_its_errors_is_true() -> None:
    for is_velocity_seen in (True, False):
        true, _, believed, ours = linear_data(APART, NOISY, is_velocity_seen=is_velocity_seen)
        errors = np.sqrt(np.square(believed - true)[[SETTLED, -1]].mean(axis=(0, 1, 3)))
        np.testing.assert_allclose(ours.deviations, errors, rtol=4.0 / math.sqrt(4 * SHEEP))
    assert estimator(sensor=Sensor()).deviations is None


def system(crowd: Crowd, sensor: Sensor) -> tuple[Array, Array, Array]:
    """Matrix of a control period, of its random force and of the sensor, for one coordinate."""
    dt = PERIOD / SUBSTEPS
    step, force = step_of(crowd, dt), force_of(crowd, dt)
    forward, total = np.eye(2), np.zeros((2, 2))
    for _ in range(SUBSTEPS):
        forward, total = step @ forward, step @ total @ step.T + force
    return forward, total, np.diag([sensor.position_noise**2, sensor.velocity_noise**2])


def steady(crowd: Crowd, sensor: Sensor) -> tuple[Array, Array]:
    """Gain, and covariance after a correction, in the end, by SciPy's Riccati solver."""
    forward, force, noise = system(crowd, sensor)
    before = solve_discrete_are(forward.T, np.eye(2), force, noise)
    gain = before @ np.linalg.inv(before + noise)
    return gain, before - gain @ before


@pytest.mark.parametrize(
    ('crowd', 'sensor'),
    [
        (APART, NOISY),
        (replace(APART, noise=0.04), Sensor(0.01, 0.0)),
        (replace(APART, friction=0.0), NOISY),
        (replace(APART, order=1, friction=0.3), NOISY),
    ],
)
def test_gain_becomes_that_of_the_riccati_equation(crowd: Crowd, sensor: Sensor) -> None:
    """Seen from outside: what a single deviating observation changes, long after the start."""
    still = HerdState(np.zeros((1, 2)), np.zeros((1, 2)), np.ones((1, 2)))
    ids, u, gain = np.arange(1), np.zeros((1, 2)), steady(crowd, sensor)[0]
    settled = estimator(crowd, sensor)
    for k in range(500):
        settled.update(k * PERIOD, ids, still, u)
    for column, (x, v) in enumerate([(1e-3, 0.0), (0.0, 1e-3)]):
        ours = copy.deepcopy(settled)
        other = HerdState(np.array([[x, 0.0]]), np.array([[v, 0.0]]), still.d)
        believed = ours.update(500 * PERIOD, ids, other, u)
        np.testing.assert_allclose(
            [believed.x[0, 0], believed.v[0, 0]], 1e-3 * gain[:, column], rtol=1e-6, atol=1e-12
        )
        np.testing.assert_array_equal([believed.x[0, 1], believed.v[0, 1]], 0.0)


SHEEP, UPDATES, SETTLED = 600, 120, 60


def linear_data(
    crowd: Crowd, sensor: Sensor, seed: int = 0, is_velocity_seen: bool = True
) -> tuple[Array, Array, Array, StateEstimator]:
    """What is, is seen and is believed: (updates, SHEEP, 2 [position, velocity], 2); by whom."""
    rng, dt = np.random.default_rng(seed), PERIOD / SUBSTEPS
    x, v = rng.normal(0.0, 0.3, (SHEEP, 2)), rng.normal(0.0, 0.01, (SHEEP, 2))
    ours, d, u = estimator(crowd, sensor), np.ones((1, 2)), np.zeros((1, 2))
    true, seen, believed = [], [], []
    for k in range(UPDATES):
        observed = HerdState(
            x + 0.05 * rng.standard_normal(x.shape), v + 0.05 * rng.standard_normal(x.shape), d
        )
        belief = ours.update(
            k * PERIOD, np.arange(SHEEP), observed, u,
            is_velocity_seen=np.full(SHEEP, is_velocity_seen),
        )  # fmt: skip
        for rows, state in ((true, HerdState(x, v, d)), (seen, observed), (believed, belief)):
            rows.append(np.stack([state.x, state.v], axis=1))
        for _ in range(SUBSTEPS):
            force = 0.01 * math.sqrt(dt) * rng.standard_normal(x.shape)
            x, v = x + dt * v, (1.0 - APART.friction * dt) * v + force
    return np.array(true), np.array(seen), np.array(believed), ours


def test_errors_are_as_small_as_can_be() -> None:
    """Their variance is that of the Riccati equation, 4 standard errors of the sample allowed."""
    true, seen, believed, _ = linear_data(APART, NOISY)
    errors = (believed - true)[[SETTLED, -1]]  # 6 s apart, after which they have changed
    covariance = np.einsum('tnic,tnjc->ij', errors, errors) / errors[:, :, 0].size
    wanted = steady(APART, NOISY)[1]
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert (np.abs(covariance - wanted) < 4.0 * math.sqrt(2.0 / (2 * SHEEP)) * scale).all()
    assert math.sqrt(wanted[0, 0]) < 0.25 * np.std((seen - true)[:, :, 0])
    assert math.sqrt(wanted[1, 1]) < 0.2 * np.std((seen - true)[:, :, 1])


def correlation_of_surprises(sensor: Sensor) -> float:
    """Largest correlation of what observations bring with what the ones before brought."""
    _, seen, believed, _ = linear_data(APART, sensor)
    forward = system(APART, NOISY)[0]
    new = (seen[1:] - np.einsum('ij,tnjc->tnic', forward, believed[:-1]))[SETTLED:]
    found = []
    for lag in (1, 2, 5, 10):
        product = np.einsum('tnic,tnjc->ij', new[lag:], new[:-lag])
        deviation = np.sqrt(np.square(new).sum(axis=(0, 1, 3)) * (1.0 - lag / len(new)))
        found.append(np.abs(product / np.outer(deviation, deviation)).max())
    return float(max(found))


def test_what_observations_bring_is_white() -> None:
    samples = (UPDATES - SETTLED) * SHEEP * 2
    assert correlation_of_surprises(NOISY) < 5.0 / math.sqrt(samples)
    # Who trusts the sensor too much or too little leaves something to be learnt.
    for factor in (0.3, 3.0):
        other = Sensor(factor * NOISY.position_noise, factor * NOISY.velocity_noise)
        assert correlation_of_surprises(other) > 10.0 / math.sqrt(samples)


def turned(points: Array, shift: tuple[float, float]) -> Array:
    angle = 0.7
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return points @ turn.T + np.array(shift)


def test_a_turned_and_shifted_scene_gives_the_same(random_herd: Callable[..., HerdState]) -> None:
    herd, u = random_herd(9, 2), np.array([[0.05, 0.0], [0.0, -0.03]])
    seen = Watched(Crowd(), herd, u, 30, 0.05).seen
    here, there = estimator(), estimator()
    for k, each in enumerate(seen):
        one = here.update(k * PERIOD, np.arange(9), each, u)
        moved = HerdState(
            turned(each.x, (3.0, -1.0)), turned(each.v, (0.0, 0.0)), turned(each.d, (3.0, -1.0))
        )
        other = there.update(k * PERIOD, np.arange(9), moved, turned(u, (0.0, 0.0)))
        np.testing.assert_allclose(other.x, turned(one.x, (3.0, -1.0)), rtol=0, atol=1e-12)
        np.testing.assert_allclose(other.v, turned(one.v, (0.0, 0.0)), rtol=0, atol=1e-12)
        np.testing.assert_allclose(other.d, turned(one.d, (3.0, -1.0)), rtol=0, atol=1e-12)


def test_sheep_are_known_by_their_names_not_their_rows(
    random_herd: Callable[..., HerdState],
) -> None:
    u, rng = np.zeros((2, 2)), np.random.default_rng(5)
    names = np.array([7, 3, 40, 11, 0, 9, 12], dtype=np.uint32)
    ordered, mixed = estimator(), estimator()
    for k, each in enumerate(Watched(Crowd(), random_herd(7, 2), u, 12, 0.05).seen):
        rows = rng.permutation(7)
        one = ordered.update(k * PERIOD, names, each, u)
        other = mixed.update(
            k * PERIOD, names[rows], HerdState(each.x[rows], each.v[rows], each.d), u
        )
        np.testing.assert_allclose(other.x, one.x[rows], rtol=0, atol=1e-12)
        np.testing.assert_allclose(other.v, one.v[rows], rtol=0, atol=1e-12)


def test_sheep_out_of_sight_are_predicted_and_then_lost(
    random_herd: Callable[..., HerdState],
) -> None:
    """A sheep hides for 1.5 s, as if its observations had no weight; another one for good."""
    u, names, state = np.array([[0.05, 0.0]]), np.arange(40, 46), random_herd(6, 1)
    ours = estimator(FLOCK, Sensor(0.05, 0.05, timeout=2.0))
    seen = Watched(FLOCK, state, u, 60, 0.05).seen
    lost, expected = [], None
    for k, each in enumerate(seen):
        rows = [0, 1, 3, 5] + [2] * (not 20 <= k < 35) + [4] * (k < 30)
        before = ours._estimate
        found = ours.update(
            k * PERIOD, names[rows], HerdState(each.x[rows], each.v[rows], each.d), u
        )
        hidden = [row for row in (2, 4) if row not in rows and (row == 2 or k < 49)]
        assert ours.ids[: len(rows)].tolist() == names[rows].tolist()
        assert sorted(ours.ids[len(rows) :].tolist()) == names[hidden].tolist()
        assert len(found.x) == len(rows) + len(hidden)
        assert ours.carried == len(hidden)
        if before is not None and hidden:
            expected = ours._predicted(before, PERIOD, u).sheep
            for name in names[hidden]:
                there = expected.mean[expected.names == name][0]
                np.testing.assert_allclose(found.x[ours.ids == name][0], there[0], rtol=1e-13)
                np.testing.assert_allclose(found.v[ours.ids == name][0], there[1], rtol=1e-13)
        lost += [(k, name) for name in ours.lost]
    assert expected is not None
    assert lost == [(49, 44)]


def test_a_sheep_that_was_out_of_sight_is_where_it_was_going() -> None:
    """It has run through a gap of 1 s in the middle, and is known at once when it is back."""
    rng, u, errors = np.random.default_rng(2), np.zeros((1, 2)), []
    crowd, n = replace(APART, friction=0.0), 200
    x, v = rng.normal(0.0, 5.0, (n, 2)), rng.normal(0.0, 0.3, (n, 2))
    ours = estimator(crowd, Sensor(0.05, timeout=3.0))
    for k in range(70):
        rows = np.arange(n // 2 if 40 <= k < 50 else n)
        true = HerdState(x + k * PERIOD * v, v, np.full((1, 2), 99.0))
        seen = blurred(true, rng)
        found = ours.update(
            k * PERIOD, rows, replace(seen, x=seen.x[rows], v=seen.v[rows]), u,
            is_velocity_seen=np.full(len(rows), False),
        )  # fmt: skip
        errors.append(float(np.abs(found.x - true.x)[n // 2 :].mean()))
    assert max(errors[40:50]) < 0.05  # of 0.3 m that a sheep runs meanwhile
    assert max(errors[50:]) < 0.03


def test_new_sheep_start_where_they_are_seen(random_herd: Callable[..., HerdState]) -> None:
    """Sheep that do not feel each other: who comes and goes changes nothing for the others."""
    seen = Watched(APART, random_herd(6, 1), np.zeros((1, 2)), 40, 0.05).seen
    sensor = Sensor(0.05, 0.05, timeout=0.15)
    u, all_six, some = np.zeros((1, 2)), estimator(APART, sensor), estimator(APART, sensor)
    for k, each in enumerate(seen):
        names = np.arange(6) if k in (0, 39) else np.array([0, 1, 3, 4, 5] if k < 20 else [5, 1])
        one = all_six.update(k * PERIOD, np.arange(6), each, u)
        part = HerdState(each.x[names], each.v[names], each.d)
        other = some.update(k * PERIOD, names, part, u)
        always = [row for row, name in enumerate(names) if name in (1, 5)]
        assert len(other.x) == len(names) + {1: 1, 20: 3, 40: 4}.get(
            k, 0
        )  # those just out of sight
        np.testing.assert_array_equal(other.x[always], one.x[names[always]])
        np.testing.assert_array_equal(other.v[always], one.v[names[always]])
        if k == 39:
            np.testing.assert_array_equal(other.x[[0, 2, 3, 4]], each.x[[0, 2, 3, 4]])
            assert (other.v[[0, 2, 3, 4]] != one.v[[0, 2, 3, 4]]).all()
            assert np.abs(other.v[2]).max() < 0.1 * np.abs(each.v[2]).max()


def test_dogs_come_and_go(random_herd: Callable[..., HerdState]) -> None:
    u = np.array([[0.05, 0.0], [0.0, 0.05], [-0.03, -0.04]])
    watched = Watched(APART, random_herd(3, 3), u, 60, 0.05)
    three, some = estimator(APART), estimator(APART)
    for k, each in enumerate(watched.seen):
        dogs = (0, 1, 2) if k < 20 or k == 60 else (0, 2)
        one = three.update(k * PERIOD, np.arange(3), each, u)
        other = some.update(
            k * PERIOD, np.arange(3), HerdState(each.x, each.v, each.d[list(dogs)]), u, dogs
        )
        assert len(other.d) == len(dogs)
        np.testing.assert_array_equal(other.d[[0, -1]], one.d[[0, 2]])
        if k == 60:
            np.testing.assert_array_equal(other.d[1], each.d[1])
            assert (one.d[1] != each.d[1]).all()


def test_a_dog_becomes_known_as_well_as_the_riccati_equation_says() -> None:
    still = HerdState(np.zeros((1, 2)), np.zeros((1, 2)), np.ones((1, 2)))
    ours, u = estimator(), np.zeros((1, 2))
    for k in range(500):
        ours.update(k * PERIOD, np.arange(1), still, u)
    other = replace(still, d=still.d + np.array([[0.01, 0.0]]))
    believed = ours.update(500 * PERIOD, np.arange(1), other, u)
    before = solve_discrete_are(
        np.eye(1), np.eye(1), SLIP**2 * PERIOD * np.eye(1), NOISY.position_noise**2 * np.eye(1)
    )[0, 0]
    share = before / (before + NOISY.position_noise**2)
    np.testing.assert_allclose(believed.d - 1.0, [[0.01 * share, 0.0]], rtol=1e-6)


def test_a_dog_that_cannot_move_is_found_all_the_same() -> None:
    still = HerdState(np.zeros((1, 2)), np.zeros((1, 2)), np.ones((1, 2)))
    ours, rng, commanded = estimator(), np.random.default_rng(0), np.array([[0.05, 0.0]])
    for k in range(400):
        believed = ours.update(k * PERIOD, np.arange(1), blurred(still, rng), commanded)
        assert np.abs(believed.d - 1.0).max() < 0.25
    assert k * PERIOD * commanded[0, 0] > 1.9  # where it would be


@pytest.mark.parametrize('jumps', [(30,), (30, 32), (30, 31, 32, 33)])
def test_one_mistake_is_overlooked_and_who_is_carried_off_is_found(
    jumps: tuple[int, ...], random_herd: Callable[..., HerdState]
) -> None:
    """A sheep and a dog are seen a metre away: once, twice with a break, or from now on."""
    watched = Watched(APART, random_herd(5, 2), np.zeros((2, 2)), 34, 0.05)
    ours, missing, u = estimator(APART), estimator(APART), np.zeros((2, 2))
    for k, each in enumerate(watched.seen[:34]):
        x, d = each.x.copy(), each.d.copy()
        if k in jumps:
            x[3] += 1.0
            d[1] -= 1.0
        believed = ours.update(k * PERIOD, np.arange(5), HerdState(x, each.v, d), u)
        if k == 30:
            continue
        usual = missing.update(k * PERIOD, np.arange(5), each, u)
        if k < 30 or jumps == (30,):  # as if there had been no observation at k = 30
            np.testing.assert_array_equal(believed.x[3], usual.x[3])
            np.testing.assert_array_equal(believed.d[1], usual.d[1])
        elif k == 31 and jumps == (30, 31, 32, 33):
            np.testing.assert_array_equal(believed.x[3], x[3])
            np.testing.assert_array_equal(believed.d[1], d[1])
        elif jumps == (30, 32):
            assert np.abs(believed.x[3] - watched.true[k].x[3]).max() < 0.05
            assert np.abs(believed.d[1] - watched.true[k].d[1]).max() < 0.05
        others = [0, 1, 2, 4]
        assert k < 10 or np.abs(believed.x[others] - watched.true[k].x[others]).max() < 0.06
    assert np.linalg.norm(believed.x[3] - x[3]) < 0.2


def test_a_first_observation_that_was_a_mistake_is_corrected_at_once() -> None:
    still = HerdState(np.zeros((2, 2)), np.zeros((2, 2)), np.ones((1, 2)))
    wrong = replace(still, x=np.array([[0.0, 0.0], [9.0, 0.0]]))
    ours, u = estimator(), np.zeros((1, 2))
    ours.update(0.0, np.arange(2), wrong, u)
    np.testing.assert_array_equal(ours.update(0.1, np.arange(2), still, u).x[1], still.x[1])


def run_until(t: float) -> StateEstimator:
    ours = estimator()
    herd = HerdState(np.eye(2), np.zeros((2, 2)), np.ones((1, 2)))
    for k in range(round(t / PERIOD) + 1):
        ours.update(k * PERIOD, np.arange(2), herd, np.zeros((1, 2)))
    return ours


@pytest.mark.parametrize(
    ('later', 'anew'),
    [(0.1, False), (9.95, False), (10.1, True), (1e9, True), (0.0, False), (-0.1, True),
     (-3.0, True), (math.nan, True)],
)  # fmt: skip
def test_time_that_goes_back_or_leaps_is_a_new_start(later: float, anew: bool) -> None:
    seen = HerdState(np.eye(2) + 0.02, np.full((2, 2), 0.03), np.full((1, 2), 1.01))
    commanded = np.zeros((1, 2))
    old, new = run_until(3.0), estimator()
    one, other = (each.update(3.0 + later, np.arange(2), seen, commanded) for each in (old, new))
    assert all((getattr(one, name) == getattr(other, name)).all() == anew for name in 'xvd')
    old.reset()
    other = old.update(3.0 + later + 0.1, np.arange(2), seen, commanded)
    np.testing.assert_array_equal(other.x, seen.x)


@pytest.mark.parametrize('sensor', [NOISY, Sensor(0.0, 0.05), Sensor(0.05, 0.0)])
def test_news_of_the_same_instant_do_not_end_the_past(
    sensor: Sensor, random_herd: Callable[..., HerdState]
) -> None:
    """A dog falls silent, or is heard again, between two messages of the sheep."""
    rng, ours, u = np.random.default_rng(0), estimator(APART, sensor), np.zeros((3, 2))
    still = replace(random_herd(9, 3), v=np.zeros((9, 2)))

    def seen(points: Array, noise: float) -> Array:
        return points + noise * rng.standard_normal(points.shape)

    for k in range(42):
        x, d = (seen(points, sensor.position_noise) for points in (still.x, still.d))
        each = HerdState(x, seen(still.v, sensor.velocity_noise), d)
        ours.update(k * PERIOD, np.arange(9), each, u)
    for dogs in ((0, 2), (0, 1, 2)):
        part = replace(each, d=each.d[list(dogs)])
        believed = ours.update(41 * PERIOD, np.arange(9), part, u, dogs)
        assert len(believed.d) == len(dogs)
        assert np.abs(believed.x - still.x).max() < 0.8 * sensor.position_noise + 1e-9
        assert np.abs(believed.v).max() < 0.8 * sensor.velocity_noise + 1e-9


def test_an_exact_sensor_is_believed_to_the_bit(random_herd: Callable[..., HerdState]) -> None:
    ours = estimator(sensor=Sensor())
    for seed, t in enumerate((0.0, 0.1, 0.1, 7.0, 3.0)):
        observed = random_herd(3 + seed, 2, seed)
        believed = ours.update(t, np.arange(3 + seed), observed, np.ones((2, 2)))
        for name in 'xvd':
            assert getattr(believed, name).tobytes() == getattr(observed, name).tobytes()
    # Also where the positions, and they alone, are what was expected.
    ours, u = estimator(APART, Sensor()), np.zeros((1, 2, 2))
    herd = random_herd(5, 2)
    ours.update(0.0, np.arange(5), herd, u[0])
    moved = rollout(APART, herd, u, PERIOD / SUBSTEPS, SUBSTEPS).at(-1)
    seen = replace(moved, v=np.random.default_rng(0).normal(0.0, 0.03, (5, 2)))
    believed = ours.update(PERIOD, np.arange(5), seen, u[0])
    assert believed.v.tobytes() == seen.v.tobytes()


def test_a_controller_with_an_exact_sensor_plans_from_what_it_sees() -> None:
    """The loop is the one without any filter, written out here."""
    crowd, world = Crowd(noise=0.02), World(sheep=9, dogs=2, seed=1)
    horizon = Horizon(length=8.0, accepted=4.0, feedback=4.0)
    as_planned = Bodies(separation=0.0, ramp=0.0)
    control = Control(horizon=horizon, mapping=Mapping(paths=20), bodies=as_planned)
    run = closed_loop(crowd, world, control, GOAL, 10.0)
    planner = RecedingHorizon(crowd, control, GOAL, world.seed)

    def unfiltered(observed: HerdState, t: float) -> Array:
        if round(t / PERIOD) % 40 == 0:
            planner.solve(observed, t)
        assert planner.plan is not None
        return planner.plan.at(t)

    plain = play(Simulation(crowd, world, GOAL), unfiltered, 10.0)
    for name in ('x', 'd', 'u'):
        np.testing.assert_array_equal(getattr(run, name), getattr(plain, name))
    filtered = closed_loop(crowd, world, replace(control, sensor=Sensor(0.01, 0.005)), GOAL, 10.0)
    assert (filtered.u != run.u).any()


@pytest.mark.parametrize('sensor', [Sensor(0.0, 0.05), Sensor(0.05, 0.0)])
def test_what_is_exact_is_believed(sensor: Sensor, random_herd: Callable[..., HerdState]) -> None:
    ours, herd = estimator(sensor=sensor), random_herd(4, 2)
    exact = 'v' if sensor.position_noise else 'x'
    for k in range(20):
        believed = ours.update(k * PERIOD, np.arange(4), herd, np.zeros((2, 2)))
        np.testing.assert_allclose(
            getattr(believed, exact), getattr(herd, exact), rtol=0, atol=1e-9
        )


def test_the_filter_keeps_looking_where_the_model_has_no_noise() -> None:
    """Sheep that something unknown pulls: without any expected noise they would be lost."""
    crowd, u, pull = replace(APART, noise=0.0), np.zeros((1, 2)), np.array([0.005, 0.0])
    ours, rng = estimator(crowd), np.random.default_rng(0)
    x, v, d = np.zeros((50, 2)), np.zeros((50, 2)), np.ones((1, 2))
    for k in range(400):
        believed = ours.update(k * PERIOD, np.arange(50), blurred(HerdState(x, v, d), rng), u)
        x, v = x + PERIOD * v, v + PERIOD * (pull - 0.5 * v)
    assert x[0, 0] > 0.35
    assert np.abs((believed.x - (x - PERIOD * v)).mean(axis=0)).max() < 0.05


@pytest.mark.parametrize(
    ('noise', 'better'), [statistics(0.01, 2.5), statistics(0.02, 3.0), (0.05, 3.5)]
)
def test_errors_in_a_flock_that_is_herded(
    noise: float, better: float, random_herd: Callable[..., HerdState]
) -> None:
    """Twenty sheep that push each other, and three dogs that run into them."""
    rng = np.random.default_rng(2)
    herd = HerdState(
        rng.uniform(-0.4, 0.4, (20, 2)), np.zeros((20, 2)),
        np.array([[-0.8, -0.4], [-0.7, -0.7], [-0.4, -0.8]]),
    )  # fmt: skip
    watched = Watched(Crowd(), herd, np.full((3, 2), 0.03), 200, noise)
    seen, believed = watched.errors('x', first=20)
    assert seen == pytest.approx(noise, rel=0.05)
    assert believed < seen / better
    seen, believed = watched.errors('v', first=20)
    assert believed < seen / (1.8 if noise == 0.01 else better)
    seen, believed = watched.errors('d', first=20)
    assert believed < seen / (1.5 if noise == 0.01 else 2.5)
    assert watched.errors('x')[1] < 0.55 * noise  # the beginning included


def test_a_flock_whose_repulsion_is_wide_is_predicted_with_it() -> None:
    """The paper's printed potentials, under which the flock flies apart with some 0.3 m/s."""
    rng = np.random.default_rng(2)
    herd = HerdState(rng.uniform(-0.4, 0.4, (20, 2)), np.zeros((20, 2)), np.full((1, 2), -2.0))
    watched = Watched(CROWDS['printed'], herd, np.zeros((1, 2)), 100, 0.05)
    assert np.linalg.norm(watched.true[-1].v, axis=1).mean() > 0.1
    assert watched.errors('x', first=20)[1] < 0.02
    assert watched.errors('v', first=20)[1] < 0.015


def test_a_believed_flock_is_one_that_can_be() -> None:
    """Sheep that are seen on top of each other fly apart in a prediction; believed ones do not."""
    crowd, stand = Crowd(), np.zeros((100, 5, 2))
    start = Simulation(crowd, World(sheep=20), GOAL).state
    watched = Watched(crowd, start, stand[0], 31, 0.05)
    widths = [
        float(spread(rollout(crowd, state, stand, 0.05, 2).x[-1]))
        for state in (watched.true[30], watched.believed[30], watched.seen[30])
    ]
    assert widths[1] == pytest.approx(widths[0], rel=0.05)
    assert widths[2] > 1.2 * widths[0]


@pytest.mark.parametrize('seed', [statistics(seed) for seed in (900, 901, 902)])
def test_flock_comes_home_by_positions_alone(seed: int) -> None:
    """About as soon as with velocities of the same noise."""
    world = World(sheep=20, dogs=3, seed=seed, position_noise=0.05, velocity_noise=0.05)
    crowd, control = Crowd(noise=0.02), Control(sensor=NOISY)

    def time_home(is_velocity_seen: bool) -> float:
        flags = np.full(20, is_velocity_seen)
        pilot = LockstepPilot(RecedingHorizon(crowd, control, GOAL, seed), 3)

        def policy(observed: HerdState, t: float) -> Array:
            seen = replace(Observed.complete(t, observed), is_velocity_seen=flags)
            command = pilot.decide(seen).command
            assert command is not None
            return command

        run = play(Simulation(crowd, world, GOAL), policy, 100.0)
        assert run.arrived
        return float(run.t[-1])

    assert time_home(False) < 1.25 * time_home(True)


@pytest.mark.parametrize('seed', [0, *(statistics(seed) for seed in (1, 2))])
def test_flock_comes_home_under_bad_sensors(seed: int) -> None:
    """About as soon as with exact ones; `study observation` has more, also without the filter."""
    exact = World(sheep=20, dogs=5, seed=seed, position_noise=0.0, velocity_noise=0.0)
    bad = replace(exact, position_noise=0.05, velocity_noise=0.05)
    usual = closed_loop(Crowd(), exact, Control(), GOAL, 60.0)
    filtered = closed_loop(Crowd(), bad, Control(sensor=NOISY), GOAL, 60.0)
    assert usual.arrived
    assert filtered.arrived
    assert filtered.t[-1] < 1.2 * usual.t[-1]


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'ids': np.arange(4)}, r'names of sheep: expected shape \(3,\), .* got \(4,\)'),
        ({'dogs': (0,)}, r'names of dogs: expected shape \(2,\), .* got \(1,\)'),
        ({'dogs': (0, 2)}, r'dogs must be rows of u, 0 to 1, got \[0, 2\]'),
        ({'dogs': (-1, 0)}, r'dogs must be rows of u, 0 to 1, got \[-1, 0\]'),
        ({'u': np.zeros((1, 2))}, r'names of dogs: expected shape \(2,\), .* got \(1,\)'),
        ({'u': np.zeros((2, 3))}, r'u must have shape \(any, 2\), got'),
        ({'u': np.full((2, 2), np.nan)}, 'u must be finite'),
        ({'is_velocity_seen': np.full(4, True)}, r'velocity is seen: expected shape \(3,\)'),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(
    changes: dict[str, Any], words: str, random_herd: Callable[..., HerdState]
) -> None:
    for sensor in (NOISY, Sensor()):
        given = {'ids': np.arange(3), 'observed': random_herd(3, 2), 'u': np.zeros((2, 2))}
        with pytest.raises(ValueError, match=words):
            estimator(sensor=sensor).update(0.0, **(given | changes))


def believed_of(crowd: Crowd, state: HerdState, updates: int = 30) -> HerdState:
    """What is believed of a herd that stands, by observations that are the same for any crowd."""
    rng, filter_ = np.random.default_rng(3), estimator(crowd)
    for k in range(updates):
        seen = blurred(state, rng)
        believed = filter_.update(PERIOD * k, np.arange(len(state.x)), seen, np.zeros((1, 2)))
    return believed


def test_the_random_force_is_expected_where_and_when_it_is() -> None:
    """Calm on the left, wild on the right; the sheep do not feel each other."""
    x = np.array([[-1.0, 0.0], [1.0, 0.0], [-2.0, 1.0], [2.0, 1.0]])
    state = HerdState(x, np.zeros((4, 2)), np.array([[9.0, 9.0]]))
    side = replace(APART, noise=0.02, noise_field=lambda t, x: np.where(x[:, 0] > 0.0, 4.0, 1.0))
    found = believed_of(side, state)
    calm, wild = (believed_of(replace(APART, noise=sigma), state) for sigma in (0.02, 0.08))
    np.testing.assert_allclose(found.v[::2], calm.v[::2], rtol=1e-12)
    np.testing.assert_allclose(found.v[1::2], wild.v[1::2], rtol=1e-12)
    assert np.abs(calm.v - wild.v).min() > 1e-4
    growing = replace(APART, noise=0.02, noise_field=lambda t, x: 1.0 if t < 1.45 else 4.0)
    changed = believed_of(growing, state)
    np.testing.assert_allclose(
        believed_of(growing, state, 15).v, believed_of(replace(APART, noise=0.02), state, 15).v
    )
    assert np.abs(changed.v - calm.v).min() > 1e-5


def test_what_sheep_have_in_common_does_not_change_what_is_believed_of_one() -> None:
    state = HerdState(np.array([[-1.0, 0.0], [1.0, 0.0]]), np.zeros((2, 2)), np.ones((1, 2)))
    one, other = (believed_of(replace(FLOCK, common_noise=share), state) for share in (0.0, 1.0))
    np.testing.assert_array_equal(one.x, other.x)
    np.testing.assert_array_equal(one.v, other.v)
