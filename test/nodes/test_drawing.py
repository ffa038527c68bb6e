# SPDX-License-Identifier: Apache-2.0
"""What is drawn of a pilot's decisions, in runs of a pilot."""

from __future__ import annotations

from dataclasses import replace

from herding_ros.control.lockstep_pilot import LockstepPilot
from herding_ros.control.parameters import Control, Horizon, Mapping
from herding_ros.control.pilot import Decision, Observed
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.field import Field, NO_FIELD
from herding_ros.model.state import HerdState
from herding_ros.nodes.drawing import Draughtsman, Drawing
import numpy as np
import shapely

GOAL = np.array([2.0, 0.0])
CONTROL = Control(horizon=Horizon(length=4.0, accepted=2.0), mapping=Mapping(max_iterations=0))
WALL = Field(fences=(((1.0, -0.5), (1.0, 0.5)),))
HERD = HerdState(
    np.array([[0.0, 0.1], [0.0, -0.1], [0.1, 0.0]]), np.zeros((3, 2)),
    np.array([[-0.5, 0.0], [-0.5, 0.3]]),
)  # fmt: skip


def drawn(
    field: Field = NO_FIELD, control: Control = CONTROL, herd: HerdState = HERD, periods: int = 10
) -> tuple[list[Drawing], list[Decision]]:
    """Drawings of a herd that stands, whatever dogs are told, and the decisions."""
    planner = RecedingHorizon(field.around(Crowd()), control, GOAL)
    pilot, draughtsman = LockstepPilot(planner, 2), Draughtsman()
    decisions = [pilot.decide(Observed.complete(0.1 * k, herd)) for k in range(periods)]
    shown = [draughtsman.follow(each, pilot.estimate, field, control) for each in decisions]
    assert draughtsman.follow(decisions[0], None, field, control) is None
    return [each for each in shown if each is not None], decisions


def test_every_fifth_period_there_are_dogs_and_a_straight_route() -> None:
    drawings, _ = drawn()
    assert len(drawings) == 2
    for drawing in drawings:
        assert drawing.dogs.tolist() == HERD.d.tolist()
        assert drawing.separation == CONTROL.bodies.separation
        np.testing.assert_allclose(drawing.route, [HERD.x.mean(axis=0), GOAL])
        assert not len(drawing.walls)
        assert not len(drawing.changes)


def test_a_route_leads_round_walls() -> None:
    drawings, _ = drawn(WALL)
    route = shapely.LineString(drawings[-1].route)
    assert not route.intersects(WALL.walls)
    assert route.length > 2.1
    assert drawings[-1].walls.tolist() == [[[1.0, -0.5], [1.0, 0.5]]]


def test_where_no_way_leads_there_is_no_route() -> None:
    around = ((1.5, -0.5), (2.5, -0.5), (2.5, 0.5), (1.5, 0.5), (1.5, -0.5))
    _, decisions = drawn(periods=5)
    draughtsman = Draughtsman()
    estimate = Observed.complete(0.0, HERD)
    shown = [
        draughtsman.follow(each, estimate, Field(fences=(around,)), CONTROL) for each in decisions
    ]
    assert shown[-1] is not None
    assert not len(shown[-1].route)
    assert len(shown[-1].walls) == 4


def test_of_each_dog_the_last_changed_command_is_drawn() -> None:
    """From what was asked to what is told, as the ways within 2 s; dog 2 is not seen."""
    herd = replace(HERD, d=np.array([[-0.5, 0.0], [-0.5, 0.3]]))
    estimate = Observed(0, np.arange(3), herd, (0, 2))
    told = np.array([[0.01, 0.0], [0.0, 0.0], [0.05, 0.0]])
    asked = np.array([[0.05, 0.0], [0.0, 0.05], [0.0500001, 0.0]])
    decisions = [
        Decision(told, asked=0.5 * asked),
        Decision(told, asked=asked),
        *[Decision(told)] * 8,
    ]
    draughtsman = Draughtsman()
    shown = [draughtsman.follow(each, estimate, NO_FIELD, CONTROL) for each in decisions]
    first, second = (each for each in shown if each is not None)
    np.testing.assert_allclose(first.changes[0], [[-0.5, 0.0], [-0.4, 0.0], [-0.48, 0.0]])
    # Half of what dog 3 is told was asked before: that was its last change.
    np.testing.assert_allclose(
        first.changes[1], [[-0.5, 0.3], [-0.45, 0.3], [-0.4, 0.3]], rtol=1e-6
    )
    assert len(first.changes) == 2
    assert not len(second.changes)
