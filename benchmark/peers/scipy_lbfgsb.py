# SPDX-License-Identifier: Apache-2.0
"""The coarse problem with SciPy's L-BFGS-B and our value and gradient.

L-BFGS-B handles boxes, but the admissible velocities of a dog form a disc. (SLSQP handles discs,
but works with dense matrices: on a quarter of the horizon it had not arrived
after 200 evaluations and 14 s.) So the disc is the image of the plane,

    u = u_max tanh(|w|) w / |w|,

and w is free. Of the maps that were tried (polar coordinates within a box, w / sqrt(1 + w^2))
this one needs the fewest evaluations.
"""

from __future__ import annotations

from herding_ros.control.solution import ValueAndGradient
from herding_ros.model.state import Array
import numpy as np
from scipy.optimize import minimize

_SATURATED = 0.99
"""A start at the speed limit begins here: at the limit itself the derivative vanishes."""


def minimise(
    value_and_gradient: ValueAndGradient, start: Array, max_speed: float, interval: float
) -> Array:
    """Return the control (intervals, M, 2) [m/s] that L-BFGS-B ends with, from the start on.

    value_and_gradient gives the gradient in L2(0, T); interval [s] turns it into partial
    derivatives.
    """

    def function(w: Array) -> tuple[float, Array]:
        unit, stretch, direction = disc(w.reshape(start.shape))
        value, gradient = value_and_gradient(max_speed * unit)
        gradient = interval * max_speed * gradient
        along = (gradient * direction).sum(-1, keepdims=True) * direction
        radial = 1.0 - np.square(unit).sum(-1, keepdims=True)  # d tanh(r) / dr
        return value, (radial * along + stretch * (gradient - along)).ravel()

    options = {'maxiter': 1000, 'maxfun': 1000, 'ftol': 0.0, 'gtol': 0.0}
    w = _inverse(start / max_speed).ravel()
    found = minimize(function, w, jac=True, method='L-BFGS-B', options=options)
    return max_speed * disc(found.x.reshape(start.shape))[0]


def disc(w: Array) -> tuple[Array, Array, Array]:
    """Return u = tanh(|w|) w / |w| for w (..., 2), with tanh(|w|) / |w| and w / |w|."""
    r = np.hypot(w[..., 0], w[..., 1])[..., None]
    stretch = np.divide(np.tanh(r), r, out=np.ones_like(r), where=r > 0.0)
    direction = np.divide(w, r, out=np.zeros_like(w), where=r > 0.0)
    return stretch * w, stretch, direction


def _inverse(u: Array) -> Array:
    """Return w with u = tanh(|w|) w / |w|; where |u| is near 1, as if it were _SATURATED."""
    r = np.hypot(u[..., 0], u[..., 1])[..., None]
    ratio = np.divide(np.arctanh(np.minimum(r, _SATURATED)), r, out=np.ones_like(r), where=r > 0.0)
    return u * ratio
