# SPDX-License-Identifier: Apache-2.0
"""The world: the herd in small noisy steps, and noisy observations of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .bodies import Body, closest, touches
from .crowd import Crowd
from .delay import delay_quantity, periods
from .field import field_of
from .flock import Arrival, arrived, centre, spread, without_strays
from .motion import Holonomic, MotionModel
from .parameters import Parameters, quantity, TINY
from .scenario import initial_herd, MOST_DOGS, MOST_SHEEP, Start
from .state import Array, finite, HerdState, Trajectory


@dataclass(frozen=True)
class World(Parameters):
    """The simulated world, apart from the crowd."""

    sheep: int = quantity(30, 'number of sheep', low=1, high=MOST_SHEEP)
    dogs: int = quantity(5, 'number of dogs', low=1, high=MOST_DOGS)
    seed: int = quantity(0, 'seed of the initial flock and of all noise', low=0)
    dt: float = quantity(0.01, 'time step', 's', low=1e-6, high=10.0)
    substeps: int = quantity(10, 'time steps in a control period', low=1, high=10_000)
    position_noise: float = quantity(
        0.01, 'standard deviation of observed positions', 'm', low=0.0
    )
    velocity_noise: float = quantity(
        0.005, 'standard deviation of observed velocities', 'm/s', low=0.0
    )
    max_speed: float = quantity(5e-2, 'a dog runs no faster than this', 'm/s', low=TINY)
    delay: float = delay_quantity('time until dogs carry out a command')
    motion: MotionModel = Holonomic()
    bodies: Body = Body()
    start: Start = Start()
    arrival: Arrival = Arrival()

    def __post_init__(self) -> None:
        """Check what goes together."""
        super().__post_init__()
        periods('World.delay', self.delay, self.control_period)
        if self.arrival.strays >= self.sheep:
            raise ValueError(
                f'World.arrival.strays must be less than World.sheep, {self.sheep}, '
                f'got {self.arrival.strays}'
            )

    @property
    def control_period(self) -> float:
        """Time between two observations [s]."""
        return self.dt * self.substeps


@dataclass(frozen=True)
class Observation:
    """Noisy state of the herd, and the velocities (M, 2) [m/s] of the dogs."""

    state: HerdState
    dog_velocities: Array


def single(values: Array) -> Array:
    """Round to single precision, in which point clouds are published."""
    return values.astype(np.float32).astype(np.float64)


class Simulation:
    """The herd at the resolution of the sim: advance() with the commands, then observe().

    Everything follows from the seed: the flock, the process noise and the observation noise
    come from separate streams, so that observing the herd does not change it.
    """

    def __init__(
        self, crowd: Crowd, world: World, goal: Array, start: HerdState | None = None
    ) -> None:
        """Start from a herd, (M, 2) positions of dogs, by default that of `World.start`.

        For that, goal (2,) [m] decides the side that dogs start on; dogs that attract start ahead
        of the flock. Raises ValueError if the herd has not as many sheep and dogs as the world, or
        more of a dog than its position.
        """
        self.crowd = crowd
        self.world = world
        self.goal = goal
        flock = np.random.default_rng(world.seed)
        herd = start
        if herd is None:
            places = world.start
            attract = bool(crowd.dog.derivative(np.array([places.dog_radius])) > 0.0)
            herd = initial_herd(world.sheep, world.dogs, self.goal, flock, attract, places)
            to_flock = places.centre - herd.d
        else:
            for name, points in (('sheep', herd.x), ('dogs', herd.d)):
                if getattr(world, name) != len(points):
                    raise ValueError(
                        f'{name} must be as many as the start has, {len(points)}, '
                        f'got {getattr(world, name)}'
                    )
            finite('dogs d of the start', herd.d, (None, 2))
            to_flock = centre(herd.x) - herd.d
        facing = np.arctan2(to_flock[:, 1], to_flock[:, 0])
        dogs = world.motion.state(herd.d, facing, np.zeros_like(herd.d))
        self.state = replace(herd, d=dogs)
        self.dog_velocities: Array = np.zeros((world.dogs, 2))
        """The commands (M, 2) [m/s] that were in effect in the last control period."""
        late = periods('delay', world.delay, world.control_period)
        self._under_way: list[Array] = [np.zeros((world.dogs, 2))] * late
        self.periods = 0
        self.touches = touches(self.state.dogs[None], world.bodies.radius)
        """How often two dogs have come to touch; they run on all the same."""
        self.stops = 0
        """Steps that a dog could not take, since a wall was in its way."""
        self.closest_dogs = closest(self.state.dogs[None])
        """The smallest distance there was between two dogs [m]; infinite for a single dog."""
        self.initial_spread = float(spread(single(self.flock)))
        self._held_since: int | None = None
        self._note_who_is_inside()
        field_of(crowd).check_clear(self.state, world.bodies.radius)
        self._process, self._sensor = flock.spawn(2)

    @property
    def goal(self) -> Array:
        """Where the flock should go (2,) [m]; may be set."""
        return self._goal

    @goal.setter
    def goal(self, goal: Array) -> None:
        self._goal = finite('goal', goal, (2,))

    @property
    def control_period(self) -> float:
        """Time between two observations [s]."""
        return self.world.control_period

    @property
    def nanoseconds(self) -> int:
        """Simulated time since the start [ns]."""
        return self.periods * round(self.world.control_period * 1e9)

    @property
    def headings(self) -> Array:
        """Headings (M,) [rad] of the dogs when the next command takes effect."""
        world, d = self.world, self.state.d
        if self._under_way:
            under_way = np.array(self._under_way)
            d = world.motion.rollout(d, under_way, world.dt, world.substeps)[-1].T
        return world.motion.odometry(d, self.dog_velocities)[1]

    @property
    def flock(self) -> Array:
        """Positions (n, 2) [m] of the sheep that have to arrive: all but strays."""
        return without_strays(self.state.x, self.world.arrival.strays)

    @property
    def arrived(self) -> bool:
        """Whether the flock, rounded as it is published, is at the goal and together.

        Where the goal is that of a field with a region: whether that has held the flock for as
        long as the field says.
        """
        x, when, field = single(self.state.x), self.world.arrival, field_of(self.crowd)
        if field.is_judge(self.goal):
            if self._held_since is None:
                return False
            held = (self.periods - self._held_since) * self.control_period
            return held > field.hold - 0.5 * self.control_period
        return arrived(x, self.goal, self.initial_spread, when)

    def advance(self, u: Array) -> None:
        """Move on by one control period under commands u (M, 2) [m/s], once they take effect.

        Commands beyond the speed limit are projected onto it. Raises ValueError, and leaves the
        state as it was, for commands of another shape or NaN, and if forces or noise would take
        the herd beyond all numbers.
        """
        from .noise import increments  # a program's help needs no Numba

        world = self.world
        u = finite('commands u', u, (world.dogs, 2))
        u, *under_way = *self._under_way, world.motion.project(u, world.max_speed)
        noise = increments(self._process, self.crowd, world.sheep, world.dt, world.substeps)
        state = self._moved(u, noise)
        if not np.isfinite(single(np.stack([state.x, state.v]))).all():
            raise ValueError('positions and velocities must be finite in single precision')
        self._count_touches(state.dogs)
        self.state = state
        self.dog_velocities, self._under_way = u, under_way
        self.periods += 1
        self._note_who_is_inside()

    def _note_who_is_inside(self) -> None:
        """Keep the control period since which the region of the field has held the flock."""
        if not field_of(self.crowd).holds(self.flock):
            self._held_since = None
        elif self._held_since is None:
            self._held_since = self.periods

    def _count_touches(self, dogs: Array) -> None:
        radius, before = self.world.bodies.radius, self.state.dogs[None]
        both = np.concatenate([before, dogs[None]])
        self.touches += touches(both, radius) - touches(before, radius)
        self.closest_dogs = min(self.closest_dogs, closest(dogs[None]))

    def _moved(self, u: Array, noise: Array) -> HerdState:
        """Return the state after a control period of dogs' velocities u under this noise."""
        state, k = self.state, 0
        while k < len(noise):
            path = self._rollout(state, u, noise[k:], k)
            free = self._steps_free_of_walls(path)
            state, k = path.at(free), k + free
            if k < len(noise):
                state, k = self._stopped_by_walls(state, path.at(free + 1)), k + 1
        return state

    def _rollout(self, state: HerdState, u: Array, noise: Array, k: int) -> Trajectory:
        """Integrate as many steps as there is noise, from the k-th of this control period on."""
        from .dynamics import rollout

        world, t = self.world, self.nanoseconds * 1e-9 + k * self.world.dt
        return rollout(self.crowd, state, u[None], world.dt, len(noise), noise, t, world.motion)

    def _steps_free_of_walls(self, path: Trajectory) -> int:
        """Return how many steps of a path come before the first that a wall stops."""
        field, steps = field_of(self.crowd), len(path.xs) - 1
        if not len(field.bars):
            return steps
        stopped = np.zeros(steps, dtype=np.bool_)
        for places, least in ((path.x, 0.0), (path.d, self.world.bodies.radius)):
            before, after = (each.reshape(-1, 2) for each in (places[:-1], places[1:]))
            stopped |= field.stopped(before, after, least).reshape(steps, -1).any(axis=1)
        return int(stopped.argmax()) if stopped.any() else steps

    def _stopped_by_walls(self, before: HerdState, after: HerdState) -> HerdState:
        """Return the state after a step, with sheep and dogs where they were that a wall stops.

        Such sheep turn back.
        """
        field, x, v, d = field_of(self.crowd), after.x.copy(), after.v.copy(), after.d.copy()
        sheep = field.stopped(before.x, x)
        if sheep.any():
            x[sheep] = before.x[sheep]
            v[sheep] = field.turned_back(x[sheep], v[sheep])
        dogs = field.stopped(before.dogs, after.dogs, self.world.bodies.radius)
        d[dogs, :2] = before.dogs[dogs]
        self.stops += int(dogs.sum())
        return HerdState(x, v, d)

    def observe(self) -> Observation:
        """Return a noisy observation: true values plus independent Gaussian noise."""
        noise, world = self._sensor.standard_normal, self.world
        x, v = self.state.x, self.state.v
        d, heading, u = world.motion.odometry(self.state.d, self.dog_velocities)
        x = single(x + world.position_noise * noise(x.shape))
        v = single(v + world.velocity_noise * noise(v.shape))
        d = d + world.position_noise * noise(d.shape)
        u = u + world.velocity_noise * noise(u.shape)
        return Observation(HerdState(x, v, world.motion.state(d, heading, u)), u)
