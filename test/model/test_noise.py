# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
import dataclasses
import math
from pathlib import Path
import re

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import forces, rollout, spreading
from herding_ros.model.expectation import mean_centre
from herding_ros.model.kernels import lanes, PATHS
from herding_ros.model.noise import increments, noise_paths, strength
from herding_ros.model.noise_field import NoiseField, NoiseFunction
from herding_ros.model.potentials import Morse
from herding_ros.model.sampling import FineModel
from herding_ros.model.scenario import initial_herd
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
import numpy as np
import pytest

HerdMaker = Callable[..., HerdState]

NOTHING = Morse(repulsion=0.0, attraction=0.0)
FREE = Crowd(sheep=NOTHING, dog=NOTHING, noise=0.2)
"""Sheep that feel friction and noise alone."""
GOAL = np.array([0.5, 0.5])

shares = pytest.mark.parametrize('share', [0.0, 0.3, 1.0])


def whirl(t: float, x: Array) -> Array:
    """A field that is none of ours; both coordinates and the time count."""
    return np.asarray(1.0 + 0.5 * np.sin(3.0 * x[:, 0] - 2.0 * x[:, 1] + t))


FIELDS: dict[str, NoiseFunction] = {
    'slope': NoiseField(slope=(2.0, -1.0)),
    'gust': NoiseField(gust=0.9, period=0.7),
    'patch': NoiseField(patch=3.0, patch_centre=(0.1, -0.2), patch_radius=0.15),
    'all': NoiseField((-1.0, 0.5), 0.5, 1.3, -0.8, (-0.1, 0.2), 0.3),
    'function': whirl,
}
fields = pytest.mark.parametrize('field', FIELDS.values(), ids=FIELDS)


# What is drawn


@shares
def test_increments_are_brownian_for_each_sheep_with_the_correlation_asked_for(
    share: float,
) -> None:
    crowd, dt, steps = Crowd(noise=0.3, common_noise=share), 0.04, 20_000
    noise = increments(np.random.default_rng(2), crowd, 5, dt, steps)
    assert noise.shape == (steps, 2, lanes(5))
    assert not noise[..., 5:].any()
    drawn = noise[..., :5].reshape(steps, 10) / (0.3 * math.sqrt(dt))
    expected = np.kron(np.eye(2), share + (1.0 - share) * np.eye(5))
    many = 4.5 / math.sqrt(steps)
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=many)
    np.testing.assert_allclose(drawn.T @ drawn / steps, expected, atol=many * math.sqrt(2.0))
    np.testing.assert_allclose(drawn[1:].T @ drawn[:-1] / steps, 0.0, atol=many)


@shares
def test_what_is_common_is_common_to_the_sheep_of_one_path(share: float) -> None:
    crowd, dt, steps, paths = Crowd(noise=0.3, common_noise=share), 0.04, 4_000, PATHS + 3
    noise = noise_paths(np.random.default_rng(3), crowd, 2, dt, steps, paths)
    drawn = np.stack([noise.path(i)[:, :, :2] for i in range(paths)], axis=1)
    drawn = drawn.reshape(steps, -1) / (0.3 * math.sqrt(dt))
    expected = np.kron(np.eye(2 * paths), share + (1.0 - share) * np.eye(2))
    many = 5.0 / math.sqrt(steps)
    np.testing.assert_allclose(drawn.T @ drawn / steps, expected, atol=many * math.sqrt(2.0))
    assert not noise.path(paths - 1)[:, :, 2:].any()
    with pytest.raises(IndexError):
        noise.path(paths)


def test_individual_noise_takes_nothing_else_from_the_stream() -> None:
    dt, crowd = 0.05, Crowd(noise=0.03)
    found = increments(np.random.default_rng(1), crowd, 3, dt, 7)
    expected = np.random.default_rng(1).standard_normal((7, 2, 3)) * (0.03 * np.sqrt(dt))
    np.testing.assert_array_equal(found[..., :3], expected)
    blocks = noise_paths(np.random.default_rng(1), crowd, 3, dt, 7, 20).blocks
    expected = np.random.default_rng(1).standard_normal((2, 7, 2, 3 * PATHS))
    np.testing.assert_array_equal(blocks, expected * (0.03 * np.sqrt(dt)))


def test_wholly_common_noise_is_the_same_for_all_sheep() -> None:
    crowd = Crowd(common_noise=1.0)
    noise = increments(np.random.default_rng(0), crowd, 6, 0.1, 50)[..., :6]
    assert np.ptp(noise, axis=2).max() == 0.0
    assert np.abs(noise).min() > 0.0
    path = noise_paths(np.random.default_rng(0), crowd, 6, 0.1, 50, 3).path(2)[..., :6]
    assert np.ptp(path, axis=2).max() == 0.0


def test_common_noise_moves_the_flock_without_touching_its_shape(random_herd: HerdMaker) -> None:
    """Far from dogs nothing else moves the centre, and nothing the shape but the sheep."""
    crowd = Crowd(dog=NOTHING, noise=0.1, common_noise=1.0)
    state, u = random_herd(9, 1), np.zeros((1, 1, 2))
    noise = increments(np.random.default_rng(0), crowd, 9, 0.01, 300)
    windy, calm = (rollout(crowd, state, u, 0.01, 300, each).x for each in (noise, None))
    shift = (windy - calm).mean(axis=1, keepdims=True)
    assert np.abs(shift[-1]).max() > 0.01
    np.testing.assert_allclose(windy - shift, calm, rtol=0, atol=1e-11)


@shares
def test_the_centre_of_free_sheep_varies_as_theory_says(share: float) -> None:
    """Var = (c + (1 - c) / N) times that of a sheep, here of the discrete scheme, exactly."""
    n, dt, steps, paths = 6, 0.05, 40, 1000
    crowd = dataclasses.replace(FREE, common_noise=share)
    start = HerdState(np.zeros((n, 2)), np.zeros((n, 2)), np.ones((1, 2)))
    noise = noise_paths(np.random.default_rng(5), crowd, n, dt, steps, paths)
    u = np.zeros((1, 1, 2))
    ends = np.stack(
        [rollout(crowd, start, u, dt, steps, noise.path(i)).x[-1] for i in range(paths)]
    )
    damped = (1.0 - crowd.friction * dt) ** np.arange(steps - 1)
    single = crowd.noise**2 * dt * np.square(dt * np.cumsum(damped)).sum()
    centres = ends.mean(axis=1)
    within = np.square(ends - centres[:, None]).sum(axis=1) / (n - 1)
    # Four standard errors of a variance from so many normal numbers, two coordinates each.
    np.testing.assert_allclose(
        np.square(centres).mean(), (share + (1.0 - share) / n) * single, rtol=4.0 / paths**0.5
    )
    np.testing.assert_allclose(
        within.mean(), (1.0 - share) * single, rtol=4.0 / paths**0.5, atol=1e-25
    )
    np.testing.assert_allclose(np.square(ends).mean(), single, rtol=4.0 / paths**0.5)


@shares
def test_free_sheep_spread_as_fast_as_theory_says(share: float) -> None:
    n, dt = 500, 0.5
    crowd = dataclasses.replace(FREE, common_noise=share)
    start = HerdState(np.zeros((n, 2)), np.zeros((n, 2)), np.ones((1, 2)))
    steps = round(100.0 / dt)
    noise = increments(np.random.default_rng(3), crowd, n, dt, steps)
    x = rollout(crowd, start, np.zeros((1, 1, 2)), dt, steps, noise).x
    off = np.square(x - x.mean(axis=1, keepdims=True)).sum(axis=2).mean(axis=1)
    late = round(20.0 / dt)  # many times 1 / alpha
    rate = (off[-1] - off[late]) / (dt * (steps - late))
    assert rate == pytest.approx(spreading(crowd, start.x), rel=4.0 / n**0.5, abs=1e-20)


# The field


def test_the_field_is_what_its_formula_says() -> None:
    x = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.4], [-2.0, 0.0]])
    np.testing.assert_allclose(NoiseField(slope=(1.0, -2.0))(3.0, x), [1.0, 1.5, 0.7, 0.0])
    swinging = NoiseField(gust=0.5, period=4.0)
    for t, expected in ((0.0, 1.0), (1.0, 1.5), (2.0, 1.0), (3.0, 0.5), (5.0, 1.5)):
        np.testing.assert_allclose(swinging(t, x), expected)
    patch = NoiseField(patch=2.0, patch_centre=(0.5, 0.0), patch_radius=0.4)
    beside = 1.0 + 2.0 * math.exp(-0.5)
    np.testing.assert_allclose(patch(0.0, x)[1:3], [3.0, beside])
    every = NoiseField((1.0, -2.0), 0.5, 4.0, 2.0, (0.5, 0.0), 0.4)
    np.testing.assert_allclose(every(1.0, x)[1:3], [1.5 * 1.5 * 3.0, 0.7 * 1.5 * beside])


def constants_of(field: NoiseField) -> tuple[float, float]:
    """C and D of the class's docstring."""
    g, c = math.hypot(*field.slope), math.hypot(*field.patch_centre)
    high = 1.0 + max(field.patch, 0.0)
    growth = (1.0 + field.gust) * high * max(1.0, g)
    at_patch = (1.0 + g * c) * math.exp(-0.5) / field.patch_radius + 2.0 * g / math.e
    return growth, (1.0 + field.gust) * (g * high + abs(field.patch) * at_patch)


@pytest.mark.parametrize('name', ['slope', 'gust', 'patch', 'all'])
def test_the_field_keeps_the_paper_s_conditions(name: str) -> None:
    field, rng = FIELDS[name], np.random.default_rng(0)
    assert isinstance(field, NoiseField)
    growth, lipschitz = constants_of(field)
    steepest = highest = 0.0
    for t in np.linspace(0.0, 2.0 * field.period, 41):
        x = rng.normal(0.0, 1.0, (2000, 2)) * rng.choice([0.1, 0.5, 5.0], (2000, 1))
        near = x + rng.normal(0.0, 0.01, x.shape)
        here, there = field(t, x), field(t, near)
        distance = np.linalg.norm(x - near, axis=1)
        assert here.min() >= 0.0
        steepest = max(steepest, float((np.abs(here - there) / distance).max()))
        highest = max(highest, float((here / (1.0 + np.linalg.norm(x, axis=1))).max()))
    assert highest <= growth * (1.0 + 1e-12)
    assert steepest <= lipschitz * (1.0 + 1e-12) + 1e-12
    # The bounds say something: no field here comes to less than a third of its growth.
    assert highest > growth / 3.0
    assert steepest >= lipschitz / 6.0


def test_which_fields_are_uniform() -> None:
    assert NoiseField().is_uniform
    assert NoiseField(period=3.0, patch_radius=2.0).is_uniform
    for field in (NoiseField((0.0, 1.0)), NoiseField(gust=0.1), NoiseField(patch=-1.0)):
        assert not field.is_uniform
    np.testing.assert_array_equal(NoiseField()(7.0, np.ones((3, 2))), 1.0)


def test_strength_is_sigma_times_the_factor() -> None:
    x = np.random.default_rng(0).normal(size=(4, 2))
    assert strength(Crowd(noise=0.03), 5.0, x) == 0.03
    found = strength(Crowd(noise=0.03, noise_field=whirl), 5.0, x)
    np.testing.assert_allclose(found, 0.03 * whirl(5.0, x), rtol=1e-15)


def test_the_example_in_the_documentation_is_a_field() -> None:
    text = (Path(__file__).parents[2] / 'doc' / 'model.md').read_text(encoding='utf-8')
    blocks = re.findall('```python\n(.*?)```', text, re.DOTALL)
    (example,) = [block for block in blocks if 'noise_field' in block]
    crowd = eval(example, {'Crowd': Crowd, 'np': np})
    found = strength(crowd, 0.0, np.array([[0.0, 0.0], [100.0, 0.0]]))
    np.testing.assert_allclose(found, [0.03, 0.06])


# The state system with a field


def slow_rollout(
    crowd: Crowd, state: HerdState, u: Array, dt: float, noise: Array, t: float
) -> Array:
    """Euler-Maruyama by the letter: the field at the beginning of each step, sheep by sheep."""
    x, v, d = state.x, state.v, state.d
    found = [x]
    for k in range(len(u)):
        at = np.array([float(crowd.noise_field(t + k * dt, p[None])[0]) for p in x])
        force = forces(crowd, x, d) - crowd.friction * v
        x, v, d = x + dt * v, v + dt * force + at[:, None] * noise[k, :, : len(x)].T, d + dt * u[k]
        found.append(x)
    return np.array(found)


@fields
@pytest.mark.parametrize(('n', 'm', 'substeps', 't'), [(1, 1, 1, 0.0), (11, 2, 3, 17.3)])
def test_rollout_takes_the_field_at_the_beginning_of_each_step(
    random_herd: HerdMaker, field: NoiseFunction, n: int, m: int, substeps: int, t: float
) -> None:
    crowd, state = Crowd(noise=0.1, common_noise=0.4, noise_field=field), random_herd(n, m)
    rng, dt = np.random.default_rng(1), 0.05
    u = rng.normal(0.0, 0.1, (12, m, 2))
    noise = increments(rng, crowd, n, dt, 12 * substeps)
    found = rollout(crowd, state, u, dt, substeps, noise, t)
    expected = slow_rollout(crowd, state, np.repeat(u, substeps, axis=0), dt, noise, t)
    np.testing.assert_allclose(found.x, expected, rtol=0, atol=1e-12)
    assert not found.xs[..., n:].any()
    uniform = rollout(dataclasses.replace(crowd, noise_field=NoiseField()), state, u, dt, substeps,
                      noise)  # fmt: skip
    assert np.abs(found.x - uniform.x).max() > 1e-3


@fields
def test_expectation_in_a_field_is_the_mean_of_single_rollouts(
    random_herd: HerdMaker, field: NoiseFunction
) -> None:
    crowd, state, paths = Crowd(noise=0.1, noise_field=field), random_herd(7, 2), PATHS + 4
    u, dt, t = np.random.default_rng(1).normal(0.0, 0.05, (20, 2, 2)), 0.05, 3.1
    noise = noise_paths(np.random.default_rng(0), crowd, 7, dt, 40, paths)
    singles = [rollout(crowd, state, u, dt, 2, noise.path(i), t).x for i in range(paths)]
    found = mean_centre(FineModel(crowd, state, dt, 40, 2, t), u, noise)
    np.testing.assert_allclose(found, np.mean(singles, axis=(0, 2)), rtol=0, atol=1e-13)


@pytest.mark.parametrize('value', [1.0, 2.0])
def test_a_constant_function_is_a_uniform_sigma(random_herd: HerdMaker, value: float) -> None:
    crowd, state = Crowd(noise=0.1, noise_field=lambda t, x: value), random_herd(9, 2)
    uniform, u, dt = Crowd(noise=value * 0.1), np.full((15, 2, 2), 0.03), 0.05
    found, expected = (
        rollout(each, state, u, dt, 2, increments(np.random.default_rng(0), each, 9, dt, 30))
        for each in (crowd, uniform)
    )
    np.testing.assert_array_equal(found.x, expected.x)
    np.testing.assert_array_equal(found.v, expected.v)
    mean, wanted = (
        mean_centre(
            FineModel(each, state, dt, 30, 2),
            u,
            noise_paths(np.random.default_rng(0), each, 9, dt, 30, 20),
        )
        for each in (crowd, uniform)
    )
    np.testing.assert_allclose(mean, wanted, rtol=0, atol=1e-14)


def test_in_a_field_paths_converge_at_first_order() -> None:
    """The noise acts on velocities and sigma looks at positions: Milstein's term is zero."""
    crowd = dataclasses.replace(FREE, noise=0.5, noise_field=FIELDS['all'])
    n, t_end, finest = 64, 2.0, 2048
    rng = np.random.default_rng(4)
    start = HerdState(rng.uniform(-0.4, 0.4, (n, 2)), np.zeros((n, 2)), np.ones((1, 2)))
    noise = increments(rng, crowd, n, t_end / finest, finest)

    def end(steps: int) -> Array:
        coarser = noise.reshape(steps, finest // steps, *noise.shape[1:]).sum(axis=1)
        u = np.zeros((1, 1, 2))
        return rollout(crowd, start, u, t_end / steps, steps, coarser).v[-1]

    exact, steps = end(finest), np.array([16, 32, 64, 128])
    errors = [np.sqrt(np.square(end(each) - exact).mean()) for each in steps]
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 0.85 < order < 1.2


def test_moments_in_a_slope_and_a_gust_are_those_of_their_recursion() -> None:
    """For sigma linear in x the second moments of the scheme are closed."""
    g, gust, period, dt, steps, t0 = 1.0, 0.8, 1.5, 0.05, 40, 0.4
    field = NoiseField(slope=(g, 0.0), gust=gust, period=period)
    crowd, sheep, runs = dataclasses.replace(FREE, noise_field=field), 50, 240
    start = HerdState(np.zeros((sheep, 2)), np.zeros((sheep, 2)), np.ones((1, 2)))
    rng, u = np.random.default_rng(6), np.zeros((1, 1, 2))
    ends = [
        rollout(crowd, start, u, dt, steps, increments(rng, crowd, sheep, dt, steps), t0)
        for _ in range(runs)
    ]
    assert min(each.x[..., 0].min() for each in ends) > -1.0 / g  # where it is still linear
    xx, xv, vv, damping = 0.0, 0.0, 0.0, 1.0 - crowd.friction * dt
    for k in range(steps):
        swing = 1.0 + gust * math.sin(2.0 * math.pi * (t0 + k * dt) / period)
        random = (crowd.noise * swing) ** 2 * dt * (1.0 + g**2 * xx)
        xx, xv, vv = (
            xx + 2.0 * dt * xv + dt**2 * vv,
            damping * (xv + dt * vv),
            damping**2 * vv + random,
        )
    x, v = (np.concatenate([getattr(each, name)[-1] for each in ends]) for name in ('x', 'v'))
    for found, expected in ((x * x, xx), (x * v, xv), (v * v, vv)):
        along = found[:, 0]
        assert abs(along.mean() - expected) < 4.0 * along.std() / math.sqrt(len(along))


def test_a_patch_without_noise_is_calm() -> None:
    field = NoiseField(patch=-1.0, patch_centre=(0.3, 0.3), patch_radius=0.1)
    crowd = dataclasses.replace(FREE, noise_field=field)
    state = HerdState(np.array([[0.3, 0.3], [2.0, 2.0]]), np.zeros((2, 2)), np.ones((1, 2)))
    noise = increments(np.random.default_rng(0), crowd, 2, 0.01, 20)
    found = rollout(crowd, state, np.zeros((1, 1, 2)), 0.01, 20, noise).x[-1] - state.x
    assert not found[0].any()
    assert np.abs(found[1]).max() > 1e-3


# The simulated world


def test_the_world_s_time_goes_on_from_period_to_period() -> None:
    crowd = Crowd(noise=0.1, common_noise=0.5, noise_field=FIELDS['all'])
    world, u = World(sheep=5, dogs=2, seed=3), np.full((8, 2, 2), 0.01)
    simulation = Simulation(crowd, world, GOAL)
    for each in u:
        simulation.advance(each)
    flock = np.random.default_rng(3)
    start = initial_herd(5, 2, GOAL, flock)
    process, _ = flock.spawn(2)
    periods = [increments(process, crowd, 5, world.dt, world.substeps) for _ in u]
    expected = rollout(crowd, start, u, world.dt, world.substeps, np.concatenate(periods))
    np.testing.assert_allclose(simulation.state.x, expected.x[-1], rtol=0, atol=1e-13)


@fields
def test_the_seed_decides(field: NoiseFunction) -> None:
    crowd = Crowd(noise=0.05, common_noise=0.5, noise_field=field)
    first, same, other = (
        Simulation(crowd, World(sheep=5, dogs=2, seed=seed), GOAL) for seed in (1, 1, 2)
    )
    for simulation in (first, same, other):
        for _ in range(5):
            simulation.advance(np.full((2, 2), 0.02))
    np.testing.assert_array_equal(first.state.x, same.state.x)
    assert (first.state.x != other.state.x).all()


# Functions that are no fields

WRONG: dict[str, tuple[Callable[[float, Array], object], str]] = {
    'shape': (
        lambda t, x: x,
        r'must return shape \(\d+,\) or .* t = 2 s, got \(\d+, 2\)',
    ),
    'too few': (lambda t, x: np.ones(3), r'must return shape \(\d+,\) .*, got \(3,\)'),
    'NaN': (
        lambda t, x: np.where(x[:, 0] > 0.2, np.nan, 1.0),
        r'must be .* got nan at t = 2 s, x = \(0\.3, ',
    ),
    'infinity': (lambda t, x: math.inf, r'must be .*, got inf at t = 2 s'),
    'negative': (lambda t, x: -x[:, 0], r'must be .*, got -0\.1 at t = 2 s, x = \(0\.1, 0\.2\) m'),
    'words': (lambda t, x: 'strong', r'must return numbers at t = 2 s'),
    'nothing': (lambda t, x: None, r'must be .*, got nan at t = 2 s'),
}


@pytest.mark.parametrize('kind', WRONG)
def test_what_is_no_field_is_refused_in_words(kind: str) -> None:
    function, words = WRONG[kind]
    crowd = Crowd(noise_field=function)  # type: ignore[arg-type]
    state = HerdState(np.array([[0.1, 0.2], [0.3, -0.4]]), np.zeros((2, 2)), np.ones((1, 2)))
    u, rng = np.zeros((1, 1, 2)), np.random.default_rng(0)
    with pytest.raises(ValueError, match=f'^noise_field {words}'):
        rollout(crowd, state, u, 0.1, 1, increments(rng, crowd, 2, 0.1, 1), 2.0)
    fine = FineModel(crowd, state, 0.1, 1, 1, 2.0)
    with pytest.raises(ValueError, match=f'^noise_field {words}'):
        mean_centre(fine, u, noise_paths(rng, crowd, 2, 0.1, 1, 20))


def test_a_function_that_changes_its_argument_moves_no_sheep(random_herd: HerdMaker) -> None:
    def careless(t: float, x: Array) -> Array:
        x -= x.mean(axis=0)
        return np.exp(-np.square(x).sum(axis=1))

    def careful(t: float, x: Array) -> Array:
        return careless(t, x.copy())

    for n in (1, 6):
        first, second = (
            rollout(
                crowd, random_herd(n, 1), np.full((9, 1, 2), 0.02), 0.05, 1,
                increments(np.random.default_rng(0), crowd, n, 0.05, 9),
            ).x
            for crowd in (Crowd(noise_field=careless), Crowd(noise_field=careful))
        )  # fmt: skip
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize('field', [0.5, None, 'gust', Morse()], ids=str)
def test_only_fields_and_functions_stand_for_a_field(field: object) -> None:
    words = r'^Crowd\.noise_field must be a NoiseFunction, got .*$'
    with pytest.raises(ValueError, match=words):
        Crowd(noise_field=field)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ('values', 'named'),
    [
        ({'gust': 1.1}, 'gust must be from 0 to 1, got 1.1'),
        ({'period': 0.0}, r'period must be from 1e-09 to 1e\+09, got 0.0'),
        ({'patch': -1.5}, r'patch must be from -1 to 1e\+09, got -1.5'),
        ({'patch_radius': 0.0}, r'patch_radius must be from 1e-09 to 1e\+09, got 0.0'),
        (
            {'slope': (1.0, math.inf)},
            r'slope must be 2 numbers from -1e\+09 to 1e\+09, got \(1.0, inf\)',
        ),
    ],
)
def test_fields_that_would_be_none_are_refused(values: dict[str, float], named: str) -> None:
    with pytest.raises(ValueError, match=rf'^NoiseField\.{named}$'):
        NoiseField(**values)  # type: ignore[arg-type]


@pytest.mark.parametrize('share', [-0.1, 1.1, math.nan])
def test_a_share_is_between_none_and_all(share: float) -> None:
    with pytest.raises(ValueError, match=r'^Crowd\.common_noise must be .*from 0 to 1, got '):
        Crowd(common_noise=share)
