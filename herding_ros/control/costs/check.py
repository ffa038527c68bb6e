"""Whether a cost's derivatives are those of its value."""

from __future__ import annotations

import math

import numpy as np

from herding_ros.model.state import Array, Trajectory

from .cost import Cost

_STEPS = 1e-3 * 2.0 ** -np.arange(6.0)
_ROUND_OFF = 1e-12


def taylor_orders(
    cost: Cost, trajectory: Trajectory, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the orders in h at which two remainders vanish, in a random direction w (std 1 m).

    |C(x + h w) - C(x) - h C'(x) w|   and   |C'(x + h w) - C'(x) - h C''(x) w|

    for h around 1e-3. Both are 2 or more if the derivatives are right, and 1 if not; infinite
    if nothing but round-off remains.
    """
    w = np.zeros_like(trajectory.xs)
    w[:, :, : trajectory.n] = rng.standard_normal(w[:, :, : trajectory.n].shape)
    value, derivative = cost.value_and_derivative(trajectory)
    slope, change = float((derivative * w).sum()), cost.second_derivative(trajectory, w)
    values, derivatives = [], []
    for h in _STEPS:
        moved = Trajectory(
            trajectory.dt, trajectory.n, trajectory.xs + h * w, trajectory.vs, trajectory.ds
        )
        there, derivative_there = cost.value_and_derivative(moved)
        values.append(abs(there - value - h * slope))
        derivatives.append(float(np.linalg.norm(derivative_there - derivative - h * change)))
    return (
        _order(np.array(values), abs(value)),
        _order(np.array(derivatives), float(np.linalg.norm(derivative))),
    )


def _order(remainders: Array, scale: float) -> float:
    seen = remainders > _ROUND_OFF * scale
    pairs = seen[:-1] & seen[1:]
    orders = np.log2(remainders[:-1][pairs] / remainders[1:][pairs])
    return float(orders.min()) if len(orders) else math.inf
