# SPDX-License-Identifier: Apache-2.0
"""What a window is planned for: where the flock is to go, who fetches whom, and where to start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import spreading
from herding_ros.model.field import field_of
from herding_ros.model.flock import centre, spread
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array
import numpy as np

from .coarse_model import CoarseModel
from .costs.cost import Cost
from .costs.cost_to_go import CostToGo
from .costs.spacing import Spacing
from .costs.tracking import Tracking
from .costs.walls import Walls
from .errands import Errands
from .objective import weighted_costs
from .parameters import Control
from .reach import Reach
from .reference import pace, reference
from .rules.collect_and_drive import CollectAndDrive
from .rules.rule import Rule, rule_plan
from .rules.surround import Surround
from .rules.target_selection import TargetSelection
from .ways import Ways

RULES: dict[str, Rule] = {
    'collect and drive': CollectAndDrive(),
    'target selection': TargetSelection(),
    'surround': Surround(),
}
"""Rules whose rollouts a plan may start from, by name."""

_ROUNDING = 0.5
"""Distances are rounded off below this part of the standoff."""


@dataclass(frozen=True)
class Task:
    """The costs of a window and the rules that may do it, for the state that it starts in.

    spread: weight of the sheep's distance from their centre; speed: of the reference [m/s];
    reach: None if no sheep notices a dog; errands: None if the cost ends with the window, or dogs
    attract; ways: None without walls.
    """

    control: Control
    goal: Array
    start: Array
    spread: float
    speed: float
    reach: Reach | None
    errands: Errands | None
    ways: Ways | None = None

    @classmethod
    def of(cls, control: Control, model: CoarseModel, goal: Array) -> Task:
        """Return the task in the state of a model; goal (2,) [m]."""
        crowd, state = model.crowd, model.state
        reach = Reach.of(crowd, control.max_speed)
        ways = Ways.of(field_of(crowd), control.bodies, state.x, goal)
        aim = goal if ways is None else ways.aim(state.x)
        attainable = control.reference.kind == 'attainable'
        speed = pace(crowd, reach, state, aim, control.max_speed) if attainable else 0.0
        errands, weight = None, control.weights.spread
        if reach is not None and reach.repels and control.weights.beyond:
            errands = Errands.of(reach, state, aim, ways)
            here = state.x[errands.together]
            weight *= _growth(crowd, here, reach.standoff, control.horizon.length)
        return cls(control, goal, centre(state.x), weight, speed, reach, errands, ways)

    def costs(self, times: Array, defect: Array | float = 0.0) -> list[Cost]:
        """Return the costs at the given times [s] of a window, control effort apart.

        The flock is expected where the coarse model has it plus the defect (K+1, 2) [m]. A flock
        that is herded one by one costs the squared distance of each sheep from the goal.
        """
        weights, errands = self.control.weights, self.errands
        if errands is not None and errands.goal is not None:
            place = np.tile(errands.goal, (len(times), 1))  # a view would need another kernel
            costs: list[Cost] = [Tracking(self.spread, self.spread, place)]
        else:
            straight = np.stack([self.start, self.goal])
            route = straight if self.ways is None else self.ways.route
            route = reference(self.control.reference.kind, self.speed, route, times)
            rounding = TINY if self.reach is None else _ROUNDING * self.reach.standoff
            weights = replace(weights, spread=self.spread)
            costs = weighted_costs(weights, route - defect, rounding)
        if errands is not None:
            to_go = weights.beyond * self.spread
            costs.append(CostToGo(errands, to_go, self.control.max_speed))
        bodies = self.control.bodies
        if weights.spacing and bodies.separation:
            costs.append(Spacing(weights.spacing, bodies.separation + 2.0 * bodies.margin))
        if weights.walls and self.ways is not None:
            costs.append(Walls(weights.walls, self.ways.clearance, self.ways.field.bars))
        return costs

    def rule_plans(self, model: CoarseModel, names: Sequence[str]) -> dict[str, Array]:
        """Return the controls (intervals, M, 2) [m/s] of rules on a model, by their names."""
        if not self.control.optimiser.rules or self.errands is None or self.reach is None:
            return {}
        intervals, max_speed = self.control.horizon.intervals, self.control.max_speed
        return {
            name: rule_plan(
                RULES[name], model, self.reach, self.goal, max_speed, intervals, self.ways
            )
            for name in names
        }


def _growth(crowd: Crowd, x: Array, least: float, time: float) -> float:
    """Return by which factor noise alone would raise the mean square distance from the centre.

    The coarse model knows nothing of it: without this factor the flock would be driven as fast
    under strong noise as under none. A spread [m] counts as the least one at least.
    """
    return 1.0 + spreading(crowd, x) * time / max(float(spread(x)), least) ** 2 if len(x) else 1.0
