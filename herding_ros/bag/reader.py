# SPDX-License-Identifier: Apache-2.0
"""Reading a recorded run back, without rclpy: `read_run(bag)`.

It reads our bags and those of a stock `ros2 bag record`, mcap or sqlite3. What is missing or
wrong in a bag is left out, and noted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
import json
import math
import os
from pathlib import Path
import re
from typing import Any, NamedTuple

from herding_ros.checks import check_frame, check_goal, Refused
from herding_ros.markers import NOTHING, Surroundings
import numpy as np

from .conversion import Flock, Planned, read_message
from .inspection import inspect
from .metadata import advice, file_names, read_metadata, string_map
from .notes import counted, Notes, printable
from .recorded_run import Array, RecordedRun, Replan, Route
from .run_topics import ROOT_GOAL, RunTopics
from .stored import STORAGES, Stored, stored_messages, stored_topics
from .timeline import APART, in_order, restarts, Sample, since

PLAN_STATUS = 'controller: plan'
"""Name of the diagnostic status of a replan."""

_MOST_CELLS = 10_000_000
"""States times sheep that are read even if a sheep is seen in few states."""

_Series = dict[str, list[Sample]]
"""The messages of each topic."""


def read_run(
    path: str | os.PathLike[str], namespace: str | None = None, observed: bool = False
) -> RecordedRun:
    """Read the bag in the folder `path`.

    The states are the true ones where they were recorded, else the observed; `observed`: always
    these. When the sim was reset, it is the last run that is read. `namespace` is that of sim and
    controller; it is needed where the bag has sheep in several. Raises FileNotFoundError when
    there is no complete bag, ValueError when it is damaged, has no sheep, or has them in several
    namespaces.
    """
    folder = Path(path)
    metadata = read_metadata(folder)
    files = _checked_files(folder, metadata)
    storage = metadata['storage_identifier']
    custom_data = string_map(metadata.get('custom_data'))
    notes = Notes()
    parameters = _parameters(custom_data.get('parameters', '{}'), notes)
    try:
        topics = stored_topics(files, storage)
        names = RunTopics.choose(topics, namespace, notes, observed)
        series = _series(stored_messages(files, storage, names.types), names, notes)
    except ValueError as error:
        raise ValueError(f'the bag {folder} cannot be read: {printable(str(error))}') from error

    if not series[names.sheep]:
        raise ValueError(
            f'the bag {folder} has no sheep that can be read: {"; ".join(notes.lines())}'
        )
    frame, _ = Counter(sample.frame for sample in series[names.sheep]).most_common(1)[0]
    for topic in (names.sheep, *names.dogs.values(), names.plan, names.path, names.drawing):
        series[topic] = _in_frame(series[topic], topic, frame, notes)
    plans = _plans([each for topic in names.diagnostics for each in series.pop(topic)], names)
    parameter = parameters.get(f'{names.namespace}/controller', {}).get('goal')
    goal = _goal(series, plans, names, parameter, frame, notes)
    series = _in_order(_last_run({**series, PLAN_STATUS: plans}, names, notes), notes)

    states = series[names.sheep]
    start = states[0].ns
    times = _seconds(states, start)
    x, v = _herd([sample.value for sample in states], names.sheep, notes)
    dogs = [m for m, topic in names.dogs.items() if series[topic]]
    command_times, commands = _commands([series[names.commands[m]] for m in dogs], start)
    plans = series[PLAN_STATUS]
    published = [sample.publish_ns for sample in states]
    return RecordedRun(
        times=times,
        x=x,
        v=v,
        d=_tracks({m: series[names.dogs[m]] for m in dogs}, start, times, notes),
        dogs=tuple(dogs),
        command_times=command_times,
        commands=commands,
        goal=goal,
        replans=tuple(
            _replan((sample.ns - start) * 1e-9, sample.value)
            for sample in plans
            if sample.value.made  # a status may be published more than once
        ),
        replans_made=sum(sample.value.made for sample in plans),
        namespace=names.namespace,
        parameters=parameters,
        version=custom_data.get('herding_ros_version', ''),
        wall_s=(max(published) - min(published)) * 1e-9,
        topics=topics,
        notes=notes.lines(),
        messages_lost=_count(custom_data.get('messages_lost', '')),
        plans=_routes(series[names.plan], [f'dog_{m}' for m in dogs], start),
        expected=tuple(
            Route(route.times, route.points[:, 0])
            for route in _routes(series[names.path], [''], start)
        ),
        goals=_goals(series, names, frame, start),
        surroundings=_surroundings(series[names.drawing], start),
    )


def _count(text: str) -> int | None:
    return int(text) if re.fullmatch('[0-9]{1,18}', text) else None


def _checked_files(folder: Path, metadata: Mapping[str, Any]) -> list[Path]:
    """Return the data files. Raises ValueError unless all are whole and can be read."""
    mode = str(metadata.get('compression_mode') or 'none').lower()
    if mode != 'none':
        raise ValueError(
            f'the bag {folder} is compressed by rosbag2, mode {mode}: write it anew without by '
            '`ros2 bag convert`; compression by mcap can be read'
        )
    storage = metadata.get('storage_identifier')
    if storage not in STORAGES:
        raise ValueError(
            f'the storage of the bag {folder} must be {" or ".join(STORAGES)}, got {storage!r}'
        )
    files = [folder / name for name in file_names(metadata)]
    for file in files:
        if file.is_symlink() or not file.is_file():
            raise ValueError(f'the bag {folder} is damaged: {file.name} is missing or not a file')
        faults = inspect(file).faults if storage == 'mcap' else []
        if faults:
            raise ValueError(
                f'the bag {folder} is damaged: {file.name}, {faults[0]}; {advice(folder)}'
            )
    return files


def _parameters(text: str, notes: Notes) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node in a bag's custom data."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        notes.add('the parameters in the metadata cannot be read')
        return {}
    return {name: values for name, values in found.items() if isinstance(values, dict)}


# From messages to series.


def _series(messages: Iterable[Stored], names: RunTopics, notes: Notes) -> _Series:
    """Read messages, in the order in which they were written."""
    series: _Series = {topic: [] for topic in names.types}
    for place, stored in enumerate(messages):
        try:
            content = read_message(stored, *names.types[stored.topic])
        except Refused as error:
            notes.leave_out(stored.topic, error)
            continue
        ns = stored.log_ns if content.ns is None else content.ns
        times = stored.log_ns, stored.publish_ns
        sample = Sample(place, ns, content.value, content.ns is not None, content.frame, *times)
        series[stored.topic].append(sample)
    return series


def _in_frame(samples: list[Sample], topic: str, frame: str, notes: Notes) -> list[Sample]:
    """Return those that are in a frame."""
    kept = []
    for sample in samples:
        try:
            check_frame('it', sample.frame, frame)
            kept.append(sample)
        except Refused as error:
            notes.leave_out(topic, error)
    return kept


def _last_run(series: _Series, names: RunTopics, notes: Notes) -> _Series:
    """Return what came after time was last set back; all messages get stamps."""
    states = series[names.sheep]
    found = restarts(states, [series[topic] for topic in names.dogs.values()])
    if found:
        notes.add(
            f'time was set back {counted(len(found), "time")} in all topics, as by a reset: only '
            'the run after that is read'
        )
    first = found[-1].first if found else states[0]
    dated = {
        topic: [
            each if each.is_stamped else each._replace(ns=first.ns + each.log_ns - first.log_ns)
            for each in samples
        ]
        for topic, samples in series.items()
    }
    if not found:
        return dated
    return {topic: since(samples, found[-1]) for topic, samples in dated.items()}


def _in_order(series: _Series, notes: Notes) -> _Series:
    """Return the messages of each topic in the order of their stamps."""
    ordered = {}
    for topic, samples in series.items():
        ordered[topic], late, astray = in_order(samples)
        if late:
            notes.add(f'put in order, by stamp, {counted(late, "message")} of {topic}')
        for _ in astray:
            notes.leave_out(
                topic,
                Refused(
                    'stamp astray',
                    f'a stamp must be within {APART * 1e-9:g} s of those before and after it',
                ),
            )
    return ordered


class _Plan(NamedTuple):
    """Number and values of a replan, and how many replans were made since the status before."""

    number: int
    made: int
    values: dict[str, str]


def _plans(diagnostics: Iterable[Sample], names: RunTopics) -> list[Sample]:
    """Return the statuses of replans; a controller counts them from 0 on."""
    status_names = {PLAN_STATUS, f'{names.namespace}/{PLAN_STATUS}'.lstrip('/')}
    plans: list[Sample] = []
    last = -1
    for sample in diagnostics:
        for name, values in sample.value:
            if name.lstrip('/') in status_names:
                value = _number(values, 'replan')
                number = int(value) if 0 <= value < math.inf else last + 1
                made = number - last if number >= last else number + 1
                plans.append(sample._replace(value=_Plan(number, made, values)))
                last = number
    return plans


def _number(values: Mapping[str, str], key: str) -> float:
    """Return the value of a status, NaN if it is not a number."""
    try:
        return float(values[key])
    except (KeyError, ValueError):
        return math.nan


def _goal(
    series: _Series,
    plans: Sequence[Sample],
    names: RunTopics,
    parameter: object,
    frame: str,
    notes: Notes,
) -> Array | None:
    """Return the last destination (2,) [m].

    It is the one that the controller said was in force. A bag without that has what was asked for
    and not refused, by the nodes' rule, or the parameter, or the goal of the last plan.
    """
    for topic in names.goals:
        good = _good_goals(series[topic], topic, frame, notes)
        if good:
            return good[-1]
    candidates = [parameter] if parameter is not None else []
    of_plans = [sample.value.values for sample in reversed(plans)]
    candidates += [[_number(values, 'goal_x'), _number(values, 'goal_y')] for values in of_plans]
    for candidate in candidates:
        try:
            goal = np.array(candidate, np.float64)
        except (TypeError, ValueError):
            continue
        if goal.shape == (2,) and np.isfinite(goal).all():
            return goal
    if names.namespace and (good := _good_goals(series[ROOT_GOAL], ROOT_GOAL, frame, notes)):
        notes.add(f'the destination is that of {ROOT_GOAL}: {names.namespace} has none of its own')
        return good[-1]
    notes.add(
        'there is no destination, so it is not known whether the flock arrived: no message on '
        f'{" or ".join(names.goals)}, no parameter goal of {names.namespace}/controller, and no '
        f'status "{PLAN_STATUS}" with goal_x and goal_y'
    )
    return None


def _goals(
    series: _Series, names: RunTopics, frame: str, start: int
) -> tuple[tuple[float, Array], ...]:
    """Return the destinations (2,) [m] that were in force, and from when on [s]."""
    in_force = series[names.goals[0]]
    return tuple(
        ((sample.ns - start) * 1e-9, goal)
        for sample in in_force
        for goal in _good_goals([sample], names.goals[0], frame, Notes())
    )


def _good_goals(samples: Iterable[Sample], topic: str, frame: str, notes: Notes) -> list[Array]:
    good = []
    for sample in samples:
        try:
            x, y = sample.value
            check_goal(sample.frame, x, y, frame)
            good.append(np.array([x, y]))
        except Refused as error:
            notes.leave_out(topic, error)
    return good


# From series to arrays.


def _herd(flocks: Sequence[Flock], topic: str, notes: Notes) -> tuple[Array, Array]:
    """Return positions and velocities (T, N, 2) of all sheep, NaN where one was not seen."""
    if unseen := sum(flock.unseen for flock in flocks):
        notes.add(
            f'{counted(unseen, "position")} in {topic} not finite: those sheep are not seen there'
        )
    if not all(flock.has_ids for flock in flocks):
        notes.add(
            f'{topic} has no field id of an integer type: sheep are told apart by their order'
        )
    sizes = [len(flock.ids) for flock in flocks]
    ids = [flock.ids for flock in flocks]
    everyone = np.unique(np.concatenate(ids))
    if len(flocks) * len(everyone) > max(_MOST_CELLS, 4 * sum(sizes)):
        notes.add(
            f'the ids in {topic} are not those of sheep, which are told apart by their order'
        )
        ids = [np.arange(size) for size in sizes]
        everyone = np.arange(max(sizes))
    if len(flocks) * len(everyone) > max(_MOST_CELLS, 4 * sum(sizes)):
        raise ValueError(
            f'the sheep in {topic} are from {min(sizes)} to {max(sizes)}: not a flock'
        )
    if min(sizes) < len(everyone):
        notes.add(
            f'not all sheep are seen all the time: {topic} has {min(sizes)} to {max(sizes)} of '
            f'{len(everyone)}, {sizes[-1]} at the end'
        )
    x, v = np.full((2, len(flocks), len(everyone), 2), np.nan)
    for k, flock in enumerate(flocks):
        at = np.searchsorted(everyone, ids[k])
        x[k, at], v[k, at] = flock.x, flock.v
    if not np.isfinite(v).any():
        notes.add(f'{topic} has no velocities')
    return x, v


def _tracks(
    of_dogs: Mapping[int, Sequence[Sample]], start: int, times: Array, notes: Notes
) -> Array:
    """Return the positions (T, M, 2) [m] of dogs, interpolated at times (T,) [s].

    They are NaN where a dog has been silent for long: for two of its usual periods and `APART`.
    """
    tracks = np.empty((len(times), len(of_dogs), 2))
    for m, (number, samples) in enumerate(of_dogs.items()):
        seconds = _seconds(samples, start)
        for i in range(2):
            tracks[:, m, i] = np.interp(times, seconds, [sample.value[i] for sample in samples])
        after = np.searchsorted(seconds, times)
        around = seconds[np.clip([after - 1, after], 0, len(seconds) - 1)]
        usual = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
        silent = np.abs(around - times).min(axis=0) > max(APART * 1e-9, 2.0 * usual)
        tracks[silent, m] = np.nan
        if silent.any():
            notes.add(
                f'dog {number} is silent, and not drawn, in {silent.sum()} of '
                f'{counted(len(times), "state")}, from {times[silent][0]:.1f} s on'
            )
    return tracks


def _commands(of_dogs: Sequence[Sequence[Sample]], start: int) -> tuple[Array, Array]:
    """Return all times (K,) [s] of commands, and each dog's last (K, M, 2) [m/s] at them."""
    seconds = [_seconds(samples, start) for samples in of_dogs]
    times = np.unique(np.concatenate([*seconds, np.empty(0)]))
    commands = np.zeros((len(times), len(of_dogs), 2))
    for m, samples in enumerate(of_dogs):
        sent = np.array([(0.0, 0.0), *(sample.value for sample in samples)])
        commands[:, m] = sent[np.searchsorted(seconds[m], times, side='right')]
    return times, commands


def _routes(samples: Sequence[Sample], names: Sequence[str], start: int) -> tuple[Route, ...]:
    """Return what was planned for these names (K, M, 2), NaN for one that a plan leaves out."""
    routes = []
    for sample in samples:
        planned: Planned = sample.value
        points = np.full((len(planned.times), len(names), 2), np.nan)
        for m, name in enumerate(names):
            if name in planned.names:
                points[:, m] = planned.points[:, planned.names.index(name)]
        routes.append(Route((planned.times - start).astype(np.float64) * 1e-9, points))
    return tuple(routes)


def _surroundings(samples: Sequence[Sample], start: int) -> tuple[tuple[float, Surroundings], ...]:
    """Return what a controller knew, and from when on [s]; each differs from the one before."""
    found: list[tuple[float, Surroundings]] = []
    last = NOTHING
    for sample in samples:
        if not all(map(np.array_equal, sample.value, last)):
            found.append(((sample.ns - start) * 1e-9, sample.value))
        last = sample.value
    return tuple(found)


def _seconds(samples: Sequence[Sample], start: int) -> Array:
    return np.array([sample.ns - start for sample in samples], np.float64) * 1e-9


def _replan(time: float, plan: _Plan) -> Replan:
    """Return what the controller said of a replan; a number's name is that of its field."""
    names = {field.name for field in fields(Replan)} - {'time', 'number', 'status', 'kind'}
    numbers = {name: _number(plan.values, name) for name in names}
    kind = plan.values.get('kind', 'window')
    return Replan(time, plan.number, plan.values.get('status', ''), **numbers, kind=kind)
