# SPDX-License-Identifier: Apache-2.0
"""A plan: velocities of the dogs from some time on."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.state import Array, finite
import numpy as np

SLACK = 1e-6
"""An instant this little before an interval counts as its start [s].

Seconds since 1970 in double precision are exact to 2.4e-7 s.
"""


@dataclass(frozen=True)
class Plan:
    """Dog velocities, constant on intervals of a regular time grid.

    t0: start [s]; dt: length of an interval [s]; u: (intervals, M, 2) velocities [m/s].
    """

    t0: float
    dt: float
    u: Array

    def __post_init__(self) -> None:
        """Validate, and convert to float64."""
        object.__setattr__(self, 'u', finite('plan u', self.u, (None, None, 2)))

    @property
    def end(self) -> float:
        """Time at which the plan has been played [s]."""
        return self.t0 + self.dt * len(self.u)

    def index(self, t: float) -> int:
        """Return the number of the interval that holds t [s]; negative before the start."""
        return int(np.floor((t - self.t0 + SLACK) / self.dt))

    def at(self, t: float) -> Array:
        """Velocities (M, 2) [m/s] at time t [s]; zero before the start and after the end."""
        k = self.index(t)
        return self.u[k] if 0 <= k < len(self.u) else np.zeros_like(self.u[0])

    def shifted(self, t: float) -> Plan:
        """Return a plan of equal length from t on, the end held: a start for the next solve."""
        k = np.arange(len(self.u)) + self.index(t)
        return Plan(t, self.dt, self.u[np.clip(k, 0, len(self.u) - 1)])
