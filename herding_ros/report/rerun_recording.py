# SPDX-License-Identifier: Apache-2.0
"""A run as a recording for Rerun (https://rerun.io), a viewer of what robots see and plan."""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
from typing import Any, TypeAlias

from herding_ros.bag.recorded_run import Array, RecordedRun
from herding_ros.model.flock import centre
import numpy as np

from .curves import curves, RunCurve
from .summary import field, over_time
from .walls import outlines, region

TIMELINE = 'time'
"""Time since the first state, for all that changes."""

Colour: TypeAlias = 'tuple[int, int, int]'

_BLUE, _RED, _BLACK, _GREY = (33, 102, 172), (194, 41, 43), (0, 0, 0), (120, 120, 120)

_PALE = 0.65
"""How much white is in the colour of where somebody went."""

_THIN, _THICK = 0.75, 1.5
"""Half the width of lines, in points of the screen."""

_HEADING = 0.05
"""Length of a dog's heading, as a part of the whole picture."""


def save_rerun(run: RecordedRun, path: str | os.PathLike[str], name: str = 'herd') -> None:
    """Save a run as Rerun's .rrd: the herd in space, its curves, and an arrangement of both.

    name: under which a viewer lists it. Raises ValueError for another ending, and without
    rerun-sdk; OSError when the file cannot be written.
    """
    file = Path(path)
    if file.suffix != '.rrd':
        raise ValueError(f'a recording for Rerun must end in .rrd, got {file.name}')
    try:
        import rerun
    except ModuleNotFoundError as error:
        raise ValueError(
            'a recording for Rerun needs rerun-sdk, which is not installed: '
            "pip install 'rerun-sdk>=0.41', with Python 3.11 or later"
        ) from error
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()  # Rerun's own error is none of the system's
    stream = rerun.RecordingStream('herding_ros', send_properties=False)
    stream.save(file, default_blueprint=_arrangement(run))
    stream.send_recording_name(name)
    _send_herd(stream, run)
    for curve in curves(run):
        _send_curve(stream, curve)
    stream.disconnect()


def _arrangement(run: RecordedRun) -> Any:
    """Return what a viewer shows first: the herd from above, and the curves beside it."""
    from rerun import blueprint

    middle, side = _middle(run)
    above = blueprint.EyeControls3D(
        position=[*middle, 1.5 * side], look_target=[*middle, 0.0], eye_up=[0.0, 1.0, 0.0]
    )
    plots = (
        blueprint.TimeSeriesView(origin=_entity(curve), name=curve.label) for curve in curves(run)
    )
    herd = blueprint.Spatial3DView(
        origin='herd', name='herd', eye_controls=above, background=[255, 255, 255]
    )
    return blueprint.Blueprint(
        blueprint.Horizontal(herd, blueprint.Vertical(*plots), column_shares=[2, 1]),
        blueprint.TimePanel(timeline=TIMELINE),
        collapse_panels=True,
    )


def _middle(run: RecordedRun) -> tuple[Array, float]:
    """Return the middle (2,) and the longer side [m] of where sheep and dogs were."""
    places = np.concatenate([run.x.reshape(-1, 2), run.d.reshape(-1, 2)])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    return 0.5 * (low + high), float((high - low).max()) or 1.0


def _send_herd(stream: Any, run: RecordedRun) -> None:
    place = field(run)[0]
    _send_points(stream, 'herd/sheep', run.times, run.x, _BLUE, 3.0)
    for m, number in enumerate(run.dogs):
        dog, name = run.d[:, m], f'herd/dog_{number}'
        _send_points(stream, name, run.times, dog[:, None], _RED, 5.0, str(number))
        _send_headings(stream, f'{name}/heading', run, m)
        _send_lines(stream, f'{name}/path', _parts(dog), _pale(_RED), _THIN)
        _send_routes(
            stream, f'{name}/plan', [(r.times[0], r.points[:, m]) for r in run.plans], _RED
        )
    middle = over_time(centre, run)
    _send_points(stream, 'herd/centre', run.times, middle[:, None], _BLUE, 5.0)
    _send_lines(stream, 'herd/centre/path', _parts(middle), _pale(_BLUE), _THIN)
    expected = [(route.times[0], route.points) for route in run.expected]
    _send_routes(stream, 'herd/centre/expected', expected, _BLUE)
    goals = run.goals or (() if run.goal is None else ((0.0, run.goal),))
    if goals:
        since, where = zip(*goals, strict=True)
        at = np.array(where)[:, None]
        _send_points(stream, 'herd/destination', np.array(since), at, _BLACK, 5.0, 'destination')
    _send_lines(stream, 'herd/walls', outlines(place), _GREY)
    _send_lines(stream, 'herd/region', [line for line in (region(place),) if len(line)], _GREY)


def _send(stream: Any, name: str, times: Array, columns: Any) -> None:
    import rerun

    nanoseconds = np.round(1e9 * np.asarray(times)).astype('timedelta64[ns]')
    stream.send_columns(name, [rerun.TimeColumn(TIMELINE, duration=nanoseconds)], columns)


def _send_points(
    stream: Any, name: str, times: Array, places: Array, colour: Colour, radius: float,
    label: str | None = None,
) -> None:  # fmt: skip
    """Send places (T, n, 2) [m] at times (T,) [s], but for those that are not known."""
    import rerun

    looks = rerun.Points3D.from_fields(
        radii=rerun.Radius.ui_points(radius), colors=colour, labels=label
    )
    stream.log(name, looks, static=True)
    known = np.isfinite(places).all(axis=2)
    columns = rerun.Points3D.columns(positions=_in_space(places[known]))
    _send(stream, name, times, columns.partition(known.sum(axis=1)))


def _send_headings(stream: Any, name: str, run: RecordedRun, m: int) -> None:
    import rerun

    along = run.headings[:, m]
    arrows = _HEADING * _middle(run)[1] * np.stack([np.cos(along), np.sin(along)], axis=1)
    known = np.isfinite(run.d[:, m]).all(axis=1)
    columns = rerun.Arrows3D.columns(
        origins=_in_space(run.d[known, m]), vectors=_in_space(arrows[known])
    )
    radius = rerun.Radius.ui_points(_THICK)
    stream.log(name, rerun.Arrows3D.from_fields(colors=_RED, radii=radius), static=True)
    _send(stream, name, run.times, columns.partition(known))


def _send_routes(
    stream: Any, name: str, routes: Sequence[tuple[float, Array]], colour: Colour
) -> None:
    """Send lines (K, 2) [m], each from a time [s] on until the next; NaN is none."""
    import rerun

    if not routes:
        return
    routes = sorted(routes, key=lambda route: route[0])  # of two, the later counts
    times = np.array([time for time, _ in routes])
    known = np.array([bool(np.isfinite(line).all()) for _, line in routes])
    lines = [_in_space(line) for (_, line), here in zip(routes, known, strict=True) if here]
    looks = rerun.LineStrips3D.from_fields(colors=colour, radii=rerun.Radius.ui_points(_THICK))
    stream.log(name, looks, static=True)
    _send(stream, name, times, rerun.LineStrips3D.columns(strips=lines).partition(known))


def _send_lines(
    stream: Any, name: str, lines: Sequence[Array], colour: Colour, radius: float = _THICK
) -> None:
    """Send lines (K, 2) [m] that are there all the time."""
    import rerun

    if len(lines):
        strips = rerun.LineStrips3D(
            [_in_space(line) for line in lines],
            colors=colour,
            radii=rerun.Radius.ui_points(radius),
        )
        stream.log(name, strips, static=True)


def _entity(curve: RunCurve) -> str:
    return f'curves/{curve.label.partition(" [")[0].replace(" ", "_")}'


def _send_curve(stream: Any, curve: RunCurve) -> None:
    import rerun

    name = _entity(curve)
    looks = rerun.SeriesLines if curve.of_states else rerun.SeriesPoints
    stream.log(name, looks(names=curve.label, colors=_BLUE), static=True)
    known = np.isfinite(curve.values)
    _send(stream, name, curve.times[known], rerun.Scalars.columns(scalars=curve.values[known]))


def _parts(places: Array) -> list[Array]:
    """Return the parts (K, 2) of a path (T, 2) between which it is not known."""
    known = np.isfinite(places).all(axis=1)
    ends = np.flatnonzero(np.diff(known)) + 1
    return [part for part in np.split(places, ends) if np.isfinite(part[0]).all()]


def _pale(colour: Colour) -> Colour:
    red, green, blue = (round(each + _PALE * (255 - each)) for each in colour)
    return red, green, blue


def _in_space(places: Array) -> np.ndarray:
    """Return places (..., 2) in the plane z = 0, (..., 3)."""
    return np.concatenate([places, np.zeros((*places.shape[:-1], 1))], axis=-1)
