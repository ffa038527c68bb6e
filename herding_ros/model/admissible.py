"""The admissible controls: no dog runs faster than u_max."""

from __future__ import annotations

import numpy as np

from .state import Array


def project(u: Array, max_speed: float) -> Array:
    """Return the admissible control nearest to u (..., 2): each |u_m| <= max_speed [m/s]."""
    speed = np.hypot(u[..., 0], u[..., 1])
    # Exactly one where the limit is kept, so that a projection twice changes nothing.
    scale = np.where(speed > max_speed, max_speed / np.maximum(speed, max_speed), 1.0)
    return u * scale[..., None]
