# SPDX-License-Identifier: Apache-2.0
"""The picture of the page: times over the number of sheep, log-log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmark.problem import SHEEP
from benchmark.results import Results
from herding_ros.report.style import BLUE, COLOURS, legend, new, RED, save
import numpy as np

_COLOURS = {'ours': RED, 'JAX': BLUE, 'CasADi': COLOURS[2], 'NumPy': COLOURS[3]}
_LINES = {1: ':', 5: '-', 20: '--'}


def draw(results: Results, path: Path) -> None:
    """Write the picture as PNG."""
    figure, ((left, right),) = new(2, 1, width=4.5, height=4.0)
    for dogs, line in _LINES.items():
        for name in ('CasADi', 'JAX', 'ours'):
            points = _points(results, 'value and gradient', name, dogs)
            _plot(left, points, name, line, f'{name}, M = {dogs}')
    for name in ('NumPy', 'ours'):
        _plot(right, _points(results, 'ensemble', name, 5), name, '-', f'{name}, M = 5')
    left.set(title='Value and gradient', ylabel='time per step [µs]')
    right.set(title='Ensemble', ylabel='time per step and path [µs]')
    for axes in (left, right):
        axes.set(xscale='log', yscale='log', xlabel='N, number of sheep')
        axes.set_xticks(SHEEP, [str(n) for n in SHEEP], minor=False)
        axes.set_xticks([], minor=True)
        axes.set_xlim(8, 1250)
        legend(axes)
    save(figure, path)


def _points(results: Results, what: str, name: str, dogs: int) -> list[tuple[int, float]]:
    """Return (N, time per step [us]) of one implementation, also per path if there are any."""
    key = 'seconds' if name == 'ours' else 'peer_seconds'
    times: dict[int, list[float]] = {}
    for entry in results.of(what, dogs=dogs):
        if name == 'ours' or entry['peer'] == name:
            scale = 1e6 / entry['steps'] / entry.get('paths', 1)
            times.setdefault(entry['sheep'], []).extend(scale * s for s in entry[key])
    return [(n, float(np.median(times[n]))) for n in sorted(times)]


def _plot(axes: Any, points: list[tuple[int, float]], name: str, line: str, label: str) -> None:
    if points:
        axes.plot(*zip(*points, strict=True), line, color=_COLOURS[name], marker='.', label=label)
