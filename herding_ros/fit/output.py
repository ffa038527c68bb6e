# SPDX-License-Identifier: Apache-2.0
"""What a fit leaves: parameters that nodes load, and a picture."""

from __future__ import annotations

from collections.abc import Iterable
import os
from pathlib import Path
from typing import Any

from herding_ros.model.parameters import Entry
from herding_ros.report.style import BLUE, GREY, new, RED, save
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


def save_picture(fit: Fit, forecast: Forecast, path: str | os.PathLike[str]) -> None:
    """Draw parameters, correlations and errors of predictions into a PNG."""
    figure, ((intervals, correlation, errors),) = new(3, 1, 4.6, 3.6)
    names = [each.name.removeprefix('crowd.') for each in fit.estimates]
    places = np.arange(len(names))
    for place, each in zip(places, fit.estimates, strict=True):
        colour = BLUE if each.is_told else GREY
        ends = [[1.0 - each.low / each.value], [each.high / each.value - 1.0]]
        intervals.errorbar([1.0], [place], xerr=ends, fmt='o', color=colour, markersize=3)
    intervals.set_xscale('log')
    intervals.set_xlim(1.0 / 30.0, 30.0)
    intervals.set_yticks(places, names)
    intervals.invert_yaxis()
    intervals.set_xlabel(f'{CONFIDENCE:.0%} interval / value; grey: cannot be told', fontsize=8)
    shown = correlation.imshow(fit.correlation, cmap='RdBu', vmin=-1.0, vmax=1.0)
    correlation.set_xticks(places, names, rotation=90)
    correlation.set_yticks(places, names)
    correlation.set_title('correlation', fontsize=9)
    figure.colorbar(shown, ax=correlation, shrink=0.8)
    ahead = np.maximum(forecast.ahead, 0.1)
    for values, colour, label in (
        (forecast.error, BLUE, 'recorded - predicted'),
        (forecast.expected, RED, 'as the crowd expects'),
        (forecast.standing, GREY, 'recorded - standing still'),
    ):
        errors.loglog(ahead, values, 'o-', color=colour, label=label, markersize=3)
    errors.set(xlabel='time ahead [s]', ylabel='position, rms [m]')
    errors.legend(fontsize=7, frameon=False)
    save(figure, Path(path))
