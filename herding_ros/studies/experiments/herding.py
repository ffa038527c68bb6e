"""A whole run: a flock is herded, by whatever policy, and the run is put into numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math
import time
from typing import Any

import numpy as np

from herding_ros.control.parameters import Control
from herding_ros.control.receding_horizon import RecedingHorizon, SolveReport
from herding_ros.model.flock import centre, distance, spread
from herding_ros.model.parameters import Crowd, Morse
from herding_ros.model.simulation import Simulation, World
from herding_ros.model.state import Array, HerdState

from .settings import changed
from .strombom import Strombom

Policy = Callable[[HerdState, float], Array]
"""What decides: from the observed state and the time [s] to the dogs' velocities (M, 2) [m/s]."""


@dataclass(frozen=True)
class Track:
    """What happened in T control periods, as it truly was.

    t: (T+1,) [s]; x: (T+1, N, 2) [m]; d: (T+1, M, 2) [m]; u: (T, M, 2) [m/s]; home: index of
    the first instant at which the flock had arrived, or None; cpu: what the policy took [s].
    """

    t: Array
    x: Array
    d: Array
    u: Array
    home: int | None
    cpu: float


class Planner:
    """The controller of this package as a policy; keeps its reports."""

    def __init__(self, crowd: Crowd, control: Control, goal: Array, seed: int) -> None:
        """Plan for this crowd and goal (2,) [m]."""
        self._planner = RecedingHorizon(crowd, control, goal, seed)
        self.reports: list[SolveReport] = []

    def __call__(self, observed: HerdState, t: float) -> Array:
        """Return the velocities at t, after a new plan if one is due."""
        if self._planner.due(t):
            self.reports.append(self._planner.solve(observed, t).report)
        assert self._planner.plan is not None
        return self._planner.plan.at(t)


def play(simulation: Simulation, policy: Policy, time_limit: float, stop: bool) -> Track:
    """Herd for time_limit [s], with stop only until the flock arrives.

    With the planner as policy this is `control.closed_loop`, bit for bit; other policies see
    the same observations of the same flock under the same noise.
    """
    world, cpu = simulation.world, 0.0
    t, x, d, u = [0.0], [simulation.state.x], [simulation.state.d], []
    home = 0 if simulation.arrived else None
    while not (stop and home is not None) and t[-1] < time_limit - 0.5 * world.control_period:
        observed = simulation.observe().state
        # Time of this process on all its cores: what others do on the machine does not count.
        started = time.process_time()
        command = policy(observed, t[-1])
        cpu += time.process_time() - started
        simulation.advance(command)
        t.append(simulation.nanoseconds * 1e-9)
        x.append(simulation.state.x)
        d.append(simulation.state.d)
        u.append(simulation.dog_velocities)
        if home is None and simulation.arrived:
            home = len(u)
    velocities = np.array(u).reshape(-1, world.dogs, 2)
    return Track(np.array(t), np.array(x), np.array(d), velocities, home, cpu)


def run(
    policy: str,
    sheep: int,
    dogs: int,
    sigma: float,
    goal: list[float],
    seed: int,
    time_limit: float,
    stop: bool,
    every: float,
    settings: dict[str, Any],
    snapshots: list[float] | None = None,
) -> dict[str, Any]:
    """Herd a flock by a policy and return the run in numbers.

    policy: 'planner' (settings: what differs from Control()), 'strombom' (settings: those of
    Strombom) or 'none', a dog that no sheep notices. every: spacing of the stored paths [s];
    snapshots: instants at which everybody's place is kept [s].
    """
    crowd, destination = Crowd(noise=sigma), np.array(goal)
    world = World(sheep=sheep, dogs=dogs, seed=seed)
    decide: Policy
    if policy == 'planner':
        decide = Planner(crowd, changed(Control(), settings), destination, seed)
    elif policy == 'strombom':
        decide = Strombom(destination, np.random.default_rng([seed, 30_000]), **settings)
    elif policy == 'none':
        crowd = replace(crowd, dog=Morse(0.0, 1.0, 0.0, 1.0))
        decide = _stand
    else:
        raise ValueError(f'policy is {policy!r}, allowed is planner, strombom or none')
    track = play(Simulation(crowd, world, destination), decide, time_limit, stop)
    result = measures(track, destination, world.control_period)
    if isinstance(decide, Planner):
        result['plans'] = plans(decide.reports)
    result['paths'] = paths(track, destination, max(round(every / world.control_period), 1))
    result['snapshots'] = [
        {'t': t, 'x': rounded(track.x[k]), 'd': rounded(track.d[k])}
        for t in snapshots or []
        for k in [round(t / world.control_period)]
        if k < len(track.t)
    ]
    return result


def _stand(observed: HerdState, t: float) -> Array:
    return np.zeros_like(observed.d)


def measures(track: Track, goal: Array, period: float) -> dict[str, Any]:
    """Return what one wants to know of a run. Lengths in m, times in s, energy in m^2/s.

    dogs_run: way of all dogs; energy: int sum |u_m|^2 dt; from_home: what held from the
    arrival to the end, where the run went on.
    """
    spreads, away = spread(track.x), distance(track.x, goal)
    speed = np.linalg.norm(track.u, axis=-1)
    home = track.home
    return {
        'arrived': home is not None,
        'time': None if home is None else round(float(track.t[home]), 9),
        'duration': round(float(track.t[-1]), 9),
        'initial_spread': float(spreads[0]),
        'max_spread': float(spreads.max()),
        'closest': float(away.min()),
        'final_distance': float(away[-1]),
        'dogs_run': float(period * speed.sum()),
        'energy': float(period * np.square(speed).sum()),
        'policy_cpu': track.cpu,
        'from_home': None if home is None else held(track, spreads, away, home, period),
    }


def held(
    track: Track, spreads: Array, away: Array, home: int, period: float
) -> dict[str, Any] | None:
    """Return what held from the instant number `home` on; None if nothing came after it.

    turning: mean angular velocity of each dog about the centre, anticlockwise [rad/s];
    turning_speed: mean of its magnitude over dogs and time.
    """
    if home + 1 >= len(track.t):
        return None
    arm = track.d[home:] - centre(track.x[home:])[:, None]
    angle = np.unwrap(np.arctan2(arm[..., 1], arm[..., 0]), axis=0)
    rate = np.diff(angle, axis=0) / period
    return {
        'max_distance': float(away[home:].max()),
        'mean_distance': float(away[home:].mean()),
        'max_spread': float(spreads[home:].max()),
        'mean_spread': float(spreads[home:].mean()),
        'turning': [float(value) for value in rate.mean(axis=0)],
        'turning_speed': float(np.abs(rate).mean()),
        'dog_distance': float(np.linalg.norm(arm, axis=-1).mean()),
    }


def plans(reports: list[SolveReport]) -> dict[str, Any]:
    """Return how the plans of a run were found, in total or on average."""
    corrected = [each for each in reports if each.mapping_iterations]
    before = sum(each.mapping_error_before**2 for each in corrected)
    after = sum(each.mapping_error_after**2 for each in corrected)
    return {
        'count': len(reports),
        'corrected': len(corrected),
        'iterations': sum(each.mapping_iterations for each in reports),
        'error_ratio': math.sqrt(after / before) if before else None,
        'wall': sum(each.seconds['total'] for each in reports),
    }


def paths(track: Track, goal: Array, every: int) -> dict[str, Any]:
    """Return the run at every so many-th instant, and at the last, rounded, for pictures."""
    index = sorted({*range(0, len(track.t), every), len(track.t) - 1})
    x = track.x[index]
    return {
        't': [round(float(t), 3) for t in track.t[index]],
        'centre': rounded(centre(x)),
        'dogs': rounded(track.d[index]),
        'distance': rounded(distance(x, goal)),
        'spread': rounded(spread(x)),
        'first': rounded(track.x[0]),
        'last': rounded(track.x[-1]),
    }


def rounded(values: Array) -> list[Any]:
    """Return an array as lists, to a tenth of a millimetre."""
    return list(np.round(values, 4).tolist())
