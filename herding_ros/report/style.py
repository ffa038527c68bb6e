# SPDX-License-Identifier: Apache-2.0
"""How all figures look, and how a herd is drawn in them."""

from __future__ import annotations

from collections.abc import Iterable
import os
from pathlib import Path
from typing import Any

from herding_ros.model.field import Field
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Circle
import numpy as np

# Blue and red of this lightness stay apart with any kind of colour vision, and in grey.
BLUE, RED, GREY = '#2166ac', '#c2292b', '#5f6368'
COLOURS = (BLUE, RED, '#1b9e77', '#7b5aa6', '#c98a00', GREY)
"""Colours of the series of a diagram."""

_MOST_DOTS = 1000
"""The density of a flock with more sheep than this is drawn; dots would be a blob."""
_CELLS = 40
"""Cells of the density across the flock."""


def new(columns: int, rows: int, width: float = 4.0, height: float = 3.4) -> tuple[Figure, Any]:
    """Return a figure and its axes (rows, columns), each of this size [inch]."""
    figure = Figure(figsize=(width * columns, height * rows), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False)


def save(figure: Figure, path: str | os.PathLike[str], dpi: int = 120) -> None:
    """Save a figure as PNG, its folder included."""
    for axes in figure.axes:
        axes.spines[['top', 'right']].set_visible(False)
        axes.tick_params(labelsize=8)
        axes.grid(color='0.92')
        axes.set_axisbelow(True)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi, metadata={'Software': None})


def legend(axes: Axes) -> None:
    """Add the legend, where there is anything to explain."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=7, frameon=False)


def draw_paths(axes: Axes, dogs: Any, centre: Any, label: str | None = None) -> None:
    """Draw the paths of dogs (T, M, 2) and of the centre (T, 2) [m]."""
    for m in range(np.shape(dogs)[1]):
        axes.plot(*np.asarray(dogs)[:, m].T, color=RED, linewidth=0.8, alpha=0.6)
    axes.plot(*np.transpose(centre), color=BLUE, linewidth=1.6, label=label)


def draw_walls(axes: Axes, field: Field, further: Any = ()) -> None:
    """Draw fences, obstacles and discs, and the region that has to hold all sheep.

    further: straight pieces (n, 2, 2) [m] that are not in the field.
    """
    for piece in further:
        axes.plot(*np.transpose(piece), color='black', linewidth=1.5, solid_capstyle='round')
    if len(field.goal) > 2:
        axes.fill(*np.transpose(field.goal), color=GREY, alpha=0.12, linewidth=0)
    for corners in field.obstacles:
        axes.fill(*np.transpose(corners), color=GREY, alpha=0.5, linewidth=0)
    for ax, ay, bx, by, radius in field.bars:
        if radius:
            axes.add_patch(Circle((ax, ay), radius, color=GREY, alpha=0.5, linewidth=0))
        else:
            axes.plot([ax, bx], [ay, by], color='black', linewidth=1.5, solid_capstyle='round')


def draw_herd(
    axes: Axes,
    x: Any,
    d: Any,
    alpha: float = 1.0,
    size: float = 3.0,
    labels: tuple[str | None, str | None] = (None, None),
) -> None:
    """Draw sheep at x (N, 2) as dots, or as a density if they are many, and dogs at d (M, 2) [m].

    size: diameter of a sheep's dot [pt]; labels: of the sheep and of the dogs.
    """
    common: dict[str, Any] = {'markeredgewidth': 0, 'alpha': alpha}
    if len(x) <= _MOST_DOTS:
        axes.plot(*np.transpose(x), 'o', color=BLUE, markersize=size, label=labels[0], **common)
    else:
        shades = [to_rgba(BLUE, 0.15 * alpha), to_rgba(BLUE, alpha)]
        axes.hexbin(
            *np.transpose(x), gridsize=_CELLS, mincnt=1, linewidths=0, zorder=2,
            cmap=LinearSegmentedColormap.from_list('density', shades),
        )  # fmt: skip
        axes.plot([], [], 'h', color=BLUE, markersize=2 * size, label=labels[0], **common)
    axes.plot(*np.transpose(d), '^', color=RED, markersize=2 * size, label=labels[1], **common)


def number_dogs(axes: Axes, d: Any, numbers: Iterable[int]) -> None:
    """Write its number beside each dog at d (M, 2) [m], but for those without a place."""
    for place, number in zip(np.asarray(d), numbers, strict=True):
        if np.isfinite(place).all():
            axes.annotate(
                str(number), place, (4, 4), textcoords='offset points', fontsize=8,
                annotation_clip=True,
            )  # fmt: skip


def draw_goal(axes: Axes, goal: Any, size: float = 9.0, label: str | None = None) -> None:
    """Draw a cross at the goal (2,) [m], if there is one; both axes, in metres, have one scale."""
    if goal is not None:
        axes.plot(*goal, 'x', color='black', markersize=size, markeredgewidth=2, label=label)
    axes.set_aspect('equal', adjustable='datalim')
    axes.set(xlabel='x [m]', ylabel='y [m]')
