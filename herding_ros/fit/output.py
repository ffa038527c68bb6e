# SPDX-License-Identifier: Apache-2.0
"""What a fit leaves: parameters that nodes load, and a picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import os
from pathlib import Path
from typing import Any

from herding_ros.model.parameters import Entry
from herding_ros.report.style import BLUE, COLOURS, GREY, legend, new, RED, save
from matplotlib.axes import Axes
import numpy as np
import yaml

from .estimate import CONFIDENCE, Estimate, Fit, NOISES
from .forecast import Forecast

_DIGITS = 4


def parameter_file(fit: Fit, preset: str, sources: str) -> str:
    """Return the crowd as a ROS parameter file, which states its uncertainty in comments.

    preset: name of the crowd that the fit started from, whose kind this one is; sources: where it
    is from, in words.
    """
    found = {each.name: each for each in fit.estimates}
    noises = (each for each in fit.sensor.walk('sensor.') if each.name in NOISES)
    lines = [
        f'# The crowd that explains {sources}: the program `fit`. Behind each parameter',
        f'# its {CONFIDENCE:.0%} interval. For sim and controller: --params-file.',
        '',
        '/**:',
        '  ros__parameters:',
        '    crowd:',
        f'      preset: {preset}',
        *_lines(fit.crowd.walk('crowd.'), 'crowd.', found, '      '),
        '    sensor:  # of the controller; the sim calls them position_noise and velocity_noise',
        *_lines(noises, 'sensor.', found, '      '),
    ]
    return '\n'.join(lines) + '\n'


def _lines(
    entries: Iterable[Entry], prefix: str, found: dict[str, Estimate], indent: str
) -> list[str]:
    lines: list[str] = []
    opened = ''
    for name, value, _ in entries:
        *groups, last = name.removeprefix(prefix).split('.')
        group = '.'.join(groups)
        if group != opened:
            lines += [f'{indent}{group}:'] if group else []
            opened = group
        comment = _comment(found.get(name))
        lines.append(f'{indent}{"  " * bool(group)}{last}: {_written(value)}{comment}')
    return lines


def _written(value: Any) -> str:
    """Return a value as YAML, numbers with a point where ROS wants one."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f'[{", ".join(map(_written, value))}]'
    if isinstance(value, float):
        rounded = float(f'{value:.{_DIGITS}g}')
        return str(yaml.safe_dump(rounded)).splitlines()[0]
    return str(value)


def _comment(estimate: Estimate | None) -> str:
    if estimate is None:
        return ''
    if estimate.doubt:
        return f'  # cannot be told: {estimate.doubt}'
    return f'  # {estimate.low:.3g} to {estimate.high:.3g}'


_MOST_DOTS = 2000
"""So many predictions of a lead are drawn, evenly chosen; more would be a blob."""

_FAR = 5.0
"""Errors are shown as far as this many times what is expected."""

_AT_ONCE = 1.0
"""Time over which the size of errors is averaged [s]."""


def save_picture(fit: Fit, forecasts: Sequence[Forecast], path: str | os.PathLike[str]) -> None:
    """Draw parameters, correlations, predictions and their errors into a PNG."""
    figure, ((intervals, correlation, errors), (against, course, shares)) = new(3, 2, 4.6, 3.6)
    names = [each.name.removeprefix('crowd.') for each in fit.estimates]
    _draw_intervals(intervals, fit.estimates, names)
    places = np.arange(len(names))
    shown = correlation.imshow(fit.correlation, cmap='RdBu', vmin=-1.0, vmax=1.0)
    correlation.set_xticks(places, names, rotation=90)
    correlation.set_yticks(places, names)
    correlation.set_title('correlation of the estimates', fontsize=9)
    figure.colorbar(shown, ax=correlation, shrink=0.8)
    _draw_errors(errors, forecasts)
    _draw_predicted(against, [each for each in forecasts if each.ahead])
    _draw_course(course, forecasts[0])
    _draw_shares(shares, forecasts)
    save(figure, Path(path))


def _draw_intervals(axes: Axes, estimates: Sequence[Estimate], names: Sequence[str]) -> None:
    for place, each in enumerate(estimates):
        colour = BLUE if each.is_told else GREY
        ends = [[1.0 - each.low / each.value], [each.high / each.value - 1.0]]
        axes.errorbar([1.0], [place], xerr=ends, fmt='o', color=colour, markersize=3)
    axes.set_xscale('log')
    axes.set_xlim(1.0 / 30.0, 30.0)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlabel(f'{CONFIDENCE:.0%} interval / value; grey: cannot be told')


def _draw_errors(axes: Axes, forecasts: Sequence[Forecast]) -> None:
    ahead = [max(each.ahead, 0.1) for each in forecasts]
    for name, colour, label in (
        ('error', BLUE, 'recorded - predicted'),
        ('expected', RED, 'as the crowd expects'),
        ('standing', GREY, 'recorded - standing still'),
    ):
        values = [getattr(each, name) for each in forecasts]
        axes.loglog(ahead, values, 'o-', color=colour, label=label, markersize=3)
    axes.set(xlabel='time ahead [s]', ylabel='position, rms [m]')
    legend(axes)


def _draw_predicted(axes: Axes, forecasts: Sequence[Forecast]) -> None:
    """Draw how far sheep came over how far they should have come; the longest time behind."""
    for colour, each in reversed(list(zip(COLOURS, forecasts, strict=False))):
        some = slice(None, None, max(len(each.t) // _MOST_DOTS, 1))
        axes.plot(
            each.predicted[some], each.moved[some], '.', color=colour, markersize=2.0, alpha=0.4,
            label=f'{each.ahead:g} s ahead', rasterized=True,
        )  # fmt: skip
    axes.axline((0.0, 0.0), slope=1.0, color=GREY, linewidth=0.8)
    axes.set_aspect('equal', 'datalim')
    axes.set(xlabel='displacement as predicted [m]', ylabel='as recorded [m]')
    legend(axes)


def _draw_course(axes: Axes, forecast: Forecast) -> None:
    """Draw errors at the next observation over time, and how large they were within a second."""
    some = slice(None, None, max(len(forecast.t) // _MOST_DOTS, 1))
    axes.plot(
        forecast.t[some], forecast.standardised[some], '.', color=BLUE, markersize=2.0, alpha=0.3
    )
    second = np.floor(forecast.t / _AT_ONCE)
    seconds, member = np.unique(second, return_inverse=True)
    squares = np.bincount(member, forecast.standardised**2) / np.bincount(member)
    axes.plot((seconds + 0.5) * _AT_ONCE, np.sqrt(squares), color=RED, label='rms of a second')
    axes.axhline(1.0, color=GREY, linewidth=0.8)
    axes.set(xlabel='time [s]', ylabel='residual / expected', ylim=(-_FAR, _FAR))
    axes.set_title('residuals, next observation', fontsize=9)
    legend(axes)


def _draw_shares(axes: Axes, forecasts: Sequence[Forecast]) -> None:
    """Draw how residuals are distributed, and the normal distribution that is expected."""
    bins = np.linspace(-_FAR, _FAR, 51)
    for colour, each in zip((GREY, *COLOURS), forecasts, strict=False):
        density, _ = np.histogram(each.standardised, bins)
        share = density / (len(each.t) * np.diff(bins))
        name = f'{each.ahead:g} s ahead' if each.ahead else 'next observation'
        axes.stairs(np.where(share > 0.0, share, np.nan), bins, color=colour, label=name)
    middles = 0.5 * (bins[1:] + bins[:-1])
    normal = np.exp(-0.5 * middles**2) / np.sqrt(2.0 * np.pi)
    axes.plot(middles, normal, '--', color='black', linewidth=0.8, label='if the crowd is right')
    axes.set(xlabel='residual / expected', ylabel='density', yscale='log', ylim=(1e-4, 1.0))
    legend(axes)
