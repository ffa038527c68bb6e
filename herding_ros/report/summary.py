# SPDX-License-Identifier: Apache-2.0
"""A run in a few numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from herding_ros.bag.notes import Notes
from herding_ros.bag.recorded_run import Array, RecordedRun
from herding_ros.model.bodies import Body, closest, touches
from herding_ros.model.field import Field, NO_FIELD, read_field
from herding_ros.model.flock import Arrival, arrived, centre, distance, spread, without_strays
import numpy as np


def arrival(run: RecordedRun) -> tuple[Arrival, tuple[str, ...]]:
    """Return when a flock had arrived, by the sim's parameters in the bag, and notes on them.

    What the bag lacks is as usual, and all is if it holds a value that a sim would refuse.
    """
    usual, recorded, notes = Arrival(), run.parameters.get(f'{run.namespace}/sim', {}), Notes()
    given = {name: recorded[name] for name in usual.flat('arrival.') if name in recorded}
    try:
        return usual.with_values(given, 'arrival.'), notes.lines()
    except ValueError as error:
        notes.add(f'the arrival is judged by the default parameters: {error}')
        return usual, notes.lines()


def field(run: RecordedRun) -> tuple[Field, tuple[str, ...]]:
    """Return the field of a run, by the sim's parameter in the bag, and notes on it.

    The bag has its name or file only: where that is not what it was, nor is this.
    """
    name, notes = run.parameters.get(f'{run.namespace}/sim', {}).get('field'), Notes()
    try:
        return (read_field(name)[0] if name and isinstance(name, str) else NO_FIELD), ()
    except ValueError as error:
        notes.add(f'the field is not drawn, and does not count: {error}')
        return NO_FIELD, notes.lines()


def homes(run: RecordedRun) -> list[int]:
    """Return the states in which the flock had arrived, as the sim judges."""
    goal, place = run.goal, field(run)[0]
    if goal is None:
        return []
    if not place.is_judge(goal):
        at_first, when = initial_spread(run), arrival(run)[0]
        seen = [x[seen] for x, seen in zip(run.x, run.seen, strict=True)]
        return [k for k, x in enumerate(seen) if arrived(x, goal, at_first, when)]
    found, since, rounding = [], np.inf, 1e-6
    for k, t in enumerate(run.times):
        since = min(since, t) if place.holds(flock(run, k)) else np.inf
        if t - since > place.hold - rounding:
            found.append(k)
    return found


def radius_of_dogs(run: RecordedRun) -> float:
    """Return the radius of a dog [m] by the parameters of sim or controller, else the default."""
    for node in ('sim', 'controller'):
        radius = run.parameters.get(f'{run.namespace}/{node}', {}).get('bodies.radius')
        if isinstance(radius, float) and np.isfinite(radius):
            return radius
    return Body().radius


def flock(run: RecordedRun, k: int) -> Array:
    """Return the flock (n, 2) [m] in state k: the sheep that were seen, but for strays."""
    return without_strays(run.x[k, run.seen[k]], arrival(run)[0].strays)


def over_time(observable: Callable[[Array], Array], run: RecordedRun) -> Array:
    """Return an observable (T, ...) of the flock in each state."""
    strays = arrival(run)[0].strays
    if run.seen.all():
        return observable(without_strays(run.x, strays))
    seen = zip(run.x, run.seen, strict=True)
    return np.array([observable(without_strays(x[here], strays)) for x, here in seen])


def destinations(run: RecordedRun) -> Array:
    """Return the destination in force in each state (T, 2) [m], NaN if there is none."""
    none = np.full(2, np.nan)
    found = (run.goal_at(time) for time in run.times)
    return np.array([none if goal is None else goal for goal in found])


def distances(run: RecordedRun) -> Array:
    """Return the distance of the flock from the destination in force (T,) [m], NaN without."""
    return np.linalg.norm(over_time(centre, run) - destinations(run), axis=1)


def initial_spread(run: RecordedRun) -> float:
    """Return the spread of the flock [m] when first all, or most, of it was seen."""
    return float(spread(flock(run, int(np.argmax(run.seen.sum(axis=1))))))


def summarise(run: RecordedRun) -> dict[str, Any]:
    """Return the run's result as plain values for JSON; unknown values are None.

    time_s is when the flock arrived, see `homes`, else the length of the run. It is judged by
    the sheep that are seen, of which `sheep` is the largest number, and so are distance and
    spread. replans is how many were made, whether or not they are in the bag; feedbacks how many
    of those that are in it were made between two windows. closest_dogs_m is the smallest distance
    between two dogs, touches how often two came to touch. notes says what the bag lacks.
    """
    goal = run.goal
    at_first = initial_spread(run)
    when, notes = arrival(run)
    seen = [x[seen] for x, seen in zip(run.x, run.seen, strict=True)]
    home = homes(run)
    solve_ms = {
        kind: [
            replan.solve_ms
            for replan in run.replans
            if replan.kind == kind and np.isfinite(replan.solve_ms)
        ]
        for kind in ('window', 'feedback')
    }
    nearest = closest(run.d)
    seed = run.parameters.get(f'{run.namespace}/sim', {}).get('seed')
    return {
        'arrived': bool(home) if goal is not None else None,
        'time_s': round(float(run.times[home[0] if home else -1]), 9),
        'final_distance_m': float(distance(flock(run, -1), goal)) if goal is not None else None,
        'max_spread_m': float(over_time(spread, run).max()),
        'initial_spread_m': at_first,
        'replans': run.replans_made,
        'feedbacks': sum(replan.kind == 'feedback' for replan in run.replans),
        'solve_ms_median': _median(solve_ms['window']),
        'solve_ms_max': max(solve_ms['window'], default=None),
        'feedback_ms_median': _median(solve_ms['feedback']),
        'messages_recorded': sum(topic.count for topic in run.topics),
        'messages_lost': run.messages_lost,
        'largest_gap_s': run.largest_gap_s,
        'wall_s': run.wall_s,
        'real_time_factor': float(run.times[-1]) / run.wall_s if run.wall_s > 0.0 else None,
        'seed': seed if isinstance(seed, int) else None,
        'sheep': max(map(len, seen)),
        'dogs': run.d.shape[1],
        'closest_dogs_m': nearest if np.isfinite(nearest) else None,
        'touches': touches(run.d, radius_of_dogs(run)),
        'goal': goal.tolist() if goal is not None else None,
        **when.flat('arrival.'),
        'namespace': run.namespace or '/',
        'version': run.version,
        'notes': [*run.notes, *notes, *field(run)[1]],
    }


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None
