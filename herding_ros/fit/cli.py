# SPDX-License-Identifier: Apache-2.0
"""The program `fit`: the crowd that explains recorded sheep and dogs, as a parameter file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys
import time

from herding_ros.bag.notes import printable
from herding_ros.model.crowd import CROWDS
from rich.console import Console
from rich.table import Table

from .estimate import CONFIDENCE, Fit, fit
from .forecast import Forecast, forecast
from .output import parameter_file, save_picture
from .recording import read

_DESCRIPTION = """\
Fit the crowd to recorded sheep and dogs. Writes a parameter file for sim and controller, with the
intervals of all parameters, and a picture. What the recordings cannot tell is said, and stays near
where the fit began.

A recording is the folder of a rosbag2 bag, or a CSV file with the columns time [s], name, x, y [m]
and, if they were measured, vx, vy [m/s], a row for each animal and instant. Names of dogs begin
with dog. Of a bag of our sim the observations are used, not the truth.
"""

_EPILOG = """\
Exit code: 0 done, 1 the fit has not converged, 2 bad arguments or recordings.
Examples:
  fit runs/2025-01-31_12-00-00/bag --out crowd.yaml
  fit monday.csv tuesday.csv --preset cohesive --hold crowd.sheep. --lead 1 3
"""


_LIKE = 1.5
"""Errors of predictions are expected to be within this factor of what they are."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='fit', description=_DESCRIPTION, epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    add('recordings', type=Path, nargs='+', metavar='RECORDING', help='bag or CSV file')
    add('--out', type=Path, default=Path('crowd.yaml'), metavar='FILE',
        help='parameter file to write (crowd.yaml); the picture is beside it, as PNG')  # fmt: skip
    add('--preset', choices=CROWDS, default='cohesive', metavar='NAME',
        help=f'crowd to start from, {" or ".join(CROWDS)} (cohesive)')  # fmt: skip
    add('--length', type=float, default=1.0, metavar='L',
        help='lengths of the preset are this many times as long: 4 for sheep and dogs that are '
        'metres apart')  # fmt: skip
    add('--time', type=float, default=1.0, metavar='T', help='and times this many times')
    add('--hold', nargs='+', default=[], metavar='NAME',
        help='parameters that stay as in the preset; crowd.sheep. are all of these')  # fmt: skip
    add('--position-noise', type=float, metavar='S',
        help='standard deviation of recorded positions [m] (in the bag, or fitted)')  # fmt: skip
    add('--velocity-noise', type=float, metavar='S', help='of recorded velocities [m/s]')
    add('--lead', type=float, nargs='+', default=[0.0], metavar='S',
        help='how far ahead the crowd should predict [s] (0: the next observation, which says '
        'most if sheep are as the model has them)')  # fmt: skip
    add('--step', type=float, default=0.05, metavar='S',
        help='longest time step of predictions [s] (0.05)')  # fmt: skip
    add('--namespace', metavar='NS', help='of the sheep; needed if a bag has some in several')
    return parser


def main(args: list[str] | None = None) -> int:
    """Run the program; see --help for the exit codes."""
    options = _parser().parse_args(args)
    console = Console(highlight=False, soft_wrap=True)
    try:
        recordings = [read(path, options.namespace) for path in options.recordings]
        for each in recordings:
            console.print(
                f'{each.name}: {each.x.shape[1]} sheep, {each.d.shape[1]} dogs, '
                f'{each.duration:.1f} s, {len(each.times)} instants',
                markup=False,
            )
        begun = time.monotonic()
        start = CROWDS[options.preset].rescaled(options.length, options.time)
        with console.status('fitting') as status:
            found = fit(
                recordings, start, options.position_noise, options.velocity_noise,
                options.lead, options.hold, options.step,
                lambda iteration, value: status.update(
                    f'iteration {iteration}, objective {value:.1f}'
                ),
            )  # fmt: skip
        took = time.monotonic() - begun
        judged = forecast(recordings, found.crowd, found.sensor, options.step)
        sources = ', '.join(path.name for path in options.recordings)
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(parameter_file(found, options.preset, sources), encoding='utf-8')
        picture = options.out.with_suffix('.png')
        save_picture(found, judged, picture)
    except (OSError, ValueError) as error:
        print(f'fit: {printable(str(error))}', file=sys.stderr)
        return 2
    console.print(_table(found))
    for line in _in_words(found, judged):
        console.print(line, markup=False)
    console.print(f'{found.iterations} iterations, {took:.1f} s\n{options.out}\n{picture}')
    if not found.converged:
        print(
            'fit: not converged: hold some of what cannot be told (--hold), or start from another '
            '--preset',
            file=sys.stderr,
        )
    return 0 if found.converged else 1


def _table(found: Fit) -> Table:
    table = Table(box=None, header_style='bold', pad_edge=False)
    table.add_column('parameter')
    for name in ('value', f'{CONFIDENCE:.0%} interval'):
        table.add_column(name, justify='right')
    table.add_column('unit')
    for each in found.estimates:
        interval = '?' if each.doubt else f'{each.low:.3g} to {each.high:.3g}'
        table.add_row(each.name, f'{each.value:.4g}', interval, each.unit)
    return table


def _in_words(found: Fit, judged: Sequence[Forecast]) -> list[str]:
    lines = [f'{each.name} cannot be told: {each.doubt}' for each in found.estimates if each.doubt]
    if narrower := found.narrower():
        intervals = ', '.join(
            f'{each.name} {each.low:.3g} to {each.high:.3g}' for each in narrower
        )
        lines.append(f'with these held (--hold), if you know them: {intervals}')
    if found.held:
        lines.append(f'not fitted: {", ".join(found.held)}')
    for each in judged:
        when = f'{each.ahead:g} s ahead' if each.ahead else 'at the next observation'
        lines.append(
            f'{when}: positions off by {each.error:.3g} m, by the crowd {each.expected:.3g} m, '
            f'if sheep stood still {each.standing:.3g} m (rms)'
        )
    ratios = [each.error / each.expected for each in judged]
    if max(*ratios, 1.0 / min(ratios)) > _LIKE:
        lines.append(
            f'predictions are {min(ratios):.2g} to {max(ratios):.2g} times as far off as the '
            'crowd expects: sheep are not quite of its kind. Intervals are of the best of its kind'
        )
    return lines


if __name__ == '__main__':
    sys.exit(main())
