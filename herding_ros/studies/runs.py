"""What the studies of whole runs have in common: their tasks, and how a run is judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Any

from herding_ros.control.parameters import Control, PAPER
from herding_ros.model.flock import ARRIVAL_DISTANCE

from .experiments.settings import differences
from .statistics import Fraction, Mean, Median, significant
from .study import Results
from .task import Task

PLAIN: dict[str, Any] = {'mapping': {'estimator': 'plain', 'standard_error': 0.0}}
"""Settings of a mapping that sees the mean of plain paths, as the paper's does."""

SETTINGS: dict[str, dict[str, Any]] = {
    'default': {},
    'paper': differences(PAPER, Control()),
}
"""Settings of the controller by name, as what differs from its defaults."""

MAX_SPREAD = 0.6
"""A flock whose spread was larger on the way was not herded but chased [m]."""


def with_mapping(settings: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """Return settings with other parameters of the mapping."""
    return {**settings, 'mapping': {**settings.get('mapping', {}), **changes}}


def paths_of(settings: dict[str, Any], paths: int) -> dict[str, Any]:
    """Return settings with so many Monte Carlo paths."""
    same = paths == Control().mapping.paths
    return settings if same else with_mapping(settings, paths=paths)


def under(settings: dict[str, Any], runs: Results) -> Results:
    """Return the runs under these settings, with any number of Monte Carlo paths."""

    def same(task: Task) -> bool:
        given = task.parameters['settings']
        paths = given.get('mapping', {}).get('paths', Control().mapping.paths)
        return bool(given == paths_of(settings, paths))

    return runs.where(same)


def run_task(
    policy: str,
    settings: dict[str, Any],
    dogs: int,
    sigma: float,
    goal: Sequence[float],
    seed: int,
    time_limit: float,
    cost: float,
    sheep: int = 20,
    stop: bool = True,
    every: float = 1.0,
    snapshots: Sequence[float] | None = None,
    crowd: str = 'cohesive',
) -> Task:
    """Return the task of one run."""
    parameters = {
        'policy': policy,
        'settings': settings,
        'sheep': sheep,
        'dogs': dogs,
        'sigma': sigma,
        'goal': goal,
        'seed': seed,
        'time_limit': time_limit,
        'stop': stop,
        'every': every,
        'snapshots': snapshots,
        'crowd': crowd,
    }
    return Task('herding', parameters, cost)


def safe(run: dict[str, Any]) -> bool:
    """Whether the flock arrived and was never scattered on the way."""
    return bool(run['arrived'] and run['max_spread'] <= MAX_SPREAD)


def success(runs: Results) -> Fraction:
    """Return the fraction of safe arrivals."""
    return Fraction.of([safe(run) for run in runs])


def times(runs: Results) -> list[float]:
    """Return the times of arrival [s], infinite for what did not arrive safely."""
    return [float(run['time']) if safe(run) else math.inf for run in runs]


def median_time(runs: Results) -> Median:
    """Return the median time of arrival over all runs, those that failed included."""
    return Median.of(times(runs))


def summary(runs: Results) -> list[str]:
    """Return what tables of runs say of them; see SUMMARY for the heads."""
    arrived = [time for time in times(runs) if math.isfinite(time)]
    arrived.sort()
    return [
        str(success(runs)),
        str(median_time(runs)),
        f'{significant(arrived[0])} to {significant(arrived[-1])}' if arrived else '–',
        str(Mean.of(runs.values('max_spread'))),
        significant(max(runs.values('max_spread'), default=math.nan)),
        str(Mean.of([run['dogs_run'] / len(run['paths']['dogs'][0]) for run in runs])),
        str(Mean.of(runs.values('energy'))),
    ]


SUMMARY = (
    'safe arrivals', 'median time [s]', 'times of these, range [s]', 'largest spread, mean [m]',
    'largest of all [m]', 'way of a dog [m]', 'energy ∫ Σ\\|u\\|² dt [m²/s]',
)  # fmt: skip


def failures(runs: Results) -> list[tuple[str, ...]]:
    """Return a row on each run that was no safe arrival, and why."""
    rows = []
    for task, run in runs.entries:
        if safe(run):
            continue
        given = task.parameters
        if run['arrived']:
            why = f'arrived after {run["time"]:g} s, but spread up to {run["max_spread"]:.2f} m'
        elif run['closest'] < ARRIVAL_DISTANCE:
            why = 'the centre was there, but not with the flock together'
        else:
            why = 'the centre never got there'
        rows.append(
            (
                str(given['dogs']), '({:g}, {:g})'.format(*given['goal']), str(given['seed']), why,
                f'{run["closest"]:.3f}', f'{run["final_distance"]:.3f}',
                f'{run["max_spread"]:.2f}',
            )
        )  # fmt: skip
    return sorted(rows)


FAILURES = (
    'dogs', 'goal', 'seed', 'what happened', 'closest [m]', 'distance at the end [m]',
    'largest spread [m]',
)  # fmt: skip


def tolerant(settings: dict[str, Any], tolerance: float) -> dict[str, Any]:
    """Return settings with another tolerance of aggressive mapping, eps_SM."""
    mapping = replace(PAPER.mapping, tolerance=tolerance)
    return with_mapping(settings, **differences(mapping, Control().mapping))
