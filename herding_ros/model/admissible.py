"""The admissible controls: no dog runs faster than u_max."""

from __future__ import annotations

import numpy as np

from .state import Array

_ROUND_OFF = 3.0 * np.finfo(np.float64).eps


def project(u: Array, max_speed: float) -> Array:
    """Return the admissible control nearest to u (..., 2): each |u_m| <= max_speed [m/s]."""
    speed = np.sqrt(u[..., 0] ** 2 + u[..., 1] ** 2)  # four times as fast as np.hypot
    # Rounded down, so that the result keeps the limit and a second projection changes nothing.
    shortened = max_speed * (1.0 - _ROUND_OFF) / np.maximum(speed, max_speed)
    return u * np.where(speed > max_speed, shortened, 1.0)[..., None]
