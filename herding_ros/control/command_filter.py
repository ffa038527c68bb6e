# SPDX-License-Identifier: Apache-2.0
"""What stands between a plan and the dogs: commands that are smooth and keep them apart."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.bodies import closest
from herding_ros.model.field import Field, NO_FIELD
from herding_ros.model.motion import Obedient
from herding_ros.model.parameters import TINY
from herding_ros.model.state import Array, HerdState
import numpy as np

from .parameters import Bodies, Control
from .separation import Agility, gain_for, kept_apart, Neighbours, Obstacles


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
    margin is kept as far as that allows. All this is for dogs whose motion is `Obedient`: the
    commands of others stay as they are.
    """

    def __init__(self, dogs: int) -> None:
        """Begin without having seen any of so many dogs."""
        self._places = np.full((dogs, 2), np.nan)

    def place(self, m: int, position: Array) -> None:
        """Take in where a dog is (2,) [m] that is not commanded by a plan."""
        self._places[m] = position

    def place_of(self, m: int) -> Array:
        """Return where a dog was seen last (2,) [m]; NaN before."""
        return self._places[m].copy()

    def is_free(self, m: int, point: Array, control: Control) -> bool:
        """Whether no other dog is near the straight way of dog m to a point (2,) [m]."""
        others, way = np.delete(self._places, m, axis=0), point - self._places[m]
        along = np.clip((others - self._places[m]) @ way / max(way @ way, TINY), 0.0, 1.0)
        off = np.linalg.norm(others - self._places[m] - along[:, None] * way, axis=1)
        return bool(np.nanmin(off, initial=np.inf) > 2.0 * control.bodies.separation)

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
        motion, period = control.motion, control.horizon.control_period
        if not isinstance(motion, Obedient):
            return FilteredCommand(asked, False, False)
        self._places[seen] = state.dogs
        hidden = np.delete(self._places, seen, axis=0)
        hidden = hidden[np.isfinite(hidden[:, 0])]
        keeps = keeps_distances(control, field)
        wanted = u = asked[seen]
        before, most = last[seen], motion.largest_change(period)
        if keeps:
            limits = _Limits.of(control, motion)
            near = limits.neighbours(state, hidden, bodies, field)
            # Dogs that have to turn do so for what they would be told if they need not.
            u = kept_apart(near, wanted, limits.gain, limits.speed, bodies.margin)
        changed = u is not wanted
        if bodies.ramp or most < np.inf:
            smooth = control.max_speed * period / bodies.ramp if bodies.ramp else np.inf
            u = before + motion.project(u - before, min(most, smooth))
        if keeps:
            agility = Agility(before, most, motion.directions(state.d))
            u = kept_apart(
                near, u, limits.gain, limits.speed, part=not bodies.ramp, agility=agility
            )
        command = asked.copy()
        command[seen] = u
        return FilteredCommand(command, changed, keeps and _are_too_near(state.dogs, bodies))


@dataclass(frozen=True)
class _Limits:
    """How fast dogs may come nearer.

    speed: that no dog exceeds [m/s]; gain: that is safe [1/s], see `separation`; control_period
    [s]: for which commands hold; motion: of the dogs.
    """

    speed: float
    gain: float
    control_period: float
    motion: Obedient

    @classmethod
    def of(cls, control: Control, motion: Obedient) -> _Limits:
        period, most = control.horizon.control_period, motion.largest_change(1.0)
        ahead = motion.project(np.array([control.max_speed, 0.0]), control.max_speed)
        speed = float(np.linalg.norm(ahead))
        # A velocity that is reached at the end of a period takes effect a period later.
        delay = control.bodies.delay + (period if most < np.inf else 0.0)
        return cls(speed, gain_for(delay, period, most / speed), period, motion)

    def neighbours(
        self, state: HerdState, hidden: Array, bodies: Bodies, field: Field
    ) -> Neighbours:
        """Return what dogs have to keep from; hidden: (n, 2) places [m] of dogs that stand."""
        from_dogs, there = -np.inf, Obstacles.none()
        if bodies.separation:
            from_dogs = self._kept(bodies.separation)
            there = Obstacles.points(hidden, from_dogs)
        if bodies.sheep_distance:
            from_sheep = self._kept(bodies.sheep_distance)
            there = there.and_also(Obstacles.points(state.x, from_sheep))
        if len(field.bars):
            from_walls = self._kept(bodies.wall_distance)
            there = there.and_also(Obstacles.walls(field.bars, from_walls))
        reach = bodies.margin + self.speed / self.gain
        return Neighbours.of(state.dogs, from_dogs, there, reach)

    def _kept(self, distance: float) -> float:
        """Return what to keep so that ways which are not straight keep the distance."""
        bend = self.motion.bend(self.speed, self.control_period, distance)
        return distance + bend / (self.gain * self.control_period)


def keeps_distances(control: Control, field: Field = NO_FIELD) -> bool:
    """Return whether commands are to keep dogs from each other, from sheep or from walls."""
    bodies = control.bodies
    return bodies.separation > 0.0 or bodies.sheep_distance > 0.0 or len(field.bars) > 0


def _are_too_near(d: Array, bodies: Bodies) -> bool:
    return closest(d[None]) < bodies.separation - bodies.margin
