# SPDX-License-Identifier: Apache-2.0
"""A flock in a field: herded by the controller, or by the heuristic on the same routes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from dataclasses import field as default
import time
from typing import Any

from herding_ros.control.closed_loop import as_policy, play, Policy
from herding_ros.control.command_filter import CommandFilter
from herding_ros.control.lockstep_pilot import LockstepPilot
from herding_ros.control.parameters import Control, Mapping
from herding_ros.control.reach import Reach
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.control.scale import Scale
from herding_ros.control.solve_report import SolveReport
from herding_ros.control.ways import Ways
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.field import Field, read_field
from herding_ros.model.motion import MOTIONS
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState
import numpy as np

from .measures import course, measures, rounded, snapshots_at
from .strombom import Strombom


@dataclass
class Guided:
    """The heuristic in a field.

    It drives along the same routes as the controller, from posts on the sheep's side of walls, its
    dogs go round walls to their posts, and the same filter keeps them apart and off walls.
    """

    heuristic: Strombom
    field: Field
    control: Control
    goal: Array
    _filter: CommandFilter | None = default(default=None, init=False)
    _last: Array | None = default(default=None, init=False)

    def __call__(self, observed: HerdState, t: float) -> Array:
        """Return the dogs' velocities (M, 2) [m/s]."""
        count = len(observed.d)
        if self._filter is None or self._last is None:
            self._filter, self._last = CommandFilter(count), np.zeros((count, 2))
        ways = Ways.of(self.field, self.control.bodies, observed.x, self.goal)
        self.heuristic.ways = ways
        self.heuristic.goal = self.goal if ways is None else ways.aim(observed.x)
        asked = self.heuristic(observed, t)
        command = self._filter.filtered(
            asked, self._last, observed, tuple(range(count)), self.control, self.field
        )
        self._last = command.u
        return command.u


def run(
    field: str,
    policy: str,
    dogs: int,
    seed: int,
    time_limit: float,
    paths: int = Mapping.paths,
    every: float = 1.0,
    parts: int = 5,
) -> dict[str, Any]:
    """Herd the flock of a shipped field as `herd --field` does, and return the run in numbers.

    policy: 'planner' or 'strombom'; every: spacing of the stored course [s]; parts: number of
    pictures, evenly over the run. stops: steps that a dog could not take for a wall; gap: smallest
    distance of a dog from a wall [m]; crossings: steps of sheep through a wall; inside: sheep in
    the region at the end.
    """
    place, values = read_field(field)
    crowd, world, control = _herd(values)
    crowd = place.around(crowd)
    world = replace(world, dogs=dogs, seed=seed)
    control = control.with_values({'mapping.paths': paths})
    goal = place.place
    assert goal is not None
    reports: list[SolveReport] = []
    decide: Policy
    if policy == 'planner':
        pilot = LockstepPilot(RecedingHorizon(crowd, control, goal, seed), dogs)
        decide = as_policy(pilot, reports)
    elif policy == 'strombom':
        scale = Scale.of(crowd, world.max_speed)
        reach = Reach.of(crowd, world.max_speed)
        assert reach is not None
        distance = Strombom.sheep_distance * scale.length
        rng = np.random.default_rng([seed, 30_000])
        decide = Guided(Strombom(goal, rng, world.max_speed, distance), place, control, goal)
    else:
        raise ValueError(f"policy must be 'planner' or 'strombom', got {policy!r}")
    simulation = Simulation(crowd, world, goal)
    started = time.process_time()
    track = play(simulation, decide, time_limit)
    seconds = time.process_time() - started
    track = replace(track, d=track.d[..., :2])  # where dogs are, without their headings
    period = world.control_period
    instants = [float(track.t[k]) for k in np.linspace(0, len(track.t) - 1, parts).astype(int)]
    return {
        **measures(track, goal, period),
        'closest_dogs': simulation.closest_dogs if dogs > 1 else None,
        'stops': simulation.stops,
        'gap': float(place.away(track.d.reshape(-1, 2))[0].min()),
        'crossings': crossings(place, track.x),
        'inside': None if place.region is None else int(_inside(place, track.x[-1]).sum()),
        'cpu': seconds,
        'paths': course(track, goal, max(round(every / period), 1)),
        'snapshots': snapshots_at(track, instants, period),
        'bars': rounded(place.bars),
    }


def _herd(values: dict[str, Any]) -> tuple[Crowd, World, Control]:
    """Return crowd, world and controller with the parameters of a field."""
    left = dict(values)
    crowd = CROWDS[left.pop('crowd.preset', 'cohesive')]
    motion = MOTIONS[left.pop('motion.kind', 'holonomic')]
    speed = left.pop('max_speed', Control().max_speed)
    scale = Scale.of(crowd, speed)
    control = replace(scale.apply(Control(motion=motion)), max_speed=speed)
    world = replace(scale.apply(World(motion=motion)), max_speed=speed)
    shared = {name: value for name, value in left.items() if name.startswith('motion.')}
    return crowd, world.with_values(left), control.with_values(shared)


def crossings(field: Field, x: Array) -> int:
    """Return how many steps of sheep along x (T, N, 2) [m] cross a wall."""
    import shapely

    steps = np.stack([x[:-1], x[1:]], axis=2).reshape(-1, 2, 2)
    return int(shapely.intersects(field.walls, shapely.linestrings(steps)).sum())


def _inside(field: Field, x: Array) -> Array:
    from shapely import contains_xy

    return np.asarray(contains_xy(field.region, x))
