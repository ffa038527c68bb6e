# SPDX-License-Identifier: Apache-2.0
"""The program `recover`: makes a bag readable whose recorder was killed, or that was damaged."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from rich.console import Console
from rich.progress import Progress

from .metadata import all_topics, FILE_NAME
from .recovery import recover, Recovery, Result

_DESCRIPTION = """\
Make a rosbag2 bag in mcap readable that has no end, since its recorder was killed or the power
failed, or that was damaged. Everything is kept that is whole, and metadata.yaml is written anew.

A data file that is whole is left alone. One that is not is copied as far as it is whole, and then
kept as NAME.mcap.broken: delete that when you are content. So the disk needs room for a copy.
Nothing is ever overwritten, and nothing outside of BAG is touched.
"""

_EPILOG = """\
Exit code: 0 the bag is whole now, or was; 2 it is no bag, is being recorded or cannot be written.
Bags of `ros2 bag record -s mcap` are recovered too, those in sqlite3 are not.
Example: recover runs/2025-01-31_12-00-00/bag
"""


def main(args: list[str] | None = None) -> int:
    """Run the program. Returns 0, or 2 when there is no bag or it cannot be written."""
    parser = argparse.ArgumentParser(
        prog='recover',
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of a rosbag2 bag')
    options = parser.parse_args(args)
    try:
        recovery = _recover(options.bag)
    except (OSError, ValueError) as error:
        print(f'recover: {error}', file=sys.stderr)
        return 2
    print(_in_words(options.bag, recovery))
    return 0


def _recover(folder: Path) -> Recovery:
    """Recover a bag; on a terminal a bar shows how far it is."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        return recover(folder, lambda path: bar.open(path, 'rb', description=path.name))


def _in_words(folder: Path, recovery: Recovery) -> str:
    files = [result.information for result in recovery.results]
    lines = [_line(result) for result in recovery.results]
    count = sum(file.message_count for file in files)
    total = f'{count} messages of {len(all_topics(files))} topics'
    if recovery.was_whole:
        lines.append(f'{folder} was whole: {total}; nothing was changed')
    else:
        lines.append(f'{folder} is whole: {total}')
    if recovery.new_metadata:
        lines[-1] += f', {FILE_NAME} is new'
    return '\n'.join(lines)


def _line(result: Result) -> str:
    name, count = result.information.path, result.information.message_count
    if result.kept is None:
        return f'{name}: whole, {count} messages'
    lost = f'{result.lost_bytes} bytes'
    if result.lost_messages:
        lost += f' and {result.lost_messages} messages whose topics were in them'
    lines = [
        f'{name}: {count} messages recovered, lost {lost}; as it was it is {result.kept.name}',
        *(f'    {fault}' for fault in result.faults),
    ]
    return '\n'.join(lines)


if __name__ == '__main__':
    sys.exit(main())
