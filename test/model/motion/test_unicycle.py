# SPDX-License-Identifier: Apache-2.0
"""Dogs that have to turn."""

from herding_ros.model.motion import Unicycle
from herding_ros.model.state import Array
import numpy as np
import pytest

AHEAD, DT, SUBSTEPS = 0.1, 0.01, 10
MOTION = Unicycle(turn_rate=0.5, ahead=AHEAD)


def dogs_and_commands(intervals: int = 60) -> tuple[Array, Array]:
    rng = np.random.default_rng(0)
    d = np.column_stack([rng.normal(size=(4, 2)), rng.uniform(-4.0, 4.0, 4)])
    return d, MOTION.project(rng.normal(0.0, 0.05, (intervals, 4, 2)), 0.05)


def along(heading: Array) -> Array:
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def test_the_middle_runs_where_the_dog_is_headed_and_neither_speed_nor_turn_is_exceeded() -> None:
    d, u = dogs_and_commands()
    ds = MOTION.rollout(d, u, DT, SUBSTEPS)
    step, turn = np.diff(ds[:, :2], axis=0).transpose(0, 2, 1), np.diff(ds[:, 2], axis=0)
    headed = along(ds[:-1, 2] + 0.5 * turn)
    across = step[..., 0] * headed[..., 1] - step[..., 1] * headed[..., 0]
    np.testing.assert_allclose(across, 0.0, atol=1e-15)
    speed, rate = np.linalg.norm(step, axis=2) / DT, np.abs(turn) / DT
    assert 0.04 < speed.max() <= 0.05 * (1.0 + 1e-9)
    assert 0.4 < rate.max() <= 0.5 * (1.0 + 1e-9)
    held = rate.reshape(len(u), SUBSTEPS, -1)
    np.testing.assert_allclose(held, held[:, :1].repeat(SUBSTEPS, axis=1), atol=1e-12)


def test_the_point_ahead_moves_with_the_command() -> None:
    """To first order in the time for which speed and turn rate are kept."""
    d, u = dogs_and_commands()
    errors = []
    for parts in (1, 10, 100):
        finer = np.repeat(u, parts, axis=0)
        ds = MOTION.rollout(d, finer, 0.1 / parts, 1)
        ahead = ds[-1, :2].T + AHEAD * along(ds[-1, 2])
        wanted = d[:, :2] + AHEAD * along(d[:, 2]) + 0.1 * u.sum(axis=0)
        errors.append(np.abs(ahead - wanted).max())
    assert errors[0] < 0.02
    assert errors[1] == pytest.approx(10.0 * errors[2], rel=0.1)


def test_a_dog_that_is_told_to_run_back_does_so_and_turns_round() -> None:
    d = np.array([[0.0, 0.0, 3.0]])
    ds = MOTION.rollout(d, np.full((200, 1, 2), [0.05, 0.0]), DT, SUBSTEPS)
    assert np.cos(ds[-1, 2, 0]) == pytest.approx(1.0, abs=1e-3)
    assert np.diff(ds[:, 0, 0]).min() > -1e-5  # across, it stands
    assert ds[1, 0, 0] == pytest.approx(0.05 * DT, rel=0.05)
    assert ds[-1, 0, 0] > 0.7


def test_commands_that_would_turn_a_dog_too_fast_are_shortened() -> None:
    u = np.array([[0.04, 0.0], [0.0, -0.01]])
    found = Unicycle(turn_rate=0.2, ahead=0.1).project(u, 0.05)
    np.testing.assert_allclose(found, [[0.02, 0.0], [0.0, -0.01]], rtol=1e-12)
    assert np.linalg.norm(MOTION.project(np.array([3.0, 4.0]), 0.03)) == pytest.approx(0.03)


def test_the_transpose_is_that_of_the_derivative_for_each_function() -> None:
    d, u = dogs_and_commands(20)
    rng, step = np.random.default_rng(2), 1e-6
    w = rng.normal(size=u.shape)
    there, back = (MOTION.rollout(d, u + sign * step * w, 0.05, 2) for sign in (1.0, -1.0))
    ds = MOTION.rollout(d, u, 0.05, 2)
    source = rng.normal(size=(*ds.shape, 2))
    expected = 0.05 * np.einsum('kcmf,kcm->f', source, (there - back) / (2.0 * step))
    found = MOTION.transpose(ds, u, source, 0.05, 2)
    np.testing.assert_allclose(np.einsum('imcf,imc->f', found, w), expected, rtol=1e-6)
    one = MOTION.transpose(ds, u, source[..., 0], 0.05, 2)
    np.testing.assert_array_equal(one, found[..., 0])


def test_a_state_comes_from_odometry_and_goes_there() -> None:
    d, u = dogs_and_commands()
    position, heading, velocity = MOTION.odometry(d, u[0])
    np.testing.assert_array_equal(MOTION.state(position, heading, velocity), d)
    after = MOTION.rollout(d, u[:1], 1e-6, 1)[-1].T
    np.testing.assert_allclose((after - d)[:, :2], 1e-6 * velocity, atol=1e-12)
