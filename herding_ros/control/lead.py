# SPDX-License-Identifier: Apache-2.0
"""How far ahead a controller plans when it is not in lockstep."""

from __future__ import annotations

SLOWEST, FASTEST = 1e-3, 1e3
"""Range of multiples of real time."""


def lead_at(real_time_factor: float) -> float:
    """Return the controller's lead [s] at a multiple of real time.

    A solve takes wall time: the faster the sim's clock, the earlier it has to begin.
    """
    return min(max(2.0, 0.5 * real_time_factor), 9.0)
