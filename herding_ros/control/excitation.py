# SPDX-License-Identifier: Apache-2.0
"""Dogs that run to and fro through the flock, for a recording that tells how sheep respond."""

from __future__ import annotations

from herding_ros.model.flock import centre
from herding_ros.model.scenario import Start
from herding_ros.model.state import Array, HerdState
import numpy as np

from .lockstep_pilot import LockstepPilot
from .pilot import Decision, Observed, Planner
from .scale import Scale

_HASTE = 2.0
"""In the reference scenario a dog runs to a post at this rate times its distance [1/s]."""


class ExcitingPilot(LockstepPilot):
    """Replies to each observation, and herds nowhere.

    Dog m of M runs on a diameter of its own of a circle about the flock's centre, to
    R cos(u_max t / R + p_m) (cos p_m, sin p_m) from there, with p_m = 2 pi m / M and R the radius
    on which dogs start in the reference scenario, to scale. So every sheep sees dogs at all
    distances, from all sides and at many speeds.
    """

    def __init__(self, planner: Planner, dogs: int) -> None:
        """Use crowd and control of a planner, which does not plan, for so many dogs."""
        super().__init__(planner, dogs)
        scale = Scale.of(planner.crowd, planner.control.max_speed)
        self._radius = scale.length * Start.dog_radius
        self._rate = _HASTE / scale.time

    def decide(self, observed: Observed) -> Decision:
        """Return the command for an observation of all dogs; see `LockstepPilot.decide`."""
        t = self._advance_to(observed.t)
        self._check_period(observed.stamp)
        self._visible = observed.dogs
        estimate = self._observe(observed)
        asked = np.zeros((self.dogs, 2))
        here = list(estimate.dogs)
        asked[here] = self._rate * (self._posts(estimate.state, t)[here] - estimate.state.dogs)
        admissible = self._control.motion.project(asked, self._control.max_speed)
        return self._decision(self._filtered(admissible, estimate), None)

    def _posts(self, state: HerdState, t: float) -> Array:
        """Return where dogs (M, 2) [m] should be."""
        angle = 2.0 * np.pi * np.arange(self.dogs) / self.dogs
        way = self._radius * np.cos(self._control.max_speed * t / self._radius + angle)
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.asarray(centre(state.x) + way[:, None] * direction)
