# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
from functools import partial
import itertools

from herding_ros.control.coarse_model import CoarseModel
from herding_ros.control.costs.control_effort import ControlEffort
from herding_ros.control.costs.tracking import Tracking
from herding_ros.control.hessian import Hessian
from herding_ros.control.objective import Objective
from herding_ros.control.pqn import pqn
from herding_ros.control.solution import Budget, Problem, Status
from herding_ros.model.crowd import Crowd
from herding_ros.model.linear_algebra import MU, smoothed
from herding_ros.model.motion import Holonomic
from herding_ros.model.scenario import initial_herd
from herding_ros.model.state import Array
import numpy as np
import pytest

LIMIT = 0.05
project = Holonomic().project


def herding(seed: int) -> tuple[Objective, CoarseModel]:
    goal = np.array([0.5, 0.5])
    state = initial_herd(8, 2, goal, np.random.default_rng(seed))
    coarse = CoarseModel(Crowd(), state, 0.1, 1)
    return Objective([Tracking(3.0, 3.0, np.tile(goal, (201, 1))), ControlEffort(1e-2)]), coarse


@pytest.mark.parametrize(
    ('value', 'length', 'time'),
    [(4.0, 1.0, 1.0), (1.0, 2.0**-7, 1.0), (2.0**40, 2.0**9, 4.0**-5)],
)
@pytest.mark.parametrize('seed', range(3))
def test_no_unit_is_hidden(seed: int, value: float, length: float, time: float) -> None:
    """In other units, whose conversion is exact, each iterate is the same to the last bit."""
    objective, coarse = herding(seed)
    of_start = np.zeros((200, 2, 2))

    def solved(value: float, speed: float, time: float) -> tuple[list[Array], Status]:
        seen = []

        def value_and_gradient(u: Array) -> tuple[float, Array]:
            seen.append(u / speed)
            f, gradient = coarse.value_and_gradient(objective, u / speed)
            return value * f, value / (speed * time) * gradient

        problem = Problem(
            value_and_gradient,
            partial(project, max_speed=LIMIT * speed),
            lambda a, b: time * coarse.inner(a, b),
            LIMIT * speed,
        )
        return seen, pqn(problem, of_start, Budget(60, 1e-4)).status

    expected, status = solved(1.0, 1.0, 1.0)
    found, same = solved(value, length / time, time)
    assert status is same is Status.CONVERGED
    assert len(expected) > 5
    np.testing.assert_array_equal(found, expected)


def dense(times: Callable[[Array], Array], shape: tuple[int, int]) -> Array:
    units = np.eye(shape[0] * shape[1]).reshape(-1, *shape)
    return np.array([times(unit).ravel() for unit in units]).T


def smooth(h: Array) -> Array:
    out = np.empty_like(h)
    smoothed(h, out)
    return out


def test_smoothing_integrates_twice() -> None:
    """h.S h is the sum of the squares of the running mean, with the window as unit of time."""
    h = np.random.default_rng(0).standard_normal((7, 4))
    expected = np.square(np.cumsum(h, axis=0) / 7).sum() + MU * np.square(h).sum()
    assert (h * smooth(h)).sum() == pytest.approx(expected, rel=1e-14)
    matrix = dense(smooth, (7, 4))
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-16)


def test_hessian_is_that_of_bfgs_with_the_last_ten_steps() -> None:
    """The compact form against the update formula, one step after the other."""
    rng = np.random.default_rng(1)
    shape = (6, 2, 2)
    basis = rng.standard_normal((24, 24))
    curvature = basis @ basis.T
    base = dense(smooth, (6, 4))
    hessian, pairs = Hessian(), []
    for _ in range(13):
        s = rng.standard_normal(24)
        y = curvature @ s
        hessian.update(s.reshape(shape), y.reshape(shape))
        pairs.append((s, y))
        expected = (s @ y) / (s @ base @ s) * base
        for s, y in pairs[-10:]:
            product = expected @ s
            expected = expected + np.outer(y, y) / (s @ y)
            expected = expected - np.outer(product, product) / (s @ product)
        found = dense(hessian.times, (6, 4))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * abs(expected).max())


def test_negative_curvature_leaves_the_hessian_positive() -> None:
    rng = np.random.default_rng(2)
    basis = np.linalg.qr(rng.standard_normal((24, 24)))[0]
    curvature = basis @ np.diag(rng.uniform(-1.0, 1.0, 24)) @ basis.T
    hessian = Hessian()
    for _ in range(13):
        s = rng.standard_normal(24)
        hessian.update(s.reshape(6, 2, 2), (curvature @ s).reshape(6, 2, 2))
        if not hessian.known:
            continue
        found = dense(hessian.times, (6, 4))
        assert np.linalg.eigvalsh(found).min() > 0.0


def test_few_evaluations_where_spg_needs_many() -> None:
    objective, coarse = herding(0)
    problem = Problem(
        partial(coarse.value_and_gradient, objective),
        partial(project, max_speed=LIMIT),
        coarse.inner,
        LIMIT,
    )
    assert pqn(problem, np.zeros((200, 2, 2)), Budget(60, 1e-4)).calls < 15


def test_curvature_that_is_known_saves_evaluations() -> None:
    """From another time grid, as in a window: the second grid's solve ends sooner."""
    goal, calls = np.array([0.5, 0.5]), {True: 0, False: 0}
    for seed, known in itertools.product(range(3), calls):
        u, hessian = np.zeros((200, 2, 2)), Hessian()
        for substeps in (1, 2):
            state = initial_herd(8, 2, goal, np.random.default_rng(seed))
            coarse = CoarseModel(Crowd(), state, 0.1 / substeps, substeps)
            tracking = Tracking(3.0, 3.0, np.tile(goal, (200 * substeps + 1, 1)))
            objective = Objective([tracking, ControlEffort(1e-2)])
            problem = Problem(
                partial(coarse.value_and_gradient, objective),
                partial(project, max_speed=LIMIT),
                coarse.inner,
                LIMIT,
                hessian if known else None,
            )
            found = pqn(problem, u, Budget(60, 1e-4))
            u = found.u
        calls[known] += found.calls
    assert calls[True] < calls[False]


def test_hessian_goes_on_with_what_fits() -> None:
    """It begins with what is known of controls of its shape; what it learns stays its own."""
    rng = np.random.default_rng(0)
    shape, along = (20, 2, 2), np.ones((20, 4))
    known = Hessian()
    known.update(step := rng.standard_normal(shape), 2.0 * step)
    before = known.times(along)
    again = known.continued(shape)
    assert np.array_equal(again.times(along), before)
    again.update(step := rng.standard_normal(shape), 3.0 * step)
    assert not np.array_equal(again.times(along), before)
    assert np.array_equal(known.times(along), before)
    assert not known.continued((20, 1, 2)).known
