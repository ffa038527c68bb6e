"""What the figures of all studies have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

# Blue and red of this lightness stay apart with any kind of colour vision, and in grey.
BLUE, RED, GREY = '#2166ac', '#c2292b', '#5f6368'
COLOURS = (BLUE, RED, '#1b9e77', '#7b5aa6', '#c98a00', GREY)


def new(columns: int, rows: int, width: float = 4.0, height: float = 3.4) -> tuple[Figure, Any]:
    """Return a figure and its axes (rows, columns)."""
    figure = Figure(figsize=(width * columns, height * rows), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False)


def save(figure: Figure, path: Path) -> str:
    """Save a figure as PNG, and return its name for a link."""
    for axes in figure.axes:
        axes.spines[['top', 'right']].set_visible(False)
        axes.tick_params(labelsize=8)
        axes.grid(color='0.92')
        axes.set_axisbelow(True)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120, metadata={'Software': None})
    return f'figures/{path.name}'


def draw_run(axes: Axes, run: dict[str, Any], goal: list[float], title: str) -> None:
    """Draw a run as the paper does: sheep blue, dogs red, a cross at the destination."""
    paths = run['paths']
    dogs = np.array(paths['dogs'])
    for m in range(dogs.shape[1]):
        axes.plot(*dogs[:, m].T, color=RED, linewidth=0.8, alpha=0.6)
    axes.plot(*np.array(paths['centre']).T, color=BLUE, linewidth=1.6)
    draw_herd(axes, paths['first'], dogs[0], goal, 0.3)
    draw_herd(axes, paths['last'], dogs[-1], goal, 1.0)
    axes.set_title(title, fontsize=9)


def draw_herd(axes: Axes, x: Any, d: Any, goal: list[float], alpha: float = 1.0) -> None:
    """Draw everybody at an instant, x (N, 2) and d (M, 2) [m]."""
    axes.plot(*np.transpose(x), 'o', color=BLUE, markersize=3, markeredgewidth=0, alpha=alpha)
    axes.plot(*np.transpose(d), '^', color=RED, markersize=6, markeredgewidth=0, alpha=alpha)
    axes.plot(*goal, 'x', color='black', markersize=9, markeredgewidth=2)
    axes.set_aspect('equal', adjustable='datalim')
