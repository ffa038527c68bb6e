# SPDX-License-Identifier: Apache-2.0
"""What stands between a plan and the dogs: commands that are smooth and keep them apart."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.bodies import closest
from herding_ros.model.field import Field, NO_FIELD
from herding_ros.model.motion import Holonomic
from herding_ros.model.state import Array, HerdState
import numpy as np

from .parameters import Bodies, Control
from .separation import gain_for, HalfPlanes, kept_apart


@dataclass(frozen=True)
class FilteredCommand:
    """What a dog is told in place of what a plan asks for.

    u: velocities (M, 2) [m/s]; changed: whether some are others to keep dogs apart; too_near:
    whether two dogs were nearer than they may be, by more than the margin.
    """

    u: Array
    changed: bool
    too_near: bool


class CommandFilter:
    """Changes commands as little as `Control.bodies` asks for, see `separation`.

    A command changes no faster than it may, but for two things: a dog that is not seen is taken to
    stand where it was seen last, and its command is left as it is; and distances come first. The
    margin is kept as far as that allows. All this is for dogs whose commands are velocities:
    those of others stay as they are.
    """

    def __init__(self, dogs: int) -> None:
        """Begin without having seen any of so many dogs."""
        self._places = np.full((dogs, 2), np.nan)

    def filtered(
        self,
        asked: Array,
        last: Array,
        state: HerdState,
        dogs: tuple[int, ...],
        control: Control,
        field: Field = NO_FIELD,
    ) -> FilteredCommand:
        """Return what to command for `asked` (M, 2), after `last` (M, 2) [m/s].

        state: of the sheep and of the dogs that are seen; dogs: these, by their indices; field:
        that they are in.
        """
        bodies, seen = control.bodies, list(dogs)
        if not isinstance(control.motion, Holonomic):
            return FilteredCommand(asked, False, False)
        self._places[seen] = state.dogs
        hidden = np.delete(self._places, seen, axis=0)
        hidden = hidden[np.isfinite(hidden[:, 0])]
        keeps = keeps_distances(control, field)
        wanted = u = asked[seen]
        if keeps:
            u = _apart(wanted, state, hidden, control, field, bodies.margin)
        changed = u is not wanted
        if bodies.ramp:
            most = control.max_speed * control.horizon.control_period / bodies.ramp
            u = last[seen] + control.motion.project(u - last[seen], most)
        if keeps:
            u = _apart(u, state, hidden, control, field, 0.0, part=not bodies.ramp)
        command = asked.copy()
        command[seen] = u
        return FilteredCommand(command, changed, keeps and _are_too_near(state.dogs, bodies))


def _apart(
    u: Array,
    state: HerdState,
    hidden: Array,
    control: Control,
    field: Field,
    margin: float,
    part: bool = True,
) -> Array:
    """Return the nearest commands that keep the distances and a margin [m]; u itself if it does.

    hidden: (n, 2) places [m] of dogs that stand; part: see `kept_apart`.
    """
    bodies, d = control.bodies, state.dogs
    gain = gain_for(bodies.delay, control.horizon.control_period)
    reach = control.max_speed / gain
    planes, distance = HalfPlanes.none(), -np.inf  # of two dogs
    if bodies.separation:
        distance = bodies.separation + margin
        planes = planes.and_also(HalfPlanes.around(hidden, d, distance, reach))
    if bodies.sheep_distance:
        from_sheep = bodies.sheep_distance + margin
        planes = planes.and_also(HalfPlanes.around(state.x, d, from_sheep, reach))
    if len(field.bars):
        gaps, normals = field.away(d)
        gaps -= bodies.wall_distance + margin
        dogs, walls = np.nonzero(gaps < reach)
        planes = planes.and_also(HalfPlanes(dogs, normals[dogs, walls], gaps[dogs, walls]))
    return kept_apart(d, u, distance, gain, control.max_speed, planes, part)


def keeps_distances(control: Control, field: Field = NO_FIELD) -> bool:
    """Return whether commands are to keep dogs from each other, from sheep or from walls."""
    bodies = control.bodies
    return bodies.separation > 0.0 or bodies.sheep_distance > 0.0 or len(field.bars) > 0


def _are_too_near(d: Array, bodies: Bodies) -> bool:
    return closest(d[None]) < bodies.separation - bodies.margin
