# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
import dataclasses
import re

from herding_ros.control.coarse_model import CoarseModel, RememberingModel
from herding_ros.control.costs.control_effort import ControlEffort
from herding_ros.control.costs.leash import Leash
from herding_ros.control.objective import Objective, weighted_costs
from herding_ros.control.parameters import Weights
from herding_ros.model.alignment import Alignment
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.mean_field import mean_field
from herding_ros.model.motion import Accelerating, Holonomic, MotionModel, Unicycle
from herding_ros.model.potentials import PowerLaw
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

HerdMaker = Callable[..., HerdState]
Problem = tuple[CoarseModel, Objective, Array]

# Centre weight, spread weight: the observables centre and individuals, and others.
OBSERVABLES = {'centre': (1.0, 0.0), 'individuals': (1.0, 1.0), 'spread': (0.0, 1.0)}
OTHERS = ('dogs', 'terminal', 'containment', 'radius')
SIZES = [(1, 1), (2, 5), (5, 2), (8, 1), (9, 3), (16, 4), (17, 5)]
# Kernels know some of the potentials by a table.
WORLDS = {
    **CROWDS,
    'power law': Crowd(sheep=PowerLaw()),
    'no inertia': Crowd(order=1),
    'aligned': Crowd(alignment=Alignment(2.0, 0.2)),
}
presets = pytest.mark.parametrize('preset', WORLDS)
# The other worlds run the code of the first with other numbers.
kernels = pytest.mark.parametrize('preset', ['cohesive', 'power law', 'no inertia', 'aligned'])


@pytest.fixture(scope='session')
def problem(random_herd: HerdMaker) -> Callable[..., Problem]:
    """Return a maker of problems on a horizon of 2 s, all the rest of them random."""

    def make(preset: str, n: int, m: int, substeps: int, observable: str | None = None) -> Problem:
        rng = np.random.default_rng(100 * n + m)
        intervals, dt = 40 // substeps, 0.05
        centre, spread = OBSERVABLES[observable] if observable else rng.uniform(0.1, 5.0, 2)
        shape = (intervals, m, 2)
        coarse = CoarseModel(WORLDS[preset], random_herd(n, m, n + m), dt, substeps)
        weights = Weights(
            centre,
            spread,
            10.0 ** rng.uniform(-6.0, -3.0),
            **{} if observable else dict(zip(OTHERS, rng.uniform(0.1, 1.0, 4), strict=True)),
        )
        reference = rng.normal(0.0, 1.0, (intervals * substeps + 1, 2))
        effort = ControlEffort(weights.control, rng.normal(0.0, 0.05, shape))
        objective = Objective([*weighted_costs(weights, reference, 0.05), effort])
        return coarse, objective, rng.normal(0.0, 0.05, shape)

    return make


def remainders(problem: Problem, steps: Array) -> tuple[Array, float]:
    """|J(u + h w) - J(u) - h <grad J(u), w>| for each step h, w random; and |<grad J, w>|."""
    coarse, objective, u = problem
    direction = np.random.default_rng(5).normal(0.0, 1.0, u.shape)
    value, gradient = coarse.value_and_gradient(objective, u)
    slope = coarse.inner(gradient, direction)
    there = [coarse.value_and_gradient(objective, u + h * direction)[0] for h in steps]
    return np.abs(np.array(there) - value - steps * slope), abs(slope)


def assert_second_order(problem: Problem) -> None:
    # Small against the 1 cm within which the forces change, large against round-off.
    steps = 5e-4 * 2.0 ** -np.arange(5.0)
    found, slope = remainders(problem, steps)
    orders = np.log2(found[:-1] / found[1:])
    assert slope > 1e-7  # there is something to get wrong
    assert orders.min() > 1.9


@kernels
@pytest.mark.parametrize('observable', OBSERVABLES)
def test_taylor_remainder_is_of_second_order_for_each_observable(
    problem: Callable[..., Problem], preset: str, observable: str
) -> None:
    assert_second_order(problem(preset, 9, 3, 5, observable))


@kernels
@pytest.mark.parametrize(('n', 'm'), SIZES)
@pytest.mark.parametrize('substeps', [1, 5])
def test_taylor_remainder_is_of_second_order_for_any_herd(
    problem: Callable[..., Problem], preset: str, n: int, m: int, substeps: int
) -> None:
    assert_second_order(problem(preset, n, m, substeps))


@pytest.mark.parametrize('observable', OBSERVABLES)
def test_taylor_remainder_is_of_second_order_for_the_mean_field_limit(
    problem: Callable[..., Problem], observable: str
) -> None:
    coarse, objective, u = problem('cohesive', 500, 3, 5, observable)
    crowd, blobs = mean_field(coarse.crowd, coarse.state, 48)
    limit = dataclasses.replace(coarse, crowd=crowd, state=blobs)
    assert limit.rollout(u).n == 48
    assert_second_order((limit, objective, u))


class Cart:
    """Dogs (x, y, vx, vy) that a command accelerates, with drag: S = 4."""

    def project(self, u: Array, max_speed: float) -> Array:
        return u

    def rollout(self, d: Array, u: Array, dt: float, substeps: int) -> Array:
        ds = [d.T]
        for command in np.repeat(u, substeps, axis=0):
            x, v = ds[-1][:2], ds[-1][2:]
            ds.append(np.concatenate([x + dt * v, v + dt * (command.T - v * np.abs(v))]))
        return np.array(ds)

    def transpose(self, ds: Array, u: Array, source: Array, dt: float, substeps: int) -> Array:
        out = np.zeros((*u.shape, *source.shape[3:]))
        nu = np.zeros(source.shape[1:])
        for k in reversed(range(len(ds) - 1)):
            nu = nu + dt * source[k + 1]
            out[k // substeps] += dt * np.swapaxes(nu[2:], 0, 1)
            drag = 2.0 * np.abs(ds[k, 2:]).reshape(2, -1, *[1] * (source.ndim - 3))
            nu = np.concatenate([nu[:2], dt * nu[:2] + (1.0 - dt * drag) * nu[2:]])
        return out

    def state(self, position: Array, heading: Array, velocity: Array) -> Array:
        return np.concatenate([position, velocity], axis=1)

    def odometry(self, d: Array, u: Array) -> tuple[Array, Array, Array]:
        return d[:, :2], np.zeros(len(d)), d[:, 2:]


def test_dogs_may_move_in_other_ways(problem: Callable[..., Problem]) -> None:
    coarse, objective, u = problem('cohesive', 9, 3, 5)
    dogs = np.concatenate([coarse.state.d, np.full((3, 2), 0.1)], axis=1)
    herd = dataclasses.replace(coarse.state, d=dogs)
    cart = dataclasses.replace(coarse, state=herd, motion=Cart())
    assert_second_order((cart, objective, 10.0 * u))
    assert_sensitivity(cart, 10.0 * u, 7)


@pytest.mark.parametrize('motion', [Accelerating(acceleration=0.5), Unicycle(ahead=0.05)])
def test_taylor_remainder_is_of_second_order_for_each_motion(
    problem: Callable[..., Problem], motion: MotionModel
) -> None:
    coarse, objective, u = problem('cohesive', 9, 3, 5)
    odometry = coarse.state.d, np.array([0.0, 1.0, -2.0]), np.full((3, 2), 0.1)
    herd = dataclasses.replace(coarse.state, d=motion.state(*odometry))
    coarse = dataclasses.replace(coarse, state=herd, motion=motion)
    assert_second_order((coarse, objective, u))
    assert_sensitivity(coarse, u, 7)


@presets
@pytest.mark.parametrize('n', [8, 17])
def test_every_component_agrees_with_central_differences(
    problem: Callable[..., Problem], preset: str, n: int
) -> None:
    m, h = 1 + n % 5, 1e-5
    coarse, objective, u = problem(preset, n, m, substeps=5)
    expected = np.empty_like(u)
    for index in np.ndindex(u.shape):
        change = np.zeros_like(u)
        change[index] = h
        there, back = (
            coarse.value_and_gradient(objective, each)[0] for each in (u + change, u - change)
        )
        expected[index] = (there - back) / (2.0 * h) / coarse.interval
    _, gradient = coarse.value_and_gradient(objective, u)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-5 * scale)


def test_gradient_does_not_depend_on_how_the_interval_is_cut(
    problem: Callable[..., Problem],
) -> None:
    """Holding a control over five steps sums the five gradients: L2 averages them."""
    coarse, objective, u = problem('cohesive', 9, 3, 5)
    fine = dataclasses.replace(coarse, substeps=1)
    *costs, effort = objective.costs
    cut = dataclasses.replace(effort, reference=np.repeat(effort.reference, 5, axis=0))
    value, gradient = coarse.value_and_gradient(objective, u)
    fine_value, fine_gradient = fine.value_and_gradient(
        Objective([*costs, cut]), np.repeat(u, 5, axis=0)
    )
    assert value == pytest.approx(fine_value, rel=1e-13)
    averaged = fine_gradient.reshape(-1, 5, 3, 2).mean(axis=1)
    np.testing.assert_allclose(gradient, averaged, rtol=0, atol=1e-14)


def test_where_dogs_cannot_matter_only_the_control_counts(
    problem: Callable[..., Problem],
) -> None:
    coarse, objective, u = problem('cohesive', 5, 2, 1)
    objective = Objective([cost for cost in objective.costs if not isinstance(cost, Leash)])
    effort = objective.costs[-1]
    far = HerdState(coarse.state.x, coarse.state.v, coarse.state.d + 1e3)
    _, gradient = dataclasses.replace(coarse, state=far).value_and_gradient(objective, u)
    expected = effort.weight * (u - effort.reference)
    np.testing.assert_allclose(gradient, expected, rtol=1e-12)


def test_model_that_remembers_is_the_same_model(random_herd: HerdMaker) -> None:
    """Also after the control has changed in place, and on another grid."""
    model = CoarseModel(Crowd(), random_herd(5, 2), 0.05, 2)
    remembering = RememberingModel.of(model)
    controls = np.random.default_rng(0).normal(0.0, 0.05, (6, 8, 2, 2))
    first = remembering.rollout(controls[0])
    assert remembering.rollout(controls[0].copy()) is first
    for u in controls:
        assert np.array_equal(remembering.rollout(u).xs, model.rollout(u).xs)
    assert remembering.rollout(controls[0]) is not first  # too long ago: they take memory
    u = controls[5]
    u[3] *= 2.0
    assert np.array_equal(remembering.rollout(u).xs, model.rollout(u).xs)
    assert remembering.on_grid(2) is remembering
    assert np.array_equal(remembering.on_grid(1).rollout(u).xs, model.on_grid(1).rollout(u).xs)


def test_inner_product_is_that_of_square_integrable_functions(random_herd: HerdMaker) -> None:
    coarse = CoarseModel(CROWDS['cohesive'], random_herd(3, 1), 0.02, 5)
    t = (np.arange(20) + 0.5) * coarse.interval  # midpoints of a window of 2 s
    u = np.stack([np.sin(t), np.cos(t)], axis=-1)[:, None]
    assert coarse.interval == pytest.approx(0.1)
    assert coarse.inner(u, u) == pytest.approx(2.0, rel=1e-13)


@kernels
@pytest.mark.parametrize(('substeps', 'every'), [(1, 1), (5, 1), (5, 7), (5, 20)])
def test_centre_sensitivity_is_the_derivative_of_the_centre(
    problem: Callable[..., Problem], preset: str, substeps: int, every: int
) -> None:
    coarse, _, u = problem(preset, 9, 2, substeps)
    assert_sensitivity(coarse, u, every)


def assert_sensitivity(coarse: CoarseModel, u: Array, every: int) -> None:
    du, h = np.random.default_rng(0).normal(0.0, 1.0, u.shape), 1e-5
    there, back = (coarse.rollout(u + step * du).x.mean(axis=1) for step in (h, -h))
    times = range(every, 41, every)
    expected = np.sqrt(every * coarse.dt) * ((there - back) / (2.0 * h))[list(times)].ravel()
    linear = coarse.centre_sensitivity(u, every)
    np.testing.assert_array_equal(linear.nodes, times)
    scale = np.abs(expected).max()
    assert scale > 1e-4
    np.testing.assert_allclose(linear.times(du), expected, rtol=0, atol=1e-5 * scale)


def test_centre_sensitivity_is_weighted_like_an_integral(problem: Callable[..., Problem]) -> None:
    coarse, _, u = problem('cohesive', 5, 2, 5)
    linear = coarse.centre_sensitivity(u, 5)
    t = coarse.dt * np.arange(41.0)
    residual = linear.residual(np.stack([t, 1.0 - t], axis=1))
    # The right-hand Riemann sum of t^2 + (1 - t)^2 over (0, 2) with steps of a quarter.
    nodes = np.arange(1, 9) / 4.0
    expected = (nodes**2 + (1.0 - nodes) ** 2).sum() / 4.0
    assert residual @ residual == pytest.approx(expected, rel=1e-13)


@kernels
def test_transposed_sensitivity_is_the_adjoint(
    problem: Callable[..., Problem], preset: str
) -> None:
    coarse, _, u = problem(preset, 9, 3, 5)
    linear, rng = coarse.centre_sensitivity(u, 4), np.random.default_rng(1)
    du, e = rng.normal(size=u.shape), rng.normal(size=20)
    assert coarse.inner(du, linear.transposed(e)) == pytest.approx(linear.times(du) @ e, rel=1e-12)


class Short(Holonomic):
    """Sheep would meet each place of a dog a step too early, and not the last one."""

    def rollout(self, d: Array, u: Array, dt: float, substeps: int) -> Array:
        return super().rollout(d, u, dt, substeps)[1:]


class Broadcast(Holonomic):
    def transpose(self, ds: Array, u: Array, source: Array, dt: float, substeps: int) -> Array:
        return super().transpose(ds, u, source, dt, substeps)[0]


@pytest.mark.parametrize(
    ('motion', 'words'),
    [
        (Short(), 'Short.rollout must return shape (41, 2, 2), got (40, 2, 2)'),
        (Broadcast(), 'Broadcast.transpose must return shape (20, 2, 2), got (2, 2)'),
    ],
)
def test_what_a_motion_returns_has_its_shape(
    random_herd: HerdMaker, motion: MotionModel, words: str
) -> None:
    model = CoarseModel(Crowd(), random_herd(5, 2), 0.05, 2, motion)
    cost = Objective([Leash(1.0, np.zeros((41, 2)))])
    with pytest.raises(ValueError, match=f'^{re.escape(words)}$'):
        model.value_and_gradient(cost, np.zeros((20, 2, 2)))
