# SPDX-License-Identifier: Apache-2.0
"""A run as a moving picture: GIF by Pillow, MP4 where ffmpeg is."""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import subprocess
from typing import Any

from herding_ros.bag.recorded_run import Array, in_play, RecordedRun
from herding_ros.model.field import Field
from herding_ros.model.flock import centre
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
import numpy as np
from PIL import Image

from .style import BLUE, draw_goal, draw_herd, draw_paths, draw_walls, number_dogs, RED
from .summary import field, over_time
from .walls import further, outlines

_PICTURES = 100
"""Pictures of a run."""

_PER_SECOND = 12.5
"""Pictures per second, of which GIF has whole hundredths."""

_COLOURS = 32
"""Colours of a GIF, which make it small."""

_SIZE, _DPI = (6.4, 5.0), 100


def save_animation(run: RecordedRun, path: str | os.PathLike[str]) -> None:
    """Save the run, its plans included, as the file's ending says: .gif or .mp4.

    Raises ValueError for another ending, and for .mp4 where there is no ffmpeg; OSError when the
    file cannot be written.
    """
    file = Path(path)
    if file.suffix not in ('.gif', '.mp4'):
        raise ValueError(f'an animation must end in .gif or .mp4, got {file.name}')
    if file.suffix == '.mp4' and shutil.which('ffmpeg') is None:
        raise ValueError(
            'an animation in .mp4 needs ffmpeg, which is not installed; .gif does not'
        )
    file.parent.mkdir(parents=True, exist_ok=True)
    pictures = _pictures(run)
    if file.suffix == '.mp4':
        _save_film(pictures, file)
        return
    palette = pictures[len(pictures) // 2].quantize(_COLOURS)
    first, *others = (
        each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures
    )
    first.save(
        file, save_all=True, append_images=others, duration=round(1000.0 / _PER_SECOND), loop=0,
        optimize=True,
    )  # fmt: skip


def _pictures(run: RecordedRun) -> list[Image.Image]:
    figure = Figure(figsize=_SIZE, dpi=_DPI, layout='constrained')
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    place = field(run)[0]
    box, middle = _box(run, place), over_time(centre, run)
    states = np.linspace(0, len(run.times) - 1, min(_PICTURES, len(run.times))).round().astype(int)
    found = []
    for k in states:
        axes.clear()
        _draw(axes, run, place, int(k), middle)
        axes.set(xlim=box[:, 0], ylim=box[:, 1])
        axes.set_aspect('equal', adjustable='box')
        canvas.draw()
        figure.set_layout_engine('none')  # where it is now it stays
        found.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert('RGB'))
    return found


def _draw(axes: Axes, run: RecordedRun, place: Field, k: int, middle: Array) -> None:
    now = float(run.times[k])
    draw_walls(axes, place, further(place, run.surroundings_at(now).walls))
    draw_paths(axes, run.d[: k + 1], middle[: k + 1])
    for routes, colour in ((run.plans, RED), (run.expected, BLUE)):
        route = in_play(routes, now)
        if route is not None:
            _draw_ahead(axes, route.ahead(now), colour)
    there = np.isfinite(run.d[k, :, 0])
    draw_herd(axes, run.x[k][run.seen[k]], run.d[k][there], size=4.0)
    number_dogs(axes, run.d[k], run.dogs)
    draw_goal(axes, run.goal_at(now))
    axes.set_title(f't = {now:.1f} s', fontsize=10)
    axes.grid(color='0.92')
    axes.set_axisbelow(True)


def _draw_ahead(axes: Axes, points: Array, colour: Any) -> None:
    """Draw where dogs (n, M, 2), or the centre (n, 2), are going to be [m], fading with time."""
    of_all = points.reshape(len(points), -1, 2)
    segments = np.stack([of_all[:-1], of_all[1:]], axis=2)  # (n - 1, M, 2, 2)
    fading = np.linspace(1.0, 0.1, len(segments)) if len(segments) else np.zeros(0)
    colours = [to_rgba(colour, alpha) for alpha in fading for _ in range(of_all.shape[1])]
    lines = list(segments.reshape(-1, 2, 2))
    axes.add_collection(LineCollection(lines, colors=colours, linewidths=1.2))


def _box(run: RecordedRun, place: Field) -> Array:
    """Return the lower left and the upper right corner (2, 2) [m] of all pictures."""
    goals = [goal for _, goal in run.goals] or ([] if run.goal is None else [run.goal])
    places = [run.x.reshape(-1, 2), run.d.reshape(-1, 2), np.reshape(goals, (-1, 2))]
    everything = np.concatenate([*places, *outlines(place)])
    everything = everything[np.isfinite(everything).all(axis=1)]
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.05 * float((high - low).max()) or 0.5
    return np.array([low - margin, high + margin])


def _save_film(pictures: list[Image.Image], file: Path) -> None:
    width, height = pictures[0].size
    done = subprocess.run(
        ['ffmpeg', '-y', '-loglevel', 'error', '-f', 'rawvideo', '-pix_fmt', 'rgb24',
         '-s', f'{width}x{height}', '-r', str(_PER_SECOND), '-i', '-', '-pix_fmt', 'yuv420p',
         str(file)],
        input=b''.join(picture.tobytes() for picture in pictures),
        capture_output=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise OSError(f'ffmpeg could not write {file}: {done.stderr.decode(errors="replace")}')
