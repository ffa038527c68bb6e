# SPDX-License-Identifier: Apache-2.0
"""Whether a cost's derivatives are those of its value."""

from __future__ import annotations

from dataclasses import replace
import math

from herding_ros.model.state import Array, Trajectory
import numpy as np

from .checked import Checked
from .cost import Cost

_STEPS = 1e-3 * 2.0 ** -np.arange(6.0)
_ROUND_OFF = 1e-12


def taylor_orders(
    cost: Cost, trajectory: Trajectory, u: Array, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Return the orders in h at which |C(z + h w) - C(z) - h C'(z) w| vanishes.

    One each for z = x, d and u, for h around 1e-3 in a random direction w (standard deviation
    1 m, and 1 m/s for u). An order is 2 or more if the derivative is right, and 1 if not;
    infinite if nothing but round-off remains, as where C does not depend on z. Raises ValueError
    for values and derivatives that are NaN or of another shape.
    """
    cost = Checked(cost)
    value, by = cost.value_and_derivatives(trajectory, u)
    interval = trajectory.dt * (len(trajectory.xs) - 1) / len(u)
    wx = np.zeros_like(trajectory.xs)
    wx[:, :, : trajectory.n] = rng.standard_normal(wx[:, :, : trajectory.n].shape)
    wd, wu = rng.standard_normal(trajectory.ds.shape), rng.standard_normal(u.shape)

    def order(slope: float, wx: Array | float, wd: Array | float, wu: Array | float) -> float:
        remainders = []
        for h in _STEPS:
            moved = replace(trajectory, xs=trajectory.xs + h * wx, ds=trajectory.ds + h * wd)
            there, _ = cost.value_and_derivatives(moved, u + h * wu)
            remainders.append(abs(there - value - h * slope))
        return _order(np.array(remainders), abs(value))

    return (
        order(_dot(by.x, wx), wx, 0.0, 0.0),
        order(_dot(by.d, wd), 0.0, wd, 0.0),
        order(interval * _dot(by.u, wu), 0.0, 0.0, wu),
    )


def _dot(derivative: Array | None, direction: Array) -> float:
    return 0.0 if derivative is None else float((derivative * direction).sum())


def _order(remainders: Array, scale: float) -> float:
    seen = remainders > _ROUND_OFF * scale
    pairs = seen[:-1] & seen[1:]
    orders = np.log2(remainders[:-1][pairs] / remainders[1:][pairs])
    return float(orders.min()) if len(orders) else math.inf
