# SPDX-License-Identifier: Apache-2.0
"""The program `report`: a bag's picture, summary and table of topics."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import sys
from typing import Any

from herding_ros.bag.notes import printable
from herding_ros.bag.reader import read_run
from herding_ros.bag.recorded_run import RecordedRun
from rich.console import Console
from rich.table import Table
from rich.text import Text

from .animation import save_animation
from .figures import save_trajectories
from .replay import save_replay
from .rerun_recording import save_rerun
from .summary import summarise

_WIDTH_WITH_TYPES = 72
"""Least width of a terminal for a table with the types of topics [columns]."""


def write_report(
    bag: str | os.PathLike[str],
    out: str | os.PathLike[str],
    console: Console,
    namespace: str | None = None,
    animation: Path | None = None,
    rerun: Path | None = None,
) -> dict[str, Any]:
    """Write trajectories.png, replay.html and summary.json of a bag into the folder out.

    `namespace` is needed where the bag has sheep in several; `animation` and `rerun`: files to
    write as well, see `save_animation` and `save_rerun`. Prints them and returns the summary.
    Raises what `read_run` and these raise, and OSError when out cannot be written.
    """
    run = read_run(bag, namespace)
    summary = summarise(run)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    picture, replay, numbers = (
        folder / name for name in ('trajectories.png', 'replay.html', 'summary.json')
    )
    save_trajectories(run, picture)
    save_replay(run, replay)
    numbers.write_text(json.dumps(summary, indent=2) + '\n', encoding='utf-8')
    console.print(_table(run, console.width))
    console.print(_in_words(summary), highlight=False)
    for note in summary['notes']:
        console.print(f'note: {note}', highlight=False, markup=False, soft_wrap=True)
    written = [picture, replay, numbers]
    if animation:
        save_animation(run, animation)
        written.append(animation)
    if rerun:
        save_rerun(run, rerun, folder.absolute().name)
        written.append(rerun)
    console.print('\n'.join(map(str, written)), highlight=False, soft_wrap=True)
    return summary


def _table(run: RecordedRun, width: int) -> Table:
    """Return the table of topics: their names always whole, their types where there is room."""
    has_types = width >= _WIDTH_WITH_TYPES
    table = Table(box=None, header_style='bold', pad_edge=False)
    table.add_column('topic', overflow='fold')
    if has_types:
        table.add_column('type', overflow='fold')
    table.add_column('messages', justify='right')
    table.add_column('rate [Hz]', justify='right')
    for topic in run.topics:
        names = (topic.name, topic.type) if has_types else (topic.name,)
        named = (Text(printable(name)) for name in names)
        table.add_row(*named, str(topic.count), f'{topic.rate:.1f}')
    return table


def _in_words(summary: dict[str, Any]) -> str:
    strays = summary['arrival.strays']
    left = f', {strays} of which may be left behind' if strays else ''
    herd = f'{summary["sheep"]} sheep{left}, {summary["dogs"]} dogs'
    spread = (
        f'spread at most {summary["max_spread_m"]:.3f} m '
        f'(start {summary["initial_spread_m"]:.3f} m)'
    )
    if summary['goal'] is None:
        lines = [f'{herd}, {summary["time_s"]:.1f} s, no known destination', spread]
    else:
        x, y = summary['goal']
        result = 'arrived after' if summary['arrived'] else 'did not arrive within'
        lines = [
            f'{herd}, to ({x:g}, {y:g}): {result} {summary["time_s"]:.1f} s',
            f'distance at the end {summary["final_distance_m"]:.3f} m, {spread}',
        ]
    if summary['closest_dogs_m'] is not None:
        lines.append(
            f'dogs at least {summary["closest_dogs_m"]:.3f} m from each other, '
            f'{summary["touches"]} touches'
        )
    if summary['solve_ms_median'] is not None:
        lines.append(
            f'{summary["replans"]} replans, solved in {summary["solve_ms_median"]:.0f} ms '
            f'(median), {summary["solve_ms_max"]:.0f} ms (longest)'
        )
    if summary['feedback_ms_median'] is not None:
        lines[-1] += (
            f'; {summary["feedbacks"]} of them between two windows, in '
            f'{summary["feedback_ms_median"]:.0f} ms (median)'
        )
    lines.append(f'largest gap between two states {summary["largest_gap_s"]:.3g} s')
    if summary['real_time_factor'] is not None:
        lines.append(
            f'{summary["messages_recorded"]} messages, {summary["wall_s"]:.1f} s of wall time, '
            f'{summary["real_time_factor"]:.1f} x real time'
        )
    if summary['messages_lost']:
        lines.append(f'{summary["messages_lost"]} messages were lost on their way to the recorder')
    return '\n'.join(lines)


def main(args: list[str] | None = None) -> int:
    """Run the program. Returns 0, 2 when the bag cannot be read or the report not written."""
    parser = argparse.ArgumentParser(
        prog='report',
        description='Draw and summarise a recorded run: trajectories.png, replay.html, which any '
        'browser plays, and summary.json.',
    )
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of a rosbag2 bag')
    parser.add_argument(
        '--out', type=Path, metavar='DIR', help='folder to write to (default: the one of BAG)'
    )
    parser.add_argument(
        '--namespace', metavar='NS',
        help='namespace of sim and controller; needed if the bag has sheep in several',
    )  # fmt: skip
    parser.add_argument(
        '--animate', type=Path, metavar='FILE',
        help='write a moving picture as well: FILE.gif, or FILE.mp4 where ffmpeg is',
    )  # fmt: skip
    parser.add_argument(
        '--rerun', type=Path, metavar='FILE.rrd',
        help='write a recording for the viewer Rerun as well; needs rerun-sdk',
    )  # fmt: skip
    options = parser.parse_args(args)
    out = options.out or options.bag.absolute().parent
    try:
        write_report(
            options.bag, out, Console(), options.namespace, options.animate, options.rerun
        )
    except (OSError, ValueError) as error:
        print(f'report: {printable(str(error))}', file=sys.stderr)
        return 2
    return 0


if __name__ == '__main__':
    sys.exit(main())
