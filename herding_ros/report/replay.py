# SPDX-License-Identifier: Apache-2.0
"""A run as one file that any browser plays, without a network: replay.html."""

from __future__ import annotations

from base64 import b64encode
import json
import math
import os
from pathlib import Path
from typing import Any

from herding_ros.bag.recorded_run import Array, in_play, RecordedRun
from herding_ros.markers import NOTHING
from herding_ros.model.field import Field
from herding_ros.model.flock import centre
import numpy as np

from .curves import curves
from .summary import field, over_time
from .walls import further, outlines, region

_PAGE = Path(__file__).with_name('replay.html')
_SLOT = '<script type="application/json" id="run">{}</script>'

_MOST_SHEEP = 1000
"""More sheep than this are a sample of them."""

_MOST_STATES = 1000

_MOST_PLACES = 250_000
"""Places of all sheep together: 1 MB, and a third more as text. A long run has fewer states."""

_MOST_PLANNED = 60_000
"""Places of all plans together."""

_MOST_PIECES = 5000
"""Straight pieces of walls that change, all times together."""

_POINTS = 25
"""Points of a plan."""

_UNKNOWN = -32768
"""For a place that is not known; the others are integers from 0 to `_LARGEST`."""
_LARGEST = 32767


def save_replay(run: RecordedRun, path: str | os.PathLike[str]) -> None:
    """Write the page of a run. It has at most about 2 MB, for which it may leave out states."""
    page = _PAGE.read_text(encoding='utf-8')
    data = json.dumps(packed(run), allow_nan=False).replace('<', '\\u003c')
    filled = page.replace(_SLOT, _SLOT.replace('{}', data))
    Path(path).write_text(filled, encoding='utf-8')


def packed(run: RecordedRun) -> dict[str, Any]:
    """Return what the page plays, as plain values for JSON.

    Places are int16 in units of `unit` [m] from `origin` (2,) [m], times and curves float32,
    both as base64; what they mean is said where the page reads them.
    """
    herd = _evenly(run.x.shape[1], _MOST_SHEEP)
    states = _evenly(len(run.times), min(_MOST_STATES, _MOST_PLACES // len(herd)))
    x, d = run.x[states][:, herd], run.d[states]
    middle = over_time(centre, run)[states]
    starts, ends, planned = _plans(run)
    goals = [[since, *goal] for since, goal in run.goals] or (
        [] if run.goal is None else [[0.0, *run.goal]]
    )
    place = field(run)[0]
    walls = [line.tolist() for line in outlines(place)]
    corners = [np.reshape(each, (-1, 2)) for each in (x, d, planned, *walls)]
    box = _box(np.concatenate([*corners, np.array(goals).reshape(-1, 3)[:, 1:]]))
    origin, unit = box[0], float(np.ptp(box, axis=0).max()) / _LARGEST

    def places(values: Array) -> str:
        return _places(values, origin, unit)

    return {
        'title': _title(run),
        'times': _floats(run.times[states]),
        'origin': origin.tolist(),
        'unit': unit,
        'box': box.tolist(),
        'walls': walls,
        'further': _further(run, place),
        'region': region(place).tolist(),
        'sheep': len(herd),
        'dogs': list(run.dogs),
        'x': places(x),
        'd': places(d),
        'centre': places(middle),
        'goals': [[float(each) for each in goal] for goal in goals],
        'plans': {
            'length': _POINTS,
            'starts': _floats(starts),
            'ends': _floats(ends),
            'points': places(planned),
        },
        'curves': _curves(run, states),
    }


def _title(run: RecordedRun) -> str:
    return f'{run.x.shape[1]} sheep, {run.d.shape[1]} dogs'


def _evenly(count: int, most: int) -> np.ndarray:
    """Return at most so many of the first `count` indices, the first and the last included."""
    kept = min(count, max(most, 1))
    return np.linspace(0, count - 1, kept).round().astype(int)


def _plans(run: RecordedRun) -> tuple[Array, Array, Array]:
    """Return when plans begin and end (P,) [s], and their points (P, K, M + 1, 2) [m].

    Each has the same number of points, at equal distances in time; the last of each is the centre.
    """
    routes = sorted(run.plans, key=lambda route: route.times[0])  # of two, the later counts
    members = run.d.shape[1] + 1
    kept = _evenly(len(routes), _MOST_PLANNED // (_POINTS * members))
    routes = [routes[k] for k in kept]
    points = np.full((len(routes), _POINTS, members, 2), np.nan)
    ends = np.array([route.times[-1] for route in routes])
    starts = np.array([route.times[0] for route in routes])
    for p, route in enumerate(routes):
        expected = in_play(run.expected, starts[p])
        for m in range(members):
            leads = expected if m == members - 1 else route
            if leads is None:
                continue
            line = leads.points if leads is expected else route.points[:, m]
            times = np.linspace(starts[p], ends[p], _POINTS)
            for i in range(2):
                points[p, :, m, i] = np.interp(times, leads.times, line[:, i], right=np.nan)
    return starts, ends, points


def _further(run: RecordedRun, place: Field) -> list[list[Any]]:
    """Return walls (n, 2, 2) [m] that the controller met in the field, since when [s] each."""
    found: list[list[Any]] = []
    known: Array = NOTHING.walls
    for since, around in run.surroundings:
        if np.array_equal(around.walls, known):  # it is the route that is new
            continue
        known = around.walls
        walls = np.round(further(place, around.walls), 4).tolist()
        if walls != (found[-1][1] if found else []):
            found.append([since, walls])
    most = sum(len(walls) for _, walls in found) / _MOST_PIECES
    return found[:: max(math.ceil(most), 1)]


def _curves(run: RecordedRun, states: np.ndarray) -> list[dict[str, Any]]:
    """Return what happened over time, in some of the states."""
    kept = ((each, states if each.of_states else slice(None)) for each in curves(run))
    return [
        {
            'label': curve.label,
            't': _floats(curve.times[which]),
            'v': _floats(curve.values[which]),
            'limit': curve.limit,
            'dots': not curve.of_states,
        }
        for curve, which in kept
    ]


def _box(places: Array) -> Array:
    """Return the lower left and the upper right corner (2, 2) [m] around places (n, 2)."""
    seen = places[np.isfinite(places).all(axis=1)]
    box = np.array([seen.min(axis=0), seen.max(axis=0)])
    return box if np.ptp(box, axis=0).any() else box + np.array([[-0.5], [0.5]])


def _places(values: Array, origin: Array, unit: float) -> str:
    with np.errstate(invalid='ignore'):
        scaled = np.rint((values - origin) / unit)
    return _text(np.where(np.isfinite(scaled), scaled, _UNKNOWN).astype('<i2'))


def _floats(values: Array) -> str:
    return _text(np.asarray(values).astype('<f4'))


def _text(values: np.ndarray) -> str:
    return b64encode(np.ascontiguousarray(values).tobytes()).decode()
