# SPDX-License-Identifier: Apache-2.0
"""Dogs whose velocity follows the command with a limited acceleration."""

from herding_ros.model.motion import Accelerating, Holonomic
from herding_ros.model.state import Array
import numpy as np
import pytest

B, DT, SUBSTEPS = 0.02, 0.05, 2


def dogs_and_commands(intervals: int = 60) -> tuple[Array, Array]:
    """Dogs that run, and commands that change every second; some are followed, others are not."""
    rng = np.random.default_rng(0)
    d = np.hstack([rng.normal(size=(3, 2)), rng.normal(0.0, 0.02, (3, 2))])
    return d, np.repeat(rng.normal(0.0, 0.02, (intervals // 10, 3, 2)), 10, axis=0)


def test_speed_changes_no_faster_than_it_may_and_reaches_the_command() -> None:
    d, u = dogs_and_commands()
    ds = Accelerating(acceleration=B).rollout(d, u, DT, SUBSTEPS)
    change = np.linalg.norm(np.diff(ds[:, 2:], axis=0), axis=1)
    assert change.max() == pytest.approx(B * DT)
    np.testing.assert_allclose(np.diff(ds[:, :2], axis=0), DT * ds[1:, 2:], atol=1e-15)
    wanted = np.repeat(u, SUBSTEPS, axis=0).transpose(0, 2, 1)
    there = np.linalg.norm(wanted - ds[1:, 2:], axis=1) == 0.0
    assert 0.1 < there.mean() < 0.9


def test_from_rest_a_dog_is_at_full_speed_when_the_acceleration_says_so() -> None:
    """Speed b t, way b t^2 / 2, to first order in the time step."""
    d, u = np.zeros((1, 4)), np.full((25, 1, 2), [0.04, 0.03])
    ds = Accelerating(acceleration=B).rollout(d, u, 0.001, 100)
    np.testing.assert_allclose(ds[-1, 2:, 0], [0.04, 0.03], rtol=1e-9)
    assert np.linalg.norm(ds[-2, 2:, 0]) < 0.05
    assert np.linalg.norm(ds[-1, :2, 0]) == pytest.approx(0.5 * B * 2.5**2, rel=1e-3)


def test_with_a_large_acceleration_it_is_holonomic() -> None:
    d, u = dogs_and_commands()
    quick, holonomic = Accelerating(acceleration=1e3), Holonomic()
    ds = quick.rollout(d, u, DT, SUBSTEPS)
    np.testing.assert_array_equal(ds[:, :2], holonomic.rollout(d[:, :2], u, DT, SUBSTEPS))
    source = np.random.default_rng(1).normal(size=ds.shape)
    source[:, 2:] = 0.0
    np.testing.assert_allclose(
        quick.transpose(ds, u, source, DT, SUBSTEPS),
        holonomic.transpose(ds[:, :2], u, source[:, :2], DT, SUBSTEPS),
        rtol=1e-13,
    )


def test_the_transpose_is_that_of_the_derivative_for_each_function() -> None:
    d, u = dogs_and_commands()
    rng = np.random.default_rng(2)
    u += rng.normal(0.0, 1e-3, u.shape)
    motion, w, step = Accelerating(acceleration=B), rng.normal(size=u.shape), 1e-7
    there, back = (motion.rollout(d, u + sign * step * w, DT, SUBSTEPS) for sign in (1.0, -1.0))
    ds = motion.rollout(d, u, DT, SUBSTEPS)
    source = rng.normal(size=(*ds.shape, 2))
    expected = DT * np.einsum('kcmf,kcm->f', source, (there - back) / (2.0 * step))
    found = motion.transpose(ds, u, source, DT, SUBSTEPS)
    np.testing.assert_allclose(np.einsum('imcf,imc->f', found, w), expected, rtol=1e-6)
    one = motion.transpose(ds, u, source[..., 0], DT, SUBSTEPS)
    np.testing.assert_array_equal(one, found[..., 0])


def test_a_state_comes_from_odometry_and_goes_there() -> None:
    motion, (d, u) = Accelerating(), dogs_and_commands()
    position, heading, velocity = motion.odometry(d, u[0])
    np.testing.assert_array_equal(motion.state(position, heading, velocity), d)
